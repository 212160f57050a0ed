#include "pipeline/sketch/image_file.h"
