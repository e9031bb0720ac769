#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/plot.h"
#include "apps/render_mesh.h"
#include "corvid/map.h"

namespace corvid {

/// At most `count` positions in [0, size), evenly spread, both ends included.
[[nodiscard]] std::vector<std::size_t> spread_indices(std::size_t size, std::size_t count);

/// Near is red, far is blue (turbo colours of the inverse depth between its 2nd and 98th
/// percentile); no answer is see-through.
struct DepthPicture {
  MeshPicture picture;
  double near = 0, far = 0;  ///< the percentiles [map units]; 0 if the map has no answer
};
[[nodiscard]] DepthPicture picture_of_depth(const FloatImage& depth);

/// Viridis colours of the confidence from 0 (dark) to 1 (yellow); no answer is see-through.
[[nodiscard]] MeshPicture picture_of_confidence(const FloatImage& confidence);

/// Scaled to at most `max_width_px`, averaging.
[[nodiscard]] MeshPicture shrink(MeshPicture picture, int max_width_px);
[[nodiscard]] ColourImage shrink(const ColourImage& image, int max_width_px);
[[nodiscard]] ColourImage grey_as_colour(const GreyImage& image);

/// The landmarks from above, in their own colours on a dark ground: the middle 98 % along each axis
/// and all camera positions. Nothing for an empty map.
[[nodiscard]] std::optional<PlotPicture> picture_of_landmarks(
    const Landmarks& landmarks, const std::vector<Eigen::Vector2d>& path, const ViewAxes& axes);

}  // namespace corvid
