#include "pipeline/hdr/linearise.h"
