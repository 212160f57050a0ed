#include "pipeline/illumination/light_grid.h"
