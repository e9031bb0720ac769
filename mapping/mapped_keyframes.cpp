#include "mapping/mapped_keyframes.h"

#include <cmath>
#include <limits>

#include "core/log.h"
#include "core/median.h"

namespace corvid {
namespace {

constexpr double kMinGrowth = 1e-3;  ///< smaller changes of a depth map's scale are noise
constexpr std::size_t kMinLandmarks = 10;
constexpr int kSliceLooks = 8;
constexpr int kTryAgainAfter = 50;  ///< keyframes

std::vector<std::pair<LandmarkId, double>> landmark_depths(const MapSnapshot& map,
                                                           const Keyframe& keyframe) {
  std::vector<std::pair<LandmarkId, double>> depths;
  const Pose T_camera_world = keyframe.T_world_camera.inverse();
  for (const Observation& o : keyframe.observations) {
    const Landmark* landmark = map.landmarks.find(o.landmark);
    if (!landmark) continue;
    const double z = (T_camera_world * landmark->p_world).z();
    if (z > 0) depths.emplace_back(o.landmark, z);
  }
  return depths;
}

/// How much longer the keyframe's landmarks are away than when its depth was estimated: the scale
/// of a single camera's map may change as it is adjusted. 1 if too few of them are left.
double growth_since(const MappedKeyframe& entry, const MapSnapshot& map, const Keyframe& keyframe) {
  std::vector<double> ratios;
  auto then = entry.landmark_depths.begin();
  for (const auto& [id, z] : landmark_depths(map, keyframe)) {
    while (then != entry.landmark_depths.end() && then->first < id) ++then;
    if (then == entry.landmark_depths.end()) break;
    if (then->first == id) ratios.push_back(z / then->second);
  }
  if (ratios.size() < kMinLandmarks) return 1;
  const double growth = upper_median(std::move(ratios));
  return std::abs(growth - 1) < kMinGrowth ? 1 : growth;
}

}  // namespace

MappedKeyframe::MappedKeyframe(const MapSnapshot& map, const Keyframe& keyframe,
                               const Camera& image_lens, StoredDepth depth_map, double median)
    : segment(keyframe.segment),
      frame(keyframe.frame),
      lens(image_lens),
      depth(std::move(depth_map)),
      median_depth(median),
      landmark_depths(corvid::landmark_depths(map, keyframe)) {}

MappedKeyframe& MappedKeyframes::add(KeyframeId id, MappedKeyframe keyframe) {
  in_memory_.push_back(keyframe.depth);
  in_memory_bytes_ += keyframe.depth.image_bytes();
  if (untried_ > 0) --untried_;
  while (archive_ && untried_ == 0 && in_memory_.size() > 1 && in_memory_bytes_ > memory_bytes_) {
    if (const auto away = in_memory_.front().put_away(archive_); !away) {
      log().warn("mapping: depth maps stay in memory for now: {}", away.error().to_string());
      untried_ = kTryAgainAfter;
      break;
    }
    in_memory_bytes_ -= in_memory_.front().image_bytes();
    in_memory_.pop_front();
  }
  return keyframes_.insert_or_assign(id, std::move(keyframe)).first->second;
}

const MappedKeyframe* MappedKeyframes::find(KeyframeId id) const {
  const auto it = keyframes_.find(id);
  return it == keyframes_.end() ? nullptr : &it->second;
}

std::vector<StoredDepth> MappedKeyframes::depth_maps(const MapSnapshot& map) const {
  std::vector<StoredDepth> out;
  auto now = map.keyframes.begin();
  for (const auto& [id, entry] : keyframes_) {
    out.push_back(entry.depth);
    while (now != map.keyframes.end() && (*now)->id < id) ++now;
    if (now == map.keyframes.end() || (*now)->id != id) continue;
    out.back().T_world_camera = (*now)->T_world_camera;
    out.back().scale *= growth_since(entry, map, **now);
  }
  return out;
}

void MappedKeyframes::drop(KeyframeId id) {
  const auto it = keyframes_.find(id);
  if (it == keyframes_.end()) return;
  moved_.erase({it->second.motion, id});
  keyframes_.erase(it);
}

void MappedKeyframes::forget_fused() {
  for (auto& [id, entry] : keyframes_) entry.fused.reset();
  segment_.reset();
}

void MappedKeyframes::measure(MappedKeyframe& entry, const MapSnapshot& map, bool wanted) const {
  entry.motion = 0;
  entry.growth = wanted ? growth_since(entry, map, *entry.looked_at) : 1;
  if (wanted != entry.fused.has_value()) {
    entry.motion = std::numeric_limits<double>::infinity();
  } else if (wanted) {
    const Pose &now = entry.looked_at->T_world_camera, &then = entry.fused->T_world_camera;
    entry.motion = (now.translation() - then.translation()).norm() +
                   (so3_log(now.rotation().conjugate() * then.rotation()).norm() +
                    std::abs(entry.growth - 1)) *
                       entry.median_depth;
  }
}

void MappedKeyframes::look(const MapSnapshot& map, int segment, double least,
                           const SliceEnd& slice_end) {
  const bool anew = segment_ != segment;
  segment_ = segment;
  Slicer looks(slice_end, kSliceLooks);
  auto now = map.keyframes.begin();
  for (auto& [id, entry] : keyframes_) {
    while (now != map.keyframes.end() && (*now)->id < id) ++now;
    const bool there = now != map.keyframes.end() && (*now)->id == id;
    const auto keyframe = there ? *now : nullptr;
    if (!anew && keyframe == entry.looked_at) continue;
    looks.piece();
    moved_.erase({entry.motion, id});
    entry.looked_at = keyframe;
    if (keyframe) entry.segment = keyframe->segment;  // segments that meet become one
    measure(entry, map, keyframe && keyframe->segment == segment);
    if (entry.motion > least) moved_.emplace(entry.motion, id);
  }
}

std::optional<MappedKeyframes::Move> MappedKeyframes::next_move() {
  if (moved_.empty()) return std::nullopt;
  const auto farthest = std::prev(moved_.end());
  MappedKeyframe& entry = keyframes_.at(farthest->second);
  moved_.erase(farthest);
  return Move{&entry, entry.looked_at && entry.segment == segment_};
}

}  // namespace corvid
