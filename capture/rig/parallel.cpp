#include "capture/rig/parallel.h"

#include <tbb/parallel_for.h>

namespace lightsketch {

void inParallel(int count, const std::function<void(int)>& body) {
  tbb::parallel_for(0, count, body);
}

}  // namespace lightsketch
