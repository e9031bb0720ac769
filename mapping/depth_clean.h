#pragma once

#include <cstdint>
#include <span>

#include "corvid/map.h"
#include "mapping/slices.h"

namespace corvid {

/// Lowers the confidence of rays whose sweep had a second peak nearly as high as the best one
/// (repeated structure), and takes their answer away where the two cannot be told apart.
/// @param lead  of the best peak's score over the next best one's, per ray.
void weaken_ambiguous(DepthMap& map, const FloatImage& lead);

/// Another view's depth, to compare with.
struct DepthWitness {
  const DepthMap* map = nullptr;
  Pose T_witness_camera;  ///< from the compared map's camera coordinates
};

/// Takes away answers that lie in front of what witnesses see along the same ray (they see through
/// the point) and that no witness confirms within `tolerance` (relative). Points that a witness
/// cannot see or that lie behind its surface are not judged by it.
/// @param slice_end  called after every few rows.
/// @return how many were taken away.
int remove_contradicted(DepthMap& map, std::span<const DepthWitness> witnesses,
                        double tolerance = 0.02, const SliceEnd& slice_end = {});

/// How many views see each answer where it is: its own and the witnesses that confirm it within
/// `tolerance` (relative). 0: no answer.
[[nodiscard]] Image<std::uint8_t> count_agreeing(const DepthMap& map,
                                                 std::span<const DepthWitness> witnesses,
                                                 double tolerance);

/// Takes away islands of fewer than `min_rays` answers; 4-neighbours belong together if their
/// depths differ by less than `max_jump` (relative).
/// @return how many answers were taken away.
int remove_speckles(DepthMap& map, int min_rays, double max_jump = 0.03);

}  // namespace corvid
