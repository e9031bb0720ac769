#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "corvid/camera.h"
#include "corvid/ids.h"

namespace corvid {

/// A landmark of an older keyframe, found again in another frame by NCC.
struct PlaceView {
  TrackId landmark;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  ///< in that frame, distorted image
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Identity();
};

/// What a frame shares with one older keyframe.
struct PlaceReference {
  FrameId keyframe;
  double similarity = 0;         ///< of the two images, at most 1
  double share = 0;              ///< found, of its landmarks that should be in view
  std::vector<PlaceView> views;  ///< ascending by landmark
};

/// A frame shows places that older keyframes show, too: what the frontend tells the backend when
/// the camera comes back, was lost, or flies into another part of the map.
struct PlaceMatch {
  FrameId query;
  std::vector<PlaceReference> references;  ///< most similar first; empty: nothing was found
};

/// How many of the image's 4 x 4 parts have one of the pixels: matches in one corner prove little.
/// Pixels beyond the image count for the part nearest to them.
[[nodiscard]] int parts_seen(const Camera& camera, std::span<const Eigen::Vector2d> pixels);
constexpr int kMinPartsSeen = 5;

}  // namespace corvid
