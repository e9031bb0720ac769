#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace corvid {

/// The middle one of the values in order, of an even number the upper of the two; 0 if there are
/// none.
template <class T>
[[nodiscard]] T upper_median(std::vector<T> values) {
  if (values.empty()) return T{};
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace corvid
