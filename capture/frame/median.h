#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace lightsketch {

// The middle one of `values` by size, of an even number the upper of the two; T{} of none. Leaves
// them in another order.
template <class T>
T median(std::vector<T>& values) {
  if (values.empty()) return T{};
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace lightsketch
