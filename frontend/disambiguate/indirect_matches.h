#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

namespace corvid {

/// Matches of an image to a third one through a second (thesis 4.4.8): x_1 <-> x_2 and
/// x^_2 <-> x_3 chain into x_1 <-> x_3 where x^_2 is the only one near x_2 by
/// ratio_inequalities() on the distances.
///
/// @param x_2      of each point of the first image, its match in the second [px], if it has one.
/// @param x_2_hat  N points of the second image that have matches in the third [px].
/// @param x_3      those N matches [px].
/// @return of each point of the first image, x_3 or nothing.
[[nodiscard]] std::vector<std::optional<Eigen::Vector2d>> indirect_matches(
    std::span<const std::optional<Eigen::Vector2d>> x_2, std::span<const Eigen::Vector2d> x_2_hat,
    std::span<const Eigen::Vector2d> x_3, double ratio, double global_px);

}  // namespace corvid
