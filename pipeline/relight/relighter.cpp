#include "pipeline/relight/relighter.h"
