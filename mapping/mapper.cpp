#include "mapping/mapper.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "core/log.h"
#include "core/median.h"
#include "kernels/depth.h"
#include "mapping/depth_clean.h"
#include "mapping/mapped_keyframes.h"
#include "mapping/mesher.h"
#include "mapping/view_choice.h"
#include "mapping/view_images.h"
#include "mapping/voxel_blocks.h"

namespace corvid {
namespace {

constexpr std::size_t kNewerKeyframes = 2;  ///< that a keyframe waits for
constexpr double kSkipBaseline = 0.02;      ///< share of the median depth
constexpr double kSkipRotation_rad = 0.09;  ///< about 5 degrees
constexpr double kKnownBaseline = 0.05;     ///< instead of kSkipBaseline, of much older keyframes
constexpr std::uint32_t kMuchOlder = 30;    ///< keyframes
constexpr double kRangeMargin = 1.5;        ///< beyond the landmarks' depths, either way
constexpr double kRefuseMotion_vox = 0.5;   ///< of points at the median depth
constexpr double kMinAnswered = 0.02;       ///< share of rays under which depth is no depth
constexpr double kWitnessTolerance = 0.02;  ///< relative
constexpr double kMinIsland = 5e-4;         ///< share of rays of the smallest island kept
constexpr double kVoxelsPerDepth = 96;      ///< options.h: voxel_size
constexpr double kRefitRatio = 2;           ///< of the voxel size wanted to the one there is
constexpr double kDepthShare = 0.25;        ///< of the memory budget; the rest is for voxels
constexpr int kRefinements = 2;
constexpr std::size_t kImageBudget_bytes = 64UL << 20;

double rotation_between(const Pose& a, const Pose& b) {
  return so3_log(a.rotation().conjugate() * b.rotation()).norm();
}

}  // namespace

struct Mapper::Impl {
  Impl(std::shared_ptr<Device> device, const MappingOptions& o, MeshSink* s,
       std::shared_ptr<Archive> store, SliceEnd end, DepthSweeper&& sweep, Warper&& warper)
      : options(o),
        sink(s),
        archive(std::move(store)),
        slice_end(std::move(end)),
        sweeper(std::move(sweep)),
        images(std::move(device), std::move(warper), o.depth_scale, kImageBudget_bytes),
        mapped(static_cast<std::size_t>(kDepthShare * memory_bytes()), archive) {}

  MappingOptions options;
  MeshSink* sink;
  std::shared_ptr<Archive> archive;
  SliceEnd slice_end;
  DepthSweeper sweeper;
  ViewImages images;
  std::optional<VoxelBlocks> volume;
  MappedKeyframes mapped;
  std::optional<KeyframeId> last_tried;
  bool fit_is_stale = false;              ///< the scene's depth may ask for other voxels
  bool refitting = false;                 ///< keyframes are on their way back into the volume
  std::map<int, KeyframeId> last_mapped;  ///< by segment
  std::set<BlockIndex> shown;             ///< mesh blocks that the sink has
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

  [[nodiscard]] double memory_bytes() const { return options.memory_mb * 1048576.0; }

  void start_volume(double size) {
    VoxelBudget budget;
    budget.memory_bytes = static_cast<std::size_t>((1 - kDepthShare) * memory_bytes());
    budget.archive_bytes = static_cast<std::uint64_t>(options.disk_mb) << 20;
    volume.emplace(size, budget, archive, slice_end);
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
      size = upper_median(medians) / kVoxelsPerDepth;
    }
    start_volume(size);
    return true;
  }

  /// A flight may start a hand's breadth over a table and go on into a hall: when the typical depth
  /// has left the voxel size behind, the volume starts again with a fitting one, and follow_poses()
  /// puts the depth maps back in, one by one.
  void refit_volume(int segment) {
    if (options.voxel_size > 0 || !std::exchange(fit_is_stale, false)) return;
    std::vector<double> medians;
    for (const auto& [id, entry] : mapped.all())
      if (entry.segment == segment) medians.push_back(entry.median_depth);
    if (medians.size() < 3) return;
    // The newest keyframes count on their own, too: voxels that are far too small for what is in
    // view now would use up the budget long before most keyframes agree.
    constexpr std::size_t kNewest = 5;
    const std::size_t newest = std::min(kNewest, medians.size());
    const double now = upper_median(
        std::vector(medians.end() - static_cast<std::ptrdiff_t>(newest), medians.end()));
    const double size = std::max(now, upper_median(std::move(medians))) / kVoxelsPerDepth;
    const double ratio = size / volume->voxel_size();
    if (ratio < kRefitRatio && ratio > 1 / kRefitRatio) return;
    log().info("mapping: voxels of {:.4g} instead of {:.4g} map units", size, volume->voxel_size());
    counts.lost_blocks += volume->lost_blocks();
    ++version;
    if (sink)
      for (const BlockIndex& index : shown) sink->on_block(shown_block(index, {}));
    refitting = true;
    shown.clear();
    start_volume(size);
    mapped.forget_fused();
    ++counts.refits;
  }

  void end_refit() {
    if (std::exchange(refitting, false) && sink) sink->on_complete(version);
  }

  std::optional<std::size_t> next_keyframe(const MapSnapshot& map, bool at_end) const {
    const auto next =
        last_tried ? std::upper_bound(map.keyframes.begin(), map.keyframes.end(), *last_tried,
                                      [](KeyframeId id, const auto& k) { return id < k->id; })
                   : map.keyframes.begin();
    if (next == map.keyframes.end()) return std::nullopt;
    const auto i = static_cast<std::size_t>(next - map.keyframes.begin());
    const bool settled = i + kNewerKeyframes < map.keyframes.size() ||
                         map.keyframes.back()->segment != (*next)->segment;
    if (at_end || settled) return i;
    return std::nullopt;
  }

  void map_keyframe(const MapSnapshot& map, std::size_t index, int segment) {
    const Keyframe& keyframe = *map.keyframes[index];
    last_tried = keyframe.id;
    if (keyframe.observations.empty()) {  // it rests: the backend knows the view
      ++counts.skipped;
      return;
    }
    const auto scene = scene_depth(map, keyframe);
    if (scene && (is_near_last(map, keyframe, scene->median) ||
                  is_known(keyframe, segment, scene->median))) {
      ++counts.skipped;
      return;
    }
    auto depth = scene ? estimate(map, index, *scene) : std::nullopt;
    if (!depth) {
      ++counts.without_depth;
      log().debug("keyframe {}: no depth", keyframe.id.value);
      return;
    }
    last_mapped[keyframe.segment] = keyframe.id;
    ++counts.depth_maps;
    fit_is_stale = true;
    MappedKeyframe& entry = mapped.add(
        keyframe.id,
        {map, keyframe, lens_of(map, keyframe), StoredDepth(std::move(*depth)), scene->median});
    if (keyframe.segment == segment) put_in(entry, keyframe.T_world_camera);
  }

  static Camera lens_of(const MapSnapshot& map, const Keyframe& keyframe) {
    return map.camera ? *map.camera : *keyframe.frame->camera;
  }

  bool is_near_last(const MapSnapshot& map, const Keyframe& keyframe, double median_depth) const {
    const auto last = last_mapped.find(keyframe.segment);
    if (last == last_mapped.end()) return false;
    const Keyframe* other = find(map, last->second);
    return other &&
           is_near(keyframe.T_world_camera, other->T_world_camera, kSkipBaseline * median_depth);
  }

  /// Whether the surface is there as it was seen from nearly the same place long ago: then a flight
  /// over known ground costs no depth maps.
  bool is_known(const Keyframe& keyframe, int segment, double median_depth) const {
    if (keyframe.segment != segment) return false;
    return std::any_of(mapped.all().begin(), mapped.all().end(), [&](const auto& known) {
      return known.first.value + kMuchOlder < keyframe.id.value && known.second.fused &&
             is_near(keyframe.T_world_camera, known.second.fused->T_world_camera,
                     kKnownBaseline * median_depth);
    });
  }

  static bool is_near(const Pose& a, const Pose& b, double distance) {
    return (a.translation() - b.translation()).norm() < distance &&
           rotation_between(a, b) < kSkipRotation_rad;
  }

  static const Keyframe* find(const MapSnapshot& map, KeyframeId id) {
    const auto it = std::lower_bound(map.keyframes.begin(), map.keyframes.end(), id,
                                     [](const auto& k, KeyframeId i) { return k->id < i; });
    return it != map.keyframes.end() && (*it)->id == id ? it->get() : nullptr;
  }

  std::optional<DepthMap> estimate(const MapSnapshot& map, std::size_t index,
                                   const SceneDepth& scene) {
    Stopwatch watch;
    const Keyframe& keyframe = *map.keyframes[index];
    const Camera lens = lens_of(map, keyframe);
    std::optional<DepthMap> depth(std::in_place);
    depth->keyframe = keyframe.id;
    depth->camera = images.camera_of(lens);
    depth->T_world_camera = keyframe.T_world_camera;
    if (std::min(depth->camera.width_px, depth->camera.height_px) < options.template_px) {
      return std::nullopt;
    }
    const double near = scene.near / kRangeMargin, far = scene.far * kRangeMargin;
    ViewChoiceOptions choice;
    choice.neighbours = options.neighbours;
    choice.focal_px = depth->camera.fx_px;
    choice.inverse_depth_step = (1 / near - 1 / far) / (options.depth_samples - 1);
    const std::vector<Neighbour> chosen = choose_neighbours(map, index, choice);
    if (sweeper.scores_at_once(depth->camera.width_px, depth->camera.height_px, chosen.size(),
                               options.depth_samples) > DepthSweeper::kMostScores) {
      log().warn(
          "keyframe {}: no depth: {} x {} rays with {} neighbours are too many for one sweep; "
          "raise mapping.depth_scale",
          keyframe.id.value, depth->camera.width_px, depth->camera.height_px, chosen.size());
      return std::nullopt;
    }

    const auto reference = images.sweep_image(keyframe, lens, sweeper);
    if (!reference) return std::nullopt;
    std::vector<std::shared_ptr<const SweepImage>> held;
    std::vector<SweepNeighbour> neighbours;
    std::vector<std::shared_ptr<const DepthMap>> seen_before;
    std::vector<DepthWitness> witnesses;
    for (const Neighbour& n : chosen) {
      const Keyframe& other = *map.keyframes[n.index];
      end_slice();
      const auto image = images.sweep_image(other, lens, sweeper);
      if (!image) continue;
      held.push_back(image);
      const Pose T_other_this = other.T_world_camera.inverse() * keyframe.T_world_camera;
      neighbours.push_back({image.get(), depth->camera, T_other_this});
      if (const MappedKeyframe* known = mapped.find(other.id)) {
        seen_before.push_back(known->depth.scaled());
        witnesses.push_back({seen_before.back().get(), T_other_this});
      }
    }
    timings.emplace_back("images", watch.lap_ms());
    if (static_cast<int>(neighbours.size()) < options.min_views) return std::nullopt;

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
    if (answered < kMinAnswered) return std::nullopt;
    answered_sum += answered;
    return depth;
  }

  /// Re-fuses the keyframe that moved farthest, if one moved far enough; takes out what is no
  /// longer part of the map.
  bool follow_poses(const MapSnapshot& map, int segment) {
    mapped.look(map, segment, kRefuseMotion_vox * volume->voxel_size(), slice_end);
    const auto move = mapped.next_move();
    // Those that are not in the volume come first.
    if (!move || (move->wanted && move->keyframe->fused)) end_refit();
    if (!move) return false;
    end_slice();
    MappedKeyframe& entry = *move->keyframe;
    const auto depth = entry.depth.scaled();
    if (depth->depth.empty()) {
      give_up(entry.depth.keyframe);
      return true;
    }
    if (entry.fused) {
      Stopwatch watch;
      volume->unfuse(*entry.fused, *depth, images.colours(*entry.frame->load(), entry.lens));
      entry.fused.reset();
      timings.emplace_back("unfuse", watch.lap_ms());
      counts.refusions += move->wanted;
    }
    if (move->wanted) {
      if (entry.growth != 1) grow(entry);
      put_in(entry, entry.looked_at->T_world_camera);
    } else {
      show_changes();
    }
    return true;
  }

  /// Of a keyframe whose depth map cannot be read back. What is in the volume of it stays there:
  /// nobody knows any more what that is.
  void give_up(KeyframeId id) {
    log().warn("keyframe {}: its depth map is lost; its surface no longer follows its pose",
               id.value);
    ++counts.lost_depth_maps;
    mapped.drop(id);
  }

  void grow(MappedKeyframe& entry) {
    entry.depth.scale *= entry.growth;
    entry.median_depth *= entry.growth;
    for (auto& [id, z] : entry.landmark_depths) z *= entry.growth;
    fit_is_stale = true;
  }

  void put_in(MappedKeyframe& entry, const Pose& T_world_camera) {
    end_slice();
    Stopwatch watch;
    entry.fused = volume->fuse(*entry.depth.scaled(),
                               images.colours(*entry.frame->load(), entry.lens), T_world_camera);
    timings.emplace_back("fuse", watch.lap_ms());
    show_changes();
  }

  [[nodiscard]] MeshBlock shown_block(const BlockIndex& index, TriangleMesh mesh) const {
    return {{index.x, index.y, index.z},
            version,
            volume->voxel_size(),
            kMeshBlockSide * VoxelBlock::kSide,
            std::move(mesh)};
  }

  /// Meshing looks at neighbours, which the archive may not give back: then these have changed too.
  /// That ends, since blocks get lost but none are made.
  void show_changes() {
    std::vector<BlockIndex> changed = volume->take_changed();
    if (!sink || changed.empty()) return;
    Stopwatch watch;
    ++version;
    constexpr int kSliceBlocks = 2;
    Slicer meshed(slice_end, kSliceBlocks);
    for (; !changed.empty(); changed = volume->take_changed()) {
      for (const BlockIndex& index : blocks_to_remesh(changed)) {
        meshed.piece();
        const MeshBlock block = shown_block(index, mesh_block(*volume, index));
        if (block.mesh.empty() ? shown.erase(index) == 0 : (shown.insert(index), false)) continue;
        sink->on_block(block);
      }
    }
    if (!refitting) sink->on_complete(version);
    timings.emplace_back("mesh", watch.lap_ms());
  }
};

Expected<std::unique_ptr<Mapper>> Mapper::create(std::shared_ptr<Device> device,
                                                 const MappingOptions& options, MeshSink* sink,
                                                 std::shared_ptr<Archive> archive,
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
  return std::unique_ptr<Mapper>(new Mapper(
      std::make_unique<Impl>(std::move(device), options, sink, std::move(archive),
                             std::move(slice_end), std::move(*sweeper), std::move(*warper))));
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

std::vector<StoredDepth> Mapper::depth_maps(const MapSnapshot& map) const {
  return impl_->mapped.depth_maps(map);
}

double Mapper::voxel_size() const { return impl_->volume ? impl_->volume->voxel_size() : 0; }

MapperStatistics Mapper::statistics() const {
  MapperStatistics out = impl_->counts;
  if (impl_->volume) {
    out.blocks = impl_->volume->size();
    out.blocks_in_memory = impl_->volume->in_memory();
    out.lost_blocks += impl_->volume->lost_blocks();
  }
  if (out.depth_maps > 0) out.answered = impl_->answered_sum / static_cast<double>(out.depth_maps);
  return out;
}

const Timings& Mapper::last_timings() const { return impl_->timings; }

}  // namespace corvid
