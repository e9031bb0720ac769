#pragma once

#include <cmath>
#include <optional>

#include "corvid/image.h"

namespace corvid::oracle {

/// Bilinear reading; nothing outside [0, width - 1] x [0, height - 1].
template <class Pixel>
std::optional<double> bilinear(const Image<Pixel>& image, double x, double y) {
  if (!(x >= 0 && y >= 0 && x <= image.width() - 1 && y <= image.height() - 1)) return {};
  double sum = 0;
  // Every pixel weighs max(0, 1 - |dx|) max(0, 1 - |dy|).
  for (int j = static_cast<int>(y); j <= std::min(static_cast<int>(y) + 1, image.height() - 1); ++j)
    for (int i = static_cast<int>(x); i <= std::min(static_cast<int>(x) + 1, image.width() - 1);
         ++i)
      sum += std::max(0., 1 - std::abs(x - i)) * std::max(0., 1 - std::abs(y - j)) * image(i, j);
  return sum;
}

}  // namespace corvid::oracle
