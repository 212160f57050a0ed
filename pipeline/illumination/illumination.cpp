#include "pipeline/illumination/illumination.h"
