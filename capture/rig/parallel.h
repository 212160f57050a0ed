#pragma once

#include <functional>

namespace lightsketch {

// body(0) to body(count - 1) on all cores, in any order; returns when all are done. What it throws
// first is thrown here. Compiled apart from the views, which sanitizers leave out: the thread
// sanitizer has to see that a loop is over before what follows.
void inParallel(int count, const std::function<void(int)>& body);

}  // namespace lightsketch
