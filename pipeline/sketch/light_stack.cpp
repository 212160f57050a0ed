#include "pipeline/sketch/light_stack.h"
