#include "mapping/mapper.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "core/log.h"
#include "kernels/depth.h"
#include "mapping/depth_clean.h"
#include "mapping/mesher.h"
#include "mapping/view_choice.h"
#include "mapping/view_images.h"
#include "mapping/voxel_blocks.h"

namespace corvid {
namespace {

constexpr std::size_t kNewerKeyframes = 2;  ///< that a keyframe waits for
constexpr double kSkipBaseline = 0.02;      ///< share of the median depth
constexpr double kSkipRotation_rad = 0.09;  ///< about 5 degrees
constexpr double kRangeMargin = 1.5;        ///< beyond the landmarks' depths, either way
constexpr double kRefuseMotion_vox = 0.5;   ///< of points at the median depth
constexpr double kMinAnswered = 0.02;       ///< share of rays under which depth is no depth
constexpr double kWitnessTolerance = 0.02;  ///< relative
constexpr double kMinIsland = 5e-4;         ///< share of rays of the smallest island kept
constexpr double kVoxelsPerDepth = 96;      ///< options.h: voxel_size
constexpr double kRefitRatio = 2;           ///< of the voxel size wanted to the one there is
constexpr double kMinRescale = 1e-3;        ///< smaller changes of a depth map's scale are noise
constexpr int kRefinements = 2;
constexpr std::size_t kImageBudget_bytes = 64UL << 20;

double rotation_between(const Pose& a, const Pose& b) {
  return so3_log(a.rotation().conjugate() * b.rotation()).norm();
}

double median_of(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// What was done with one keyframe.
struct Entry {
  int segment = 0;
  StoredFramePtr frame;
  Camera lens;                            ///< that its image was undistorted with
  std::shared_ptr<const DepthMap> depth;  ///< null: tried or skipped
  double median_depth = 0;
  /// Depth of the keyframe's landmarks when `depth` was estimated: its unit of length.
  std::vector<std::pair<LandmarkId, double>> landmark_depths;
  std::optional<FusedView> fused;  ///< empty: not in the voxel map
};

}  // namespace

struct Mapper::Impl {
  Impl(std::shared_ptr<Device> device, const MappingOptions& o, MeshSink* s, SliceEnd end,
       DepthSweeper&& sweep, Warper&& warper)
      : options(o),
        sink(s),
        slice_end(std::move(end)),
        sweeper(std::move(sweep)),
        images(std::move(device), std::move(warper), o.depth_scale, kImageBudget_bytes) {}

  MappingOptions options;
  MeshSink* sink;
  SliceEnd slice_end;
  DepthSweeper sweeper;
  ViewImages images;
  std::optional<VoxelBlocks> volume;
  std::map<KeyframeId, Entry> entries;
  std::vector<std::shared_ptr<const DepthMap>> depth_maps;
  std::map<int, KeyframeId> last_mapped;  ///< by segment
  std::set<BlockIndex> shown;             ///< blocks that the sink has a surface of
  std::uint64_t version = 0;
  MapperStatistics counts;
  double answered_sum = 0;
  Timings timings;

  bool work(const MapSnapshot& map, bool at_end) {
    timings.clear();
    if (map.keyframes.empty()) return false;
    const int segment = main_segment(map);
    if (!volume && !make_volume(map, segment, at_end)) return false;
    refit_volume(segment);
    if (const auto index = next_keyframe(map, at_end)) {
      map_keyframe(map, *index, segment);
      return true;
    }
    return follow_poses(map, segment);
  }

  void end_slice() const {
    if (slice_end) slice_end();
  }

  static int main_segment(const MapSnapshot& map) {
    std::map<int, int> sizes;
    for (const auto& keyframe : map.keyframes) ++sizes[keyframe->segment];
    return std::max_element(sizes.begin(), sizes.end(),
                            [](const auto& a, const auto& b) { return a.second < b.second; })
        ->first;
  }

  /// The voxel size must be known before anything is fused.
  bool make_volume(const MapSnapshot& map, int segment, bool at_end) {
    double size = options.voxel_size;
    if (!(size > 0)) {
      constexpr std::size_t kKeyframes = 3;
      std::vector<double> medians;
      for (const auto& keyframe : map.keyframes) {
        if (keyframe->segment != segment || medians.size() == kKeyframes) continue;
        if (const auto scene = scene_depth(map, *keyframe)) medians.push_back(scene->median);
      }
      if (medians.empty() || (medians.size() < kKeyframes && !at_end)) return false;
      size = median_of(medians) / kVoxelsPerDepth;
    }
    volume.emplace(size, options.max_blocks, slice_end);
    return true;
  }

  /// A flight may start a hand's breadth over a table and go on into a hall: when the typical depth
  /// has left the voxel size behind, the volume starts again with a fitting one, and follow_poses()
  /// puts the depth maps back in, one by one.
  void refit_volume(int segment) {
    if (options.voxel_size > 0) return;
    std::vector<double> medians;
    for (const auto& [id, entry] : entries)
      if (entry.depth && entry.segment == segment) medians.push_back(entry.median_depth);
    if (medians.size() < 3) return;
    // The newest keyframes count on their own, too: voxels that are far too small for what is in
    // view now would use up the budget long before most keyframes agree.
    constexpr std::size_t kNewest = 5;
    const std::size_t newest = std::min(kNewest, medians.size());
    const double now =
        median_of({medians.end() - static_cast<std::ptrdiff_t>(newest), medians.end()});
    const double size = std::max(now, median_of(std::move(medians))) / kVoxelsPerDepth;
    const double ratio = size / volume->voxel_size();
    if (ratio < kRefitRatio && ratio > 1 / kRefitRatio) return;
    log().info("mapping: voxels of {:.4g} instead of {:.4g} map units", size, volume->voxel_size());
    counts.dropped_blocks += volume->dropped_blocks();
    volume.emplace(size, options.max_blocks, slice_end);
    for (auto& [id, entry] : entries) entry.fused.reset();
    ++version;
    if (sink)
      for (const BlockIndex& index : shown)
        sink->on_block({{index.x, index.y, index.z}, version, {}});
    shown.clear();
    ++counts.refits;
  }

  std::optional<std::size_t> next_keyframe(const MapSnapshot& map, bool at_end) const {
    for (std::size_t i = 0; i < map.keyframes.size(); ++i) {
      if (entries.contains(map.keyframes[i]->id)) continue;
      const std::size_t newest = i + kNewerKeyframes;
      const bool settled = newest < map.keyframes.size() ||
                           map.keyframes.back()->segment != map.keyframes[i]->segment;
      if (at_end || settled) return i;
      return std::nullopt;
    }
    return std::nullopt;
  }

  void map_keyframe(const MapSnapshot& map, std::size_t index, int segment) {
    const Keyframe& keyframe = *map.keyframes[index];
    Entry& entry = entries[keyframe.id];
    entry.segment = keyframe.segment;
    const auto scene = scene_depth(map, keyframe);
    if (scene && is_near_last(map, keyframe, scene->median)) {
      ++counts.skipped;
      return;
    }
    std::shared_ptr<DepthMap> depth;
    if (scene) depth = estimate(map, index, *scene);
    if (!depth) {
      ++counts.without_depth;
      log().debug("keyframe {}: no depth", keyframe.id.value);
      return;
    }
    entry.depth = depth;
    entry.frame = keyframe.frame;
    entry.lens = lens_of(map, keyframe);
    entry.median_depth = scene->median;
    entry.landmark_depths = landmark_depths(map, keyframe);
    last_mapped[keyframe.segment] = keyframe.id;
    depth_maps.push_back(depth);
    ++counts.depth_maps;
    if (keyframe.segment == segment) put_in(entry, keyframe.T_world_camera, map);
  }

  static std::vector<std::pair<LandmarkId, double>> landmark_depths(const MapSnapshot& map,
                                                                    const Keyframe& keyframe) {
    std::vector<std::pair<LandmarkId, double>> depths;
    const Pose T_camera_world = keyframe.T_world_camera.inverse();
    for (const Observation& o : keyframe.observations) {
      const Landmark* landmark = map.find(o.landmark);
      if (!landmark) continue;
      const double z = (T_camera_world * landmark->p_world).z();
      if (z > 0) depths.emplace_back(o.landmark, z);
    }
    return depths;
  }

  /// How much longer the keyframe's landmarks are away than when its depth was estimated: the scale
  /// of a single camera's map may change as it is adjusted. 1 if too few of them are left.
  static double scale_since(const Entry& entry, const MapSnapshot& map, const Keyframe& keyframe) {
    constexpr std::size_t kLandmarks = 10;
    std::vector<double> ratios;
    const auto now = landmark_depths(map, keyframe);
    auto then = entry.landmark_depths.begin();
    for (const auto& [id, z] : now) {
      while (then != entry.landmark_depths.end() && then->first < id) ++then;
      if (then == entry.landmark_depths.end()) break;
      if (then->first == id) ratios.push_back(z / then->second);
    }
    return ratios.size() < kLandmarks ? 1 : median_of(std::move(ratios));
  }

  void rescale(Entry& entry, double scale) {
    auto scaled = std::make_shared<DepthMap>(*entry.depth);
    for (std::size_t i = 0; i < scaled->depth.size(); ++i)
      scaled->depth.data()[i] *= static_cast<float>(scale);
    std::replace(depth_maps.begin(), depth_maps.end(), entry.depth,
                 std::shared_ptr<const DepthMap>(scaled));
    entry.depth = std::move(scaled);
    entry.median_depth *= scale;
    for (auto& [id, z] : entry.landmark_depths) z *= scale;
  }

  static Camera lens_of(const MapSnapshot& map, const Keyframe& keyframe) {
    return map.camera ? *map.camera : *keyframe.frame->camera;
  }

  bool is_near_last(const MapSnapshot& map, const Keyframe& keyframe, double median_depth) const {
    const auto last = last_mapped.find(keyframe.segment);
    if (last == last_mapped.end()) return false;
    const Keyframe* other = find(map, last->second);
    if (!other) return false;
    const Pose &a = keyframe.T_world_camera, &b = other->T_world_camera;
    return (a.translation() - b.translation()).norm() < kSkipBaseline * median_depth &&
           rotation_between(a, b) < kSkipRotation_rad;
  }

  static const Keyframe* find(const MapSnapshot& map, KeyframeId id) {
    const auto it = std::lower_bound(map.keyframes.begin(), map.keyframes.end(), id,
                                     [](const auto& k, KeyframeId i) { return k->id < i; });
    return it != map.keyframes.end() && (*it)->id == id ? it->get() : nullptr;
  }

  std::shared_ptr<DepthMap> estimate(const MapSnapshot& map, std::size_t index,
                                     const SceneDepth& scene) {
    Stopwatch watch;
    const Keyframe& keyframe = *map.keyframes[index];
    const Camera lens = lens_of(map, keyframe);
    auto depth = std::make_shared<DepthMap>();
    depth->keyframe = keyframe.id;
    depth->camera = images.camera_of(lens);
    depth->T_world_camera = keyframe.T_world_camera;
    if (std::min(depth->camera.width_px, depth->camera.height_px) < options.template_px) {
      return nullptr;
    }
    // The kernels count the elements of their volumes in 32 bits.
    const double elements = (depth->camera.width_px + 64.0) * (depth->camera.height_px + 32.0) *
                            options.neighbours * std::max(0.125 * options.depth_samples, 7.0);
    if (elements > 2e9) {
      log().warn(
          "keyframe {}: no depth: {:.0f} elements are too many for one sweep; raise "
          "mapping.depth_scale",
          keyframe.id.value, elements);
      return nullptr;
    }
    const double near = scene.near / kRangeMargin, far = scene.far * kRangeMargin;
    ViewChoiceOptions choice;
    choice.neighbours = options.neighbours;
    choice.focal_px = depth->camera.fx_px;
    choice.inverse_depth_step = (1 / near - 1 / far) / (options.depth_samples - 1);
    const std::vector<Neighbour> chosen = choose_neighbours(map, index, choice);

    const auto reference = images.sweep_image(keyframe, lens, sweeper);
    if (!reference) return nullptr;
    std::vector<std::shared_ptr<const SweepImage>> held;
    std::vector<SweepNeighbour> neighbours;
    std::vector<DepthWitness> witnesses;
    for (const Neighbour& n : chosen) {
      const Keyframe& other = *map.keyframes[n.index];
      end_slice();
      const auto image = images.sweep_image(other, lens, sweeper);
      if (!image) continue;
      held.push_back(image);
      const Pose T_other_this = other.T_world_camera.inverse() * keyframe.T_world_camera;
      neighbours.push_back({image.get(), depth->camera, T_other_this});
      const auto known = entries.find(other.id);
      if (known != entries.end() && known->second.depth) {
        witnesses.push_back({known->second.depth.get(), T_other_this});
      }
    }
    timings.emplace_back("images", watch.lap_ms());
    if (static_cast<int>(neighbours.size()) < options.min_views) return nullptr;

    SweepResult result = sweeper.estimate({reference.get(), depth->camera, neighbours, near, far,
                                           options.depth_samples, true, kRefinements});
    depth->depth = std::move(result.depth);
    depth->confidence = std::move(result.confidence);
    timings.emplace_back("depth", watch.lap_ms());

    end_slice();
    weaken_ambiguous(*depth, result.lead);
    remove_contradicted(*depth, witnesses, kWitnessTolerance, slice_end);
    end_slice();
    const auto rays = static_cast<double>(depth->depth.size());
    remove_speckles(*depth, static_cast<int>(kMinIsland * rays));
    const double answered = static_cast<double>(std::count_if(
                                depth->depth.data(), depth->depth.data() + depth->depth.size(),
                                [](float z) { return z > 0; })) /
                            rays;
    timings.emplace_back("clean", watch.lap_ms());
    if (answered < kMinAnswered) return nullptr;
    answered_sum += answered;
    return depth;
  }

  /// Re-fuses the keyframe that moved farthest, if one moved far enough; takes out what is no
  /// longer part of the map.
  bool follow_poses(const MapSnapshot& map, int segment) {
    Entry* worst = nullptr;
    const Keyframe* worst_keyframe = nullptr;
    double worst_motion = kRefuseMotion_vox * volume->voxel_size(), worst_scale = 1;
    constexpr int kSliceEntries = 8;
    Slicer looks(slice_end, kSliceEntries);
    for (auto& [id, entry] : entries) {
      if (!entry.depth) continue;
      looks.piece();
      const Keyframe* keyframe = find(map, id);
      if (keyframe) entry.segment = keyframe->segment;  // segments that meet become one
      const bool wanted = keyframe && keyframe->segment == segment;
      double scale = wanted ? scale_since(entry, map, *keyframe) : 1;
      if (std::abs(scale - 1) < kMinRescale) scale = 1;
      double motion = 0;
      if (wanted != entry.fused.has_value()) {
        motion = std::numeric_limits<double>::infinity();
      } else if (wanted) {
        const Pose &now = keyframe->T_world_camera, &then = entry.fused->T_world_camera;
        motion = (now.translation() - then.translation()).norm() +
                 rotation_between(now, then) * entry.median_depth +
                 std::abs(scale - 1) * entry.median_depth;
      }
      if (motion <= worst_motion) continue;
      worst = &entry;
      worst_keyframe = wanted ? keyframe : nullptr;
      worst_motion = motion;
      worst_scale = scale;
    }
    if (!worst) return false;
    end_slice();
    if (worst->fused) {
      Stopwatch watch;
      volume->unfuse(*worst->fused, *worst->depth,
                     images.colours(*worst->frame->load(), worst->lens));
      worst->fused.reset();
      timings.emplace_back("unfuse", watch.lap_ms());
      counts.refusions += worst_keyframe != nullptr;
    }
    if (worst_keyframe) {
      if (worst_scale != 1) rescale(*worst, worst_scale);
      put_in(*worst, worst_keyframe->T_world_camera, map);
    } else {
      show_changes();
    }
    return true;
  }

  void put_in(Entry& entry, const Pose& T_world_camera, const MapSnapshot& map) {
    end_slice();
    Stopwatch watch;
    const Eigen::Vector3d p_newest = map.keyframes.back()->T_world_camera.translation();
    entry.fused = volume->fuse(*entry.depth, images.colours(*entry.frame->load(), entry.lens),
                               T_world_camera, p_newest);
    timings.emplace_back("fuse", watch.lap_ms());
    show_changes();
  }

  void show_changes() {
    const std::vector<BlockIndex> changed = volume->take_changed();
    if (!sink || changed.empty()) return;
    Stopwatch watch;
    ++version;
    constexpr int kSliceBlocks = 16;
    Slicer meshed(slice_end, kSliceBlocks);
    for (const BlockIndex& index : blocks_to_remesh(changed)) {
      meshed.piece();
      MeshBlock block{{index.x, index.y, index.z}, version, mesh_block(*volume, index)};
      if (block.mesh.empty() ? shown.erase(index) == 0 : (shown.insert(index), false)) continue;
      sink->on_block(block);
    }
    timings.emplace_back("mesh", watch.lap_ms());
  }
};

Expected<std::unique_ptr<Mapper>> Mapper::create(std::shared_ptr<Device> device,
                                                 const MappingOptions& options, MeshSink* sink,
                                                 SliceEnd slice_end) {
  if (const auto problems = options.validate(); !problems.empty()) {
    return fail(ErrorCode::invalid_argument, problems.front(), "mapping options");
  }
  DepthSweepOptions sweep;
  sweep.template_px = options.template_px;
  sweep.min_score = options.min_score;
  sweep.min_views = options.min_views;
  auto sweeper = DepthSweeper::create(device, sweep);
  if (!sweeper) return tl::unexpected(sweeper.error());
  auto warper = Warper::create(device);
  if (!warper) return tl::unexpected(warper.error());
  return std::unique_ptr<Mapper>(
      new Mapper(std::make_unique<Impl>(std::move(device), options, sink, std::move(slice_end),
                                        std::move(*sweeper), std::move(*warper))));
}

Mapper::Mapper(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Mapper::~Mapper() = default;

bool Mapper::step(const MapSnapshot& map) { return impl_->work(map, false); }

void Mapper::finish(const MapSnapshot& map, const std::stop_token& stop) {
  while (!stop.stop_requested() && impl_->work(map, true)) {
  }
}

TriangleMesh Mapper::mesh() const {
  return impl_->volume ? mesh_all(*impl_->volume) : TriangleMesh{};
}

const std::vector<std::shared_ptr<const DepthMap>>& Mapper::depth_maps() const {
  return impl_->depth_maps;
}

double Mapper::voxel_size() const { return impl_->volume ? impl_->volume->voxel_size() : 0; }

MapperStatistics Mapper::statistics() const {
  MapperStatistics out = impl_->counts;
  if (impl_->volume) {
    out.blocks = impl_->volume->size();
    out.dropped_blocks += impl_->volume->dropped_blocks();
  }
  if (out.depth_maps > 0) out.answered = impl_->answered_sum / static_cast<double>(out.depth_maps);
  return out;
}

const Timings& Mapper::last_timings() const { return impl_->timings; }

}  // namespace corvid
