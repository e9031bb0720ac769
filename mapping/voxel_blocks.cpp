#include "mapping/voxel_blocks.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_set>

#include "core/check.h"

namespace corvid {
namespace {

constexpr int kSide = VoxelBlock::kSide;
// Pieces of work in a slice of about two milliseconds.
constexpr int kSliceRows = 16, kSliceBlocks = 128, kSliceNewBlocks = 512, kSliceLooks = 20000;

/// Per-ray weight in [0, kMaxWeight]: confidence times cosine of the viewing angle, less for depths
/// beyond `full_weight_depth`. 0 where there is no depth.
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
      weights(x, y) =
          static_cast<float>(VoxelBlocks::kMaxWeight *
                             std::clamp<double>(map.confidence(x, y), 0, 1) * cosine * far * far);
    }
  }
  return weights;
}

/// Everything that the inner loop needs, in floats of camera coordinates.
struct Projector {
  const FloatImage& depth;
  const FloatImage& weights;
  const ColourImage& colour;
  float fx, fy, cx, cy;
  float truncation, thin;  ///< [map units]; `thin`: behind this, weight falls to 0 at -truncation
  Eigen::Matrix3f R_camera_world;
  double voxel_size;

  Projector(const DepthMap& map, const FloatImage& ray_weight, const ColourImage& image,
            const Pose& T_camera_world, double voxel, double trunc)
      : depth(map.depth),
        weights(ray_weight),
        colour(image),
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
  const bool coloured = !p.colour.empty();
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
        if (coloured && std::abs(distance) < 0.5F * p.truncation) {
          const Rgb8& c = p.colour(px, py);
          out.sum_colour_weight += static_cast<std::uint32_t>(sign * w);
          out.sum_colour[0] += static_cast<std::uint32_t>(sign * w * c.r);
          out.sum_colour[1] += static_cast<std::uint32_t>(sign * w * c.g);
          out.sum_colour[2] += static_cast<std::uint32_t>(sign * w * c.b);
        }
      }
    }
  }
  block.surface_views += said.surface ? sign : 0;
  return said;
}

BlockIndex block_of(const Eigen::Vector3d& p_world, double block_size, double half_voxel) {
  const auto cell = [&](double v) {
    return static_cast<int>(std::floor((v + half_voxel) / block_size));
  };
  return {cell(p_world.x()), cell(p_world.y()), cell(p_world.z())};
}

}  // namespace

VoxelBlocks::VoxelBlocks(double voxel_size, int max_blocks, SliceEnd slice_end)
    : voxel_size_(voxel_size),
      max_blocks_(static_cast<std::size_t>(std::max(1, max_blocks))),
      slice_end_(std::move(slice_end)) {
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
                            const Pose& T_world_camera, const Eigen::Vector3d& p_keep) {
  CORVID_CHECK(T_world_camera.finite(), "pose must be finite");
  CORVID_CHECK(
      map.confidence.width() == map.depth.width() && map.confidence.height() == map.depth.height(),
      "depth and confidence must have one size");
  CORVID_CHECK(colour.empty() ||
                   (colour.width() == map.depth.width() && colour.height() == map.depth.height()),
               "colour must have the size of the depth map");
  FusedView view{T_world_camera, {}};
  make_blocks(blocks_on_surface(map, T_world_camera), p_keep);
  const FloatImage weights = ray_weights(map, kFullWeightVoxels * voxel_size_);
  const Pose T_camera_world = T_world_camera.inverse();
  const Projector projector(map, weights, colour, T_camera_world, voxel_size_, truncation());
  const float deepest =
      map.depth.empty() ? 0
                        : *std::max_element(map.depth.data(), map.depth.data() + map.depth.size());
  Slicer looks(slice_end_, kSliceLooks), written(slice_end_, kSliceBlocks);
  for (auto it = blocks_.begin(); it != blocks_.end();) {
    VoxelBlock& block = *it->second;
    Said said;
    looks.piece();
    if (may_be_seen(it->first, map.camera, T_camera_world, deepest)) {
      said = integrate(projector, T_camera_world, it->first, block, 1);
      written.piece();
    }
    if (block.surface_views == 0) {  // was made for this view, which then had no surface in it
      it = blocks_.erase(it);
      continue;
    }
    if (said.anything) {
      view.blocks.emplace_back(it->first, block.serial);
      changed_.insert(it->first);
    }
    ++it;
  }
  std::sort(view.blocks.begin(), view.blocks.end());
  return view;
}

void VoxelBlocks::unfuse(const FusedView& view, const DepthMap& map, const ColourImage& colour) {
  const FloatImage weights = ray_weights(map, kFullWeightVoxels * voxel_size_);
  const Pose T_camera_world = view.T_world_camera.inverse();
  const Projector projector(map, weights, colour, T_camera_world, voxel_size_, truncation());
  Slicer written(slice_end_, kSliceBlocks);
  for (const auto& [index, serial] : view.blocks) {
    written.piece();
    const auto it = blocks_.find(index);
    if (it == blocks_.end() || it->second->serial != serial) continue;
    integrate(projector, T_camera_world, index, *it->second, -1);
    changed_.insert(index);
    if (it->second->surface_views == 0) blocks_.erase(it);
  }
}

bool VoxelBlocks::may_be_seen(const BlockIndex& b, const Camera& camera, const Pose& T_camera_world,
                              double deepest) const {
  const double radius = 0.5 * std::sqrt(3.0) * kSide * voxel_size_;
  const Eigen::Vector3d centre =
      T_camera_world *
      ((Eigen::Vector3d(b.x, b.y, b.z) * kSide + Eigen::Vector3d::Constant(0.5 * (kSide - 1))) *
       voxel_size_);
  if (centre.z() < -radius || centre.z() > deepest + truncation() + radius) return false;
  if (centre.z() < 2 * radius) return true;
  const double u = camera.fx_px * centre.x() / centre.z() + camera.cx_px;
  const double v = camera.fy_px * centre.y() / centre.z() + camera.cy_px;
  // Generous: a sphere's image reaches at most |offset| / (z - r) farther than its centre's.
  const double reach = radius / (centre.z() - radius);
  const double margin_u = (camera.fx_px + std::abs(u - camera.cx_px)) * reach + 1;
  const double margin_v = (camera.fy_px + std::abs(v - camera.cy_px)) * reach + 1;
  return u > -margin_u && v > -margin_v && u < camera.width_px + margin_u &&
         v < camera.height_px + margin_v;
}

void VoxelBlocks::make_blocks(const std::vector<BlockIndex>& wanted,
                              const Eigen::Vector3d& p_keep) {
  std::vector<BlockIndex> missing;
  for (const BlockIndex& b : wanted) {
    if (!blocks_.contains(b)) missing.push_back(b);
  }
  if (blocks_.size() + missing.size() > max_blocks_) {
    const Eigen::Vector3d p = p_keep / (kSide * voxel_size_) - Eigen::Vector3d::Constant(0.5);
    std::vector<std::pair<double, BlockIndex>> by_distance;
    const auto add = [&](const BlockIndex& b) {
      by_distance.emplace_back((Eigen::Vector3d(b.x, b.y, b.z) - p).squaredNorm(), b);
    };
    for (const auto& [index, block] : blocks_) add(index);
    for (const BlockIndex& b : missing) add(b);
    const auto end = by_distance.begin() + static_cast<std::ptrdiff_t>(max_blocks_);
    std::nth_element(by_distance.begin(), end, by_distance.end());
    std::set<BlockIndex> leave_out;
    for (auto it = end; it != by_distance.end(); ++it) {
      leave_out.insert(it->second);
      if (blocks_.erase(it->second) > 0) changed_.insert(it->second);
    }
    dropped_ += leave_out.size();
    std::erase_if(missing, [&](const BlockIndex& b) { return leave_out.contains(b); });
  }
  Slicer made(slice_end_, kSliceNewBlocks);
  for (const BlockIndex& b : missing) {
    made.piece();
    auto& block = blocks_[b];
    block = std::make_unique<VoxelBlock>();
    block->serial = next_serial_++;
  }
}

std::vector<BlockIndex> VoxelBlocks::take_changed() {
  std::vector<BlockIndex> out(changed_.begin(), changed_.end());
  changed_.clear();
  return out;
}

std::vector<BlockIndex> VoxelBlocks::indices() const {
  std::vector<BlockIndex> out;
  out.reserve(blocks_.size());
  for (const auto& [index, block] : blocks_) out.push_back(index);
  std::sort(out.begin(), out.end());
  return out;
}

const VoxelBlock* VoxelBlocks::find(const BlockIndex& index) const {
  const auto it = blocks_.find(index);
  return it == blocks_.end() ? nullptr : it->second.get();
}

VoxelBlock& VoxelBlocks::touch(const BlockIndex& index) {
  auto& block = blocks_[index];
  if (!block) {
    block = std::make_unique<VoxelBlock>();
    block->serial = next_serial_++;
    block->surface_views = 1;
  }
  changed_.insert(index);
  return *block;
}

}  // namespace corvid
