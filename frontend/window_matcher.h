#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/stopwatch.h"
#include "core/tracks.h"
#include "corvid/camera.h"
#include "corvid/error.h"
#include "corvid/ids.h"
#include "corvid/image.h"
#include "corvid/options.h"
#include "frontend/pair_matcher.h"
#include "kernels/device.h"

namespace corvid {

/// Reference and target, counted from 0 within a window.
using FramePair = std::pair<int, int>;
/// The pairs of a window of `frames` images whose target is `first_new` or later, in the order of
/// thesis 4.1: narrow baselines first, older references first. All of a window of 4 (counted from
/// 1): 1-2, 2-3, 3-4, 1-3, 2-4, 1-4; when it has moved one frame on: 3-4, 2-4, 1-4.
[[nodiscard]] std::vector<FramePair> window_pairs(int frames, int first_new = 1);

/// Places of one track in the newest frame, as matches from older frames of the window give them.
struct TrackPlace {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  /// Relative to the track's first place [px^2].
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Identity();
  float score = 0;
};
/// The one with the smallest covariance, if the others agree with it within their covariances;
/// nothing if they do not. Never empty.
[[nodiscard]] std::optional<TrackPlace> agreed_place(std::span<const TrackPlace> places);

/// What became of one pair of the window.
struct WindowPair {
  std::uint64_t reference = 0, target = 0;  ///< frames, counted from 0 since the start
  std::size_t matches = 0;
  std::string refusal;  ///< why there is no geometry; else empty
  Timings timings;      ///< [ms] by step
};

/// What the newest frame gave.
struct WindowFrame {
  std::vector<TrackObservation> observations;  ///< ascending by track
  std::size_t before = 0;                      ///< tracks that were looked for
  std::size_t carried = 0;                     ///< the first so many were seen before
  std::size_t merged = 0;                      ///< tracks that came to the place of an older one
  std::size_t disagreed = 0;                   ///< tracks ended: two matches put them apart
  std::vector<WindowPair> pairs;               ///< in the order in which they were matched
  Timings timings;                             ///< [ms] by step
};

/// Tracks over a sliding window of R_f images (thesis 4.1): every image is matched with each older
/// one of the window, so that a feature that one pair loses is found by another, and one that two
/// pairs find is checked. Images in between serve as third views.
///
/// The points of an image are the places of the tracks that were followed into it, exactly, and
/// then new corners, each a track of its own. A track has one place in a frame at most.
///
/// Deterministic. One owner; pairs are matched in turn, because the device has one owner and its
/// kernels use all cores. Throws DeviceFault.
class WindowMatcher {
 public:
  [[nodiscard]] static Expected<std::unique_ptr<WindowMatcher>> create(
      std::shared_ptr<Device> device, const MatchingOptions& options);

  [[nodiscard]] WindowFrame add(const GreyImage& image, const Camera& camera);
  /// These tracks are followed no more.
  void end(std::span<const TrackId> tracks);

 private:
  struct View {
    MatchView view;
    std::vector<std::optional<TrackId>> tracks;  ///< of each point; nothing: the track was ended
    /// Of each point, relative to its track's first place.
    std::vector<Eigen::Matrix2d> covariances_px2;
    std::vector<PairMatches> to_newer;  ///< to each later view of the window
  };
  struct Seen {
    TrackId track;
    TrackPlace place;
  };

  WindowMatcher(std::unique_ptr<PairMatcher> matcher, const MatchingOptions& options)
      : matcher_(std::move(matcher)), options_(options) {}

  [[nodiscard]] PairMatches match(int reference, int target);
  /// x_t^T F x_r = 0 from features that narrower pairs lead from one view to the other (thesis
  /// 4.4.8); nothing if there are too few.
  [[nodiscard]] std::optional<Eigen::Matrix3d> chained_fundamental(int reference, int target) const;
  /// Every track's place in the newest view, ascending by track.
  [[nodiscard]] std::vector<Seen> follow(WindowFrame& result);
  /// Of tracks at the same place the oldest goes on; the others end.
  [[nodiscard]] std::vector<Seen> merge(const std::vector<Seen>& seen, WindowFrame& result);

  std::unique_ptr<PairMatcher> matcher_;
  MatchingOptions options_;
  std::deque<View> views_;    ///< oldest first; at most R_f
  std::uint64_t frames_ = 0;  ///< so far
  std::uint32_t next_track_ = 0;
};

}  // namespace corvid
