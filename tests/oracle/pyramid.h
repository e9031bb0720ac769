#pragma once

#include <algorithm>

#include "corvid/image.h"

namespace corvid::oracle {

/// One level down: 5-tap binomial [1 4 6 4 1]/16 in both directions, border pixels repeated, even
/// pixels kept. Not rounded.
template <class Pixel>
Image<double> halve(const Image<Pixel>& in) {
  const double b[5] = {1 / 16., 4 / 16., 6 / 16., 4 / 16., 1 / 16.};
  Image<double> out((in.width() + 1) / 2, (in.height() + 1) / 2);
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x)
      for (int j = -2; j <= 2; ++j)
        for (int i = -2; i <= 2; ++i)
          out(x, y) += b[i + 2] * b[j + 2] *
                       in(std::clamp(2 * x + i, 0, in.width() - 1),
                          std::clamp(2 * y + j, 0, in.height() - 1));
  return out;
}

}  // namespace corvid::oracle
