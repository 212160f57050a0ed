#include "pipeline/sketch/sketch.h"
