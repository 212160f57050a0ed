#include "pipeline/illumination/direction_interpolation.h"
