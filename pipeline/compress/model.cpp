#include "pipeline/compress/model.h"
