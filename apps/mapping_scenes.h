#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <stop_token>
#include <string>

#include "bench/mapping_scene.h"
#include "corvid/error.h"
#include "corvid/ports.h"

namespace corvid {

/// Every `step`-th frame of a source that has a true pose, `count` at most, with true depth:
/// rendered for the synthetic flight, a depth camera's for 7-Scenes, none for others and
/// where its image cannot be read (depth images are empty of answers). All frames must be of one
/// camera. Errors: of the source; interrupted; unsupported: fewer than 5 views with poses.
[[nodiscard]] Expected<MappingScene> read_mapping_scene(FrameSource& source, int step, int count,
                                                        const std::stop_token& stop);

/// Whether any pixel of it has true depth.
[[nodiscard]] bool has_true_depth(const MappingScene& scene);

/// The bounding box that the README of a Middlebury set names; nothing if there is none.
[[nodiscard]] std::optional<Eigen::AlignedBox3d> middlebury_box(const std::string& folder);

}  // namespace corvid
