#include "mapping/voxel_blocks.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_set>

#include "core/check.h"
#include "mapping/depth_tiles.h"

namespace corvid {
namespace {

constexpr int kSide = VoxelBlock::kSide;
constexpr int kColourShare = Voxel::kMaxWeight / Voxel::kMaxColourWeight;
// Pieces of work in a slice of about two milliseconds.
constexpr int kSliceRows = 16, kSliceBlocks = 128, kSliceLooks = 20000;

/// Per-ray weight in [0, Voxel::kMaxWeight]: confidence times cosine of the viewing angle, less for
/// depths beyond `full_weight_depth`. 0 where there is no depth.
FloatImage ray_weights(const DepthMap& map, double full_weight_depth) {
  const FloatImage& depth = map.depth;
  const Camera& camera = map.camera;
  FloatImage weights(depth.width(), depth.height());
  const auto point = [&](int x, int y) {
    const double z = depth(x, y);
    return Eigen::Vector3d((x - camera.cx_px) / camera.fx_px * z,
                           (y - camera.cy_px) / camera.fy_px * z, z);
  };
  for (int y = 0; y < depth.height(); ++y) {
    for (int x = 0; x < depth.width(); ++x) {
      const double z = depth(x, y);
      if (!(z > 0)) continue;
      // Central differences where both neighbours have an answer; half weight where they do not:
      // such a ray stands at an edge of something.
      double cosine = 0.5;
      if (x > 0 && y > 0 && x + 1 < depth.width() && y + 1 < depth.height() &&
          depth(x - 1, y) > 0 && depth(x + 1, y) > 0 && depth(x, y - 1) > 0 &&
          depth(x, y + 1) > 0) {
        const Eigen::Vector3d normal =
            (point(x + 1, y) - point(x - 1, y)).cross(point(x, y + 1) - point(x, y - 1));
        const Eigen::Vector3d p = point(x, y);
        const double length = normal.norm() * p.norm();
        if (length > 0) cosine = std::abs(normal.dot(p)) / length;
      }
      const double far = std::min(1.0, full_weight_depth / z);
      weights(x, y) = static_cast<float>(
          Voxel::kMaxWeight * std::clamp<double>(map.confidence(x, y), 0, 1) * cosine * far * far);
    }
  }
  return weights;
}

Rgb8 mean_of(const Voxel& voxel) {
  const std::uint64_t weight = std::max<std::uint64_t>(voxel.sum_colour_weight, 1);
  return {static_cast<std::uint8_t>(voxel.sum_red / weight),
          static_cast<std::uint8_t>(voxel.sum_green / weight),
          static_cast<std::uint8_t>(voxel.sum_blue / weight)};
}

void add_colour(Voxel& out, int weight, const Rgb8& c) {
  out.sum_colour_weight += static_cast<std::uint32_t>(weight);
  out.sum_red += static_cast<std::uint32_t>(weight * c.r);
  out.sum_green += static_cast<std::uint32_t>(weight * c.g);
  out.sum_blue += static_cast<std::uint32_t>(weight * c.b);
}

/// The weight exactly, and the sums too unless some colour was not known: they stay sums of colours
/// of the weight that is left.
void take_colour(Voxel& out, int weight, const Rgb8& c) {
  const int left = std::max(static_cast<int>(out.sum_colour_weight) - weight, 0);
  const auto rest = [&](std::uint64_t sum, int level) {
    return static_cast<std::uint32_t>(
        std::clamp(static_cast<int>(sum) - weight * level, 0, 255 * left));
  };
  out.sum_colour_weight = static_cast<std::uint32_t>(left);
  out.sum_red = rest(out.sum_red, c.r);
  out.sum_green = rest(out.sum_green, c.g);
  out.sum_blue = rest(out.sum_blue, c.b);
}

void check_sizes(const DepthMap& map, const ColourImage& colour) {
  CORVID_CHECK(
      map.confidence.width() == map.depth.width() && map.confidence.height() == map.depth.height(),
      "depth and confidence must have one size");
  CORVID_CHECK(colour.empty() ||
                   (colour.width() == map.depth.width() && colour.height() == map.depth.height()),
               "colour must have the size of the depth map");
}

/// Everything that the inner loop needs, in floats of camera coordinates.
struct Projector {
  const FloatImage& depth;
  const FloatImage& weights;
  const ColourImage& colour;
  bool coloured;  ///< colours take part; where `colour` is empty all the same, they are not known
  float fx, fy, cx, cy;
  float truncation, thin;  ///< [map units]; `thin`: behind this, weight falls to 0 at -truncation
  Eigen::Matrix3f R_camera_world;
  double voxel_size;

  Projector(const DepthMap& map, const FloatImage& ray_weight, const ColourImage& image,
            bool has_colour, const Pose& T_camera_world, double voxel, double trunc)
      : depth(map.depth),
        weights(ray_weight),
        colour(image),
        coloured(has_colour),
        fx(static_cast<float>(map.camera.fx_px)),
        fy(static_cast<float>(map.camera.fy_px)),
        cx(static_cast<float>(map.camera.cx_px)),
        cy(static_cast<float>(map.camera.cy_px)),
        truncation(static_cast<float>(trunc)),
        thin(static_cast<float>(-voxel)),
        R_camera_world(T_camera_world.R().cast<float>()),
        voxel_size(voxel) {}
};

/// What a view had to say about a block.
struct Said {
  bool anything = false;
  bool surface = false;  ///< within the truncation distance of a surface
};

/// Adds (sign = 1) or takes out (sign = -1) what one view says about one block. The same numbers
/// come out both times: everything is a function of the view and the block index.
Said integrate(const Projector& p, const Pose& T_camera_world, const BlockIndex& index,
               VoxelBlock& block, int sign) {
  const Eigen::Vector3f corner =
      (T_camera_world * (Eigen::Vector3d(index.x, index.y, index.z) * (kSide * p.voxel_size)))
          .cast<float>();
  const auto voxel = static_cast<float>(p.voxel_size);
  const Eigen::Vector3f dx = p.R_camera_world.col(0) * voxel;
  const Eigen::Vector3f dy = p.R_camera_world.col(1) * voxel;
  const Eigen::Vector3f dz = p.R_camera_world.col(2) * voxel;
  const int width = p.depth.width(), height = p.depth.height();
  const float x_limit = static_cast<float>(width) - 0.5F;
  const float y_limit = static_cast<float>(height) - 0.5F;
  Said said;
  for (int z = 0; z < kSide; ++z) {
    for (int y = 0; y < kSide; ++y) {
      const Eigen::Vector3f row = corner + static_cast<float>(y) * dy + static_cast<float>(z) * dz;
      for (int x = 0; x < kSide; ++x) {
        const Eigen::Vector3f q = row + static_cast<float>(x) * dx;
        if (!(q.z() > voxel)) continue;
        const float u = p.fx * q.x() / q.z() + p.cx;
        const float v = p.fy * q.y() / q.z() + p.cy;
        if (!(u > -0.5F && v > -0.5F && u < x_limit && v < y_limit)) continue;
        const int px = static_cast<int>(u + 0.5F);
        const int py = static_cast<int>(v + 0.5F);
        const float d = p.depth(px, py);
        if (!(d > 0)) continue;
        const float distance = d - q.z();
        if (distance < -p.truncation) continue;
        float weight = p.weights(px, py);
        const bool free = distance > p.truncation;
        if (free) weight *= static_cast<float>(VoxelBlocks::kCarveWeight);
        if (distance < p.thin) weight *= (p.truncation + distance) / (p.truncation + p.thin);
        const int w = static_cast<int>(weight + 0.5F);
        if (w <= 0) continue;
        const float clipped = free ? 1.0F : distance / p.truncation;
        const int step =
            static_cast<int>(std::lround(static_cast<float>(w) * clipped * Voxel::kDistanceSteps));
        Voxel& out = block.voxels[static_cast<std::size_t>(VoxelBlock::offset(x, y, z))];
        said.anything = true;
        said.surface = said.surface || !free;
        out.sum_distance += sign * step;
        out.sum_weight += static_cast<std::uint32_t>(sign * w);
        if (p.coloured && std::abs(distance) < 0.5F * p.truncation) {
          const int colour_weight = (w + kColourShare - 1) / kColourShare;
          if (sign > 0) {
            add_colour(out, colour_weight, p.colour(px, py));
          } else {
            take_colour(out, colour_weight, p.colour.empty() ? mean_of(out) : p.colour(px, py));
          }
        }
      }
    }
  }
  block.views += said.anything ? sign : 0;
  block.surface_views += said.surface ? sign : 0;
  return said;
}

BlockIndex block_of(const Eigen::Vector3d& p_world, double block_size, double half_voxel) {
  const auto cell = [&](double v) {
    return static_cast<int>(std::floor((v + half_voxel) / block_size));
  };
  return {cell(p_world.x()), cell(p_world.y()), cell(p_world.z())};
}

/// Which blocks a depth map can say something of: those that some ray meets before its depth and
/// the truncation distance behind it end. Errs on the side of too many.
class Reach {
 public:
  Reach(const DepthMap& map, const Pose& T_camera_world, double voxel_size, double truncation)
      : tiles_(map, kTile_px),
        T_camera_world_(T_camera_world),
        voxel_size_(voxel_size),
        truncation_(truncation) {}

  [[nodiscard]] bool may_reach(const BlockIndex& b) const {
    const double radius = 0.5 * std::sqrt(3.0) * kSide * voxel_size_;
    const Eigen::Vector3d centre =
        T_camera_world_ *
        ((Eigen::Vector3d(b.x, b.y, b.z) * kSide + Eigen::Vector3d::Constant(0.5 * (kSide - 1))) *
         voxel_size_);
    return !tiles_.hides(centre.cast<float>(), static_cast<float>(radius),
                         static_cast<float>(truncation_));
  }

 private:
  static constexpr int kTile_px = 16;
  DepthTiles tiles_;
  Pose T_camera_world_;
  double voxel_size_, truncation_;
};

}  // namespace

VoxelBlocks::VoxelBlocks(double voxel_size, const VoxelBudget& budget,
                         std::shared_ptr<Archive> archive, const SliceEnd& slice_end)
    : voxel_size_(voxel_size),
      slice_end_(slice_end),
      store_(budget, std::move(archive), slice_end) {
  CORVID_CHECK(voxel_size > 0 && std::isfinite(voxel_size), "voxel size must be positive");
}

std::vector<BlockIndex> VoxelBlocks::blocks_on_surface(const DepthMap& map,
                                                       const Pose& T_world_camera) const {
  // Grid coordinates are ints: what lies farther than this is left out instead of overflowing.
  const double max_depth = 1e8 * voxel_size_;
  if (T_world_camera.translation().cwiseAbs().maxCoeff() > max_depth) return {};
  const double block_size = kSide * voxel_size_;
  std::unordered_set<BlockIndex, BlockIndexHash> found;
  BlockIndex last{std::numeric_limits<int>::min(), 0, 0};
  Slicer rows(slice_end_, kSliceRows);
  for (int y = 0; y < map.depth.height(); ++y) {
    rows.piece();
    for (int x = 0; x < map.depth.width(); ++x) {
      const double d = map.depth(x, y);
      if (!(d > 0) || d > max_depth) continue;
      const Eigen::Vector3d ray =
          T_world_camera.rotation() * Eigen::Vector3d((x - map.camera.cx_px) / map.camera.fx_px,
                                                      (y - map.camera.cy_px) / map.camera.fy_px, 1);
      const double length = ray.norm();
      const double step = 2 * voxel_size_ / length;
      const double end = d + truncation();
      for (double z = std::max(d - truncation(), voxel_size_); z <= end; z += step) {
        const BlockIndex b =
            block_of(T_world_camera.translation() + z * ray, block_size, 0.5 * voxel_size_);
        if (b == last) continue;
        last = b;
        found.insert(b);
      }
    }
  }
  std::vector<BlockIndex> sorted(found.begin(), found.end());
  std::sort(sorted.begin(), sorted.end());
  return sorted;
}

FusedView VoxelBlocks::fuse(const DepthMap& map, const ColourImage& colour,
                            const Pose& T_world_camera) {
  CORVID_CHECK(T_world_camera.finite(), "pose must be finite");
  FusedView view{T_world_camera, {}, !colour.empty()};
  if (map.depth.empty()) return view;
  check_sizes(map, colour);
  const FloatImage weights = ray_weights(map, kFullWeightVoxels * voxel_size_);
  const Pose T_camera_world = T_world_camera.inverse();
  const Projector projector(map, weights, colour, view.coloured, T_camera_world, voxel_size_,
                            truncation());
  // Blocks with a surface in this view, and those that are there and may be seen as free space.
  std::vector<BlockIndex> in_view = blocks_on_surface(map, T_world_camera);
  const Reach reach(map, T_camera_world, voxel_size_, truncation());
  Slicer looks(slice_end_, kSliceLooks), written(slice_end_, kSliceBlocks);
  for (const BlockIndex& index : store_.indices()) {
    looks.piece();
    if (reach.may_reach(index)) in_view.push_back(index);
  }
  std::sort(in_view.begin(), in_view.end());
  in_view.erase(std::unique(in_view.begin(), in_view.end()), in_view.end());
  for (const BlockIndex& index : in_view) {
    written.piece();
    const bool is_new = !store_.contains(index);
    VoxelBlock* block = is_new ? &store_.make(index) : store_.find(index);
    if (!block || block->views >= VoxelBlock::kMaxViews) continue;
    const Said said = integrate(projector, T_camera_world, index, *block, 1);
    if (is_new && !said.surface) {
      store_.erase(index);
    } else if (said.anything) {
      store_.changed(index);
      view.blocks.emplace_back(index, *store_.serial(index));
      changed_.insert(index);
    }
  }
  note_lost();
  return view;
}

void VoxelBlocks::unfuse(const FusedView& view, const DepthMap& map, const ColourImage& colour) {
  if (map.depth.empty()) return;
  check_sizes(map, colour);
  const FloatImage weights = ray_weights(map, kFullWeightVoxels * voxel_size_);
  const Pose T_camera_world = view.T_world_camera.inverse();
  const Projector projector(map, weights, colour, view.coloured, T_camera_world, voxel_size_,
                            truncation());
  Slicer written(slice_end_, kSliceBlocks);
  for (const auto& [index, serial] : view.blocks) {
    written.piece();
    if (store_.serial(index) != serial) continue;
    VoxelBlock* block = store_.find(index);
    if (!block) continue;
    (void)integrate(projector, T_camera_world, index, *block, -1);
    store_.changed(index);
    changed_.insert(index);
    if (block->surface_views == 0) store_.erase(index);
  }
  note_lost();
}

void VoxelBlocks::note_lost() {
  for (const BlockIndex& index : store_.take_lost()) changed_.insert(index);
}

std::vector<BlockIndex> VoxelBlocks::take_changed() {
  note_lost();
  std::vector<BlockIndex> out(changed_.begin(), changed_.end());
  changed_.clear();
  return out;
}

std::vector<BlockIndex> VoxelBlocks::indices() const {
  std::vector<BlockIndex> out = store_.indices();
  std::sort(out.begin(), out.end());
  return out;
}

const VoxelBlock* VoxelBlocks::find(const BlockIndex& index) const { return store_.find(index); }

VoxelBlock& VoxelBlocks::touch(const BlockIndex& index) {
  changed_.insert(index);
  if (VoxelBlock* block = store_.find(index)) {
    store_.changed(index);
    return *block;
  }
  VoxelBlock& block = store_.make(index);
  block.views = block.surface_views = 1;
  return block;
}

}  // namespace corvid
