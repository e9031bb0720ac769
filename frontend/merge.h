#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

namespace corvid {

/// Points that follow the same feature as an earlier one: closer to it than `distance_px`, and both
/// moved alike, within the same distance. Indices, ascending; the first of each group is not in it.
/// Two features at different depths that pass each other move differently and are left alone.
/// @param pixels, velocities_px  one per point, finite; oldest first. No velocities: the places
///                               alone decide.
[[nodiscard]] std::vector<std::size_t> find_duplicates(
    std::span<const Eigen::Vector2d> pixels, std::span<const Eigen::Vector2d> velocities_px,
    double distance_px);

}  // namespace corvid
