#pragma once

#include <cstddef>
#include <optional>
#include <span>

namespace corvid {

/// Ratio-inequalities test (thesis 4.4.3): the index of the lowest of the costs d1 <= d2 <= ... if
/// d2 / d1 > ratio, d1 < global and d2 > global: the best is good, and no other is. A cost that is
/// alone needs d1 < global only. Nothing for no costs; a cost that is not a number is never chosen.
[[nodiscard]] std::optional<std::size_t> ratio_inequalities(std::span<const double> costs,
                                                            double ratio, double global);

/// The same for costs that are known already; d2 = infinity: there is no second.
[[nodiscard]] constexpr bool ratio_inequalities(double d1, double d2, double ratio, double global) {
  return d2 > ratio * d1 && d1 < global && d2 > global;
}

}  // namespace corvid
