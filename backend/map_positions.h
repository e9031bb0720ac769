#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "backend/geo_alignment.h"
#include "backend/map_data.h"
#include "core/geodesy.h"
#include "corvid/options.h"

namespace corvid {

/// Positions of the keyframes, and where they put the map on Earth.
///
/// Fixes are kept in the order of time and interpolated to the keyframes' times. Everything else
/// follows from keyframes and fixes alone: all may be called whenever keyframes moved.
class MapPositions {
 public:
  explicit MapPositions(const BackendOptions& options) : options_(options) {}

  /// Fixes in any order of time; those with a problem are left out, as are those of a time that is
  /// known already and those that come more than a minute late.
  void add(std::span<const PositionFix> fixes);
  /// Aligns a segment with the positions around its newest keyframe, and sets the
  /// MapKeyframe::position of those keyframes whose position agrees. A map drifts: a position
  /// counts the less, the longer the way between it and the newest keyframe (standard deviation
  /// 2 % of the way), so that poses are right on Earth here and now. Where that is not enough, one
  /// similarity for all positions is tried.
  void follow(MapData& map, int segment);
  /// The same over the whole segment, where one similarity fits it; otherwise as follow().
  /// @return false if the map has drifted too far for one similarity.
  bool place_whole(MapData& map, int segment);
  /// Where the keyframes of a segment have to be so that one similarity fits: each moved by the
  /// similarity that follow() would have found there, in the frame of the last. A good start for an
  /// adjustment with positions, not more.
  /// @return for move_keyframes(): of every keyframe of the map; those of other segments stay.
  [[nodiscard]] std::vector<Sim3> straightened(const MapData& map, int segment);
  /// Whether any position ever came.
  [[nodiscard]] bool any() const { return frame_.has_value(); }
  /// A segment became part of another one.
  void forget_segment(int segment) { placements_.erase(segment); }
  /// Null if no position ever came.
  [[nodiscard]] std::shared_ptr<const MapPlacement> placement(int segment) const;

 private:
  struct Fix {
    std::int64_t time_ns = 0;
    Eigen::Vector3d p_ecef;
    Eigen::Matrix3d covariance_m2;  // east, north, up
  };
  /// What is known about one keyframe.
  struct Match {
    std::optional<Fix> fix;
    bool inlier = false;
  };

  void match(const MapData& map);
  [[nodiscard]] std::optional<Fix> at(const StoredFrame& frame, double since_last_s) const;
  [[nodiscard]] std::vector<std::size_t> placed_keyframes(const MapData& map, int segment) const;
  [[nodiscard]] std::vector<PlacedPoint> points_seen_from(
      const MapData& map, const std::vector<std::size_t>& placed,
      std::optional<std::size_t> reference) const;
  [[nodiscard]] GeoAlignment align(const MapData& map, const std::vector<std::size_t>& placed,
                                   std::optional<std::size_t> reference,
                                   const std::optional<Sim3>& guess) const;
  [[nodiscard]] std::optional<Sim3> known(int segment) const;
  void publish(MapData& map, int segment, const std::vector<std::size_t>& placed,
               const GeoAlignment& a);
  /// Fixes from before a time when all is settled.
  void forget(std::int64_t settled_ns);

  BackendOptions options_;
  std::deque<Fix> fixes_;  // by time
  std::map<std::string, Fix> by_name_;
  std::vector<Match> matches_;  // one per keyframe
  std::size_t settled_ = 0;     // keyframes whose match cannot change any more
  std::int64_t newest_frame_ns_ = INT64_MIN;
  std::optional<LocalFrame> frame_;
  bool frame_is_final_ = false;  // its origin agreed with a map
  std::map<int, std::shared_ptr<const MapPlacement>> placements_;
};

}  // namespace corvid
