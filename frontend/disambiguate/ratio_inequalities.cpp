#include "frontend/disambiguate/ratio_inequalities.h"

#include <limits>

namespace corvid {

std::optional<std::size_t> ratio_inequalities(std::span<const double> costs, double ratio,
                                              double global) {
  double d1 = std::numeric_limits<double>::infinity(), d2 = d1;
  std::size_t best = 0;
  for (std::size_t k = 0; k < costs.size(); ++k) {
    if (costs[k] < d1) {
      d2 = d1;
      d1 = costs[k];
      best = k;
    } else if (costs[k] < d2) {
      d2 = costs[k];
    }
  }
  if (!ratio_inequalities(d1, d2, ratio, global)) return std::nullopt;
  return best;
}

}  // namespace corvid
