#include "pipeline/compress/hold_out.h"
