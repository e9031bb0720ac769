#pragma once

#include <span>
#include <string>
#include <string_view>

namespace corvid {

/// The candidate that a mistyped name most likely meant: least edit distance (insert, delete,
/// replace, swap of neighbours; case ignored), at most a third of the letters; else the first that
/// ends in ".name", for a forgotten section; else nothing. The first of equals wins.
/// O(candidates * length^2).
[[nodiscard]] std::string nearest_name(std::string_view name,
                                       std::span<const std::string> candidates);

/// "did you mean X?", or nothing where no candidate is close.
[[nodiscard]] std::string nearest_hint(std::string_view name,
                                       std::span<const std::string> candidates);

}  // namespace corvid
