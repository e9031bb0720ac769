#pragma once

#include <cmath>

#include "corvid/image.h"

namespace corvid::oracle {

struct CornerScore {
  double lambda_min = 0, harris = 0;
};

/// Scores of one pixel at least 4 px from the border, from the definition: central differences, 7x7
/// Gaussian window of sigma 1.5, eigenvalues of the 2x2 tensor.
inline CornerScore corner_score(const GreyImage& image, int x, int y, double kappa) {
  double xx = 0, xy = 0, yy = 0, sum = 0;
  for (int j = -3; j <= 3; ++j) {
    for (int i = -3; i <= 3; ++i) {
      const double w = std::exp(-(i * i + j * j) / (2 * 1.5 * 1.5));
      const double gx = (image(x + i + 1, y + j) - image(x + i - 1, y + j)) / 2.;
      const double gy = (image(x + i, y + j + 1) - image(x + i, y + j - 1)) / 2.;
      xx += w * gx * gx;
      xy += w * gx * gy;
      yy += w * gy * gy;
      sum += w;
    }
  }
  xx /= sum;
  xy /= sum;
  yy /= sum;
  const double mean = (xx + yy) / 2, spread = std::hypot((xx - yy) / 2, xy);
  return {mean - spread, xx * yy - xy * xy - kappa * (xx + yy) * (xx + yy)};
}

}  // namespace corvid::oracle
