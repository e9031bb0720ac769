#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/stopwatch.h"
#include "core/tracks.h"
#include "corvid/error.h"
#include "corvid/options.h"
#include "frontend/pair_matcher.h"
#include "frontend/track_search.h"
#include "frontend/window_matcher.h"
#include "kernels/corners.h"
#include "kernels/device.h"
#include "kernels/ncc.h"
#include "kernels/pyramid.h"

namespace corvid {

/// What happened to the tracks of one frame.
struct FrontendCounts {
  int before = 0;             ///< tracks that were looked for
  int found = 0;              ///< by the bounded search
  int recovered = 0;          ///< by the wide search after it
  int epipolar_outliers = 0;  ///< found, but against the geometry of the others
  int merged = 0;             ///< ended, since an older track follows the same feature
  int added = 0;              ///< new corners
};

/// Follows features from frame to frame by NCC against the keyframe in which each was cut.
///
/// Each frame: predict every track (from the backend's poses and landmarks where known, otherwise
/// from the motion of its neighbours), search coarse to fine with a warped template, look more
/// widely for what was not found, throw out what breaks the epipolar geometry to the last
/// keyframe, decide on a keyframe, fill empty places with new corners. When nearly nothing is where
/// it was (a jump of the camera, lost frames), the last image is matched with this one from
/// nothing. Photographs are left to a WindowMatcher. One owner; not thread-safe.
class Frontend {
 public:
  /// @param stills  frames are photographs far apart: every one becomes a keyframe, and all pairs
  ///                of a window are matched from nothing.
  [[nodiscard]] static Expected<std::unique_ptr<Frontend>> create(
      std::shared_ptr<Device> device, const FrontendOptions& options, bool stills,
      const MatchingOptions& matching = {});

  /// @param motion  the backend's newest state; null if there is none yet.
  /// @return the tracks seen in this frame. Empty if nothing of the last frames is seen any more.
  /// Throws DeviceFault if the device fails.
  [[nodiscard]] FrameTracks process(const FramePtr& frame, const MotionState* motion);

  [[nodiscard]] const FrontendCounts& last_counts() const { return counts_; }
  [[nodiscard]] const Timings& last_timings_ms() const { return timings_; }

 private:
  struct Anchor {
    std::shared_ptr<const DevicePyramid> pyramid;
    FrameId frame;
    bool keyframe = false;
  };
  struct Track {
    TrackId id;
    Eigen::Vector2d pixel;        ///< in the last frame where it was found
    Eigen::Vector2d velocity_px;  ///< last displacement between frames
    bool found_before = false;    ///< there is a velocity
    Eigen::Vector2d keyframe_px;  ///< undistorted, in the last keyframe
    std::shared_ptr<const Anchor> anchor;
    Eigen::Vector2d anchor_px;
    /// Of `pixel` and `anchor_px`, relative to the track's first place, which is right by
    /// definition: the feature is what lies there.
    Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Zero();
    Eigen::Matrix2d anchor_covariance_px2 = Eigen::Matrix2d::Zero();
    Eigen::Matrix2d warp = Eigen::Matrix2d::Identity();
  };

  Frontend(const FrontendOptions& options, PyramidBuilder pyramids, CornerDetector corners,
           NccMatcher matcher);

  [[nodiscard]] FrameTracks process_still(const FramePtr& frame, const MotionState* motion);

  /// Where the track is seen from a pose, if the backend knows its landmark.
  [[nodiscard]] static std::optional<SearchQuery> predict(const Track& track, const Camera& camera,
                                                          const MotionState& motion,
                                                          const Pose& T_world_camera);
  /// Looks for every track near its predicted place; score 0 where there is none above min_score.
  [[nodiscard]] std::vector<SearchCandidate> search(const Frame& frame, const MotionState* motion);
  /// Looks for the tracks that were not found, around where their found neighbours went.
  void recover(const Camera& camera, std::vector<SearchCandidate>& found);
  /// Looks for all tracks by matching the last image with this one from nothing.
  void rematch(const Frame& frame, std::vector<SearchCandidate>& found);
  /// A match of a template of the last frame: if it is good, the track is anchored there.
  bool accept_recovered(Track& track, const SearchQuery& query, const SearchCandidate& match);
  void reject_outliers(const Camera& camera, std::vector<SearchCandidate>& found);
  /// Ends tracks that follow the same feature as an older one, and takes back their observations.
  void merge(std::vector<TrackObservation>& observations);
  [[nodiscard]] bool keyframe_due(const Camera& camera) const;
  void make_keyframe(const Frame& frame);
  void reset();

  FrontendOptions options_;
  PyramidBuilder pyramids_;
  CornerDetector corners_;
  NccMatcher matcher_;
  TrackSearch search_;
  std::unique_ptr<WindowMatcher> window_;  ///< of stills; else null
  std::unique_ptr<PairMatcher> pairs_;     ///< after jumps; null for stills

  std::vector<Track> tracks_;               ///< by id
  std::shared_ptr<const Anchor> previous_;  ///< the last frame in which the tracks were found
  std::shared_ptr<const Anchor> current_;
  FramePtr previous_frame_;          ///< that of previous_
  std::size_t keyframe_tracks_ = 0;  ///< alive at the last keyframe
  int misses_ = 0;                   ///< frames in a row in which nearly nothing was found
  std::uint32_t next_track_ = 0;
  std::uint64_t frame_count_ = 0;
  FrontendCounts counts_;
  Timings timings_;
};

}  // namespace corvid
