#pragma once

#include <algorithm>
#include <cmath>

#include "corvid/image.h"

namespace corvid::oracle {

/// Gaussian filter from the definition: the two-dimensional sum over a square window of
/// 2 ceil(4 sigma) + 1 pixels, divided by the sum of its weights; border pixels repeated. Not
/// rounded. One pixel.
template <class Pixel>
double gaussian(const Image<Pixel>& in, double sigma, int x, int y) {
  const int radius = static_cast<int>(std::ceil(4 * sigma));
  double sum = 0, weights = 0;
  for (int j = -radius; j <= radius; ++j)
    for (int i = -radius; i <= radius; ++i) {
      const double w = std::exp(-(i * i + j * j) / (2 * sigma * sigma));
      sum += w * in(std::clamp(x + i, 0, in.width() - 1), std::clamp(y + j, 0, in.height() - 1));
      weights += w;
    }
  return sum / weights;
}

}  // namespace corvid::oracle
