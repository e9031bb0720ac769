#include "mapping/cut_volume.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace corvid {
namespace {

constexpr char kWhere[] = "surface cut";

Expected<void> check_map(const DepthMap* map, const ColourImage* colour) {
  const auto wrong = [&](const std::string& what) {
    return fail(
        ErrorCode::invalid_argument,
        map ? fmt::format("the depth map of keyframe {} {}", map->keyframe.value, what) : what,
        kWhere);
  };
  if (!map) return wrong("a depth map is missing");
  const int width = map->depth.width(), height = map->depth.height();
  if (map->confidence.width() != width || map->confidence.height() != height) {
    return wrong("has a confidence map of another size");
  }
  if (colour && (colour->width() != width || colour->height() != height)) {
    return wrong("has a colour image of another size");
  }
  const Camera& c = map->camera;
  const std::array<double, 4> lens{c.fx_px, c.fy_px, c.cx_px, c.cy_px};
  if (c.model != CameraModel::pinhole || !(c.fx_px > 0 && c.fy_px > 0) ||
      !std::all_of(lens.begin(), lens.end(), [](double v) { return std::isfinite(v); })) {
    return wrong("is not on a pinhole camera");
  }
  if (!map->T_world_camera.finite()) return wrong("has a pose that is not finite");
  return {};
}

/// A sample of the points, and how far apart neighbouring rays are there.
struct PointSample {
  std::array<std::vector<double>, 3> axes;
  std::vector<double> spacing;
};

PointSample sample_points(std::span<const SurfaceCutView> views) {
  constexpr double kSamples = 400000;
  double rays = 1;
  for (const auto& view : views) rays += static_cast<double>(view.depth->depth.size());
  const int step = static_cast<int>(std::ceil(std::sqrt(rays / kSamples)));
  PointSample out;
  for (const auto& view : views) {
    const DepthMap& map = *view.depth;
    for (int y = step / 2; y < map.depth.height(); y += step) {
      for (int x = step / 2; x < map.depth.width(); x += step) {
        const double z = map.depth(x, y);
        if (!(z > 0 && std::isfinite(z) && map.confidence(x, y) > 0)) continue;
        const Eigen::Vector3d p =
            map.T_world_camera * Eigen::Vector3d((x - map.camera.cx_px) / map.camera.fx_px * z,
                                                 (y - map.camera.cy_px) / map.camera.fy_px * z, z);
        for (std::size_t axis = 0; axis < 3; ++axis) {
          out.axes[axis].push_back(p[static_cast<Eigen::Index>(axis)]);
        }
        out.spacing.push_back(z / map.camera.fx_px);
      }
    }
  }
  return out;
}

double percentile(std::vector<double>& values, double share) {
  const auto at = values.begin() +
                  static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace

Expected<void> check_cut(std::span<const SurfaceCutView> views, const SurfaceCutOptions& options) {
  const auto wrong = [](const char* what) {
    return fail(ErrorCode::invalid_argument, what, kWhere);
  };
  const auto share = [](double v) { return v > 0 && v <= 1; };
  if (!(std::isfinite(options.voxel_size) && options.voxel_size >= 0)) {
    return wrong("the voxel size must be positive, or 0 to choose it");
  }
  if (!(options.decay > 0 && std::isfinite(options.decay))) return wrong("decay must be positive");
  if (!(options.ballooning >= 0 && options.ballooning <= 1)) {
    return wrong("ballooning must lie in [0, 1]");
  }
  if (!share(options.outside_share) || !share(options.inside_share) ||
      options.outside_share + options.inside_share <= 1) {
    return wrong("outside_share and inside_share must lie in (0, 1] and be more than 1 together");
  }
  if (options.smoothing < 0 || options.smoothing > 1000) {
    return wrong("smoothing must lie in [0, 1000]");
  }
  if (!(options.min_island >= 0 && options.min_island <= 1)) {
    return wrong("min_island must lie in [0, 1]");
  }
  if (const auto& box = options.box;
      box && !(box->min().allFinite() && box->max().allFinite() && box->sizes().allFinite() &&
               (box->sizes().array() > 0).all())) {
    return wrong(
        "the volume is empty: its upper corner must lie above the lower one on every axis");
  }
  if (views.empty()) return wrong("there is no depth map");
  for (const auto& view : views) {
    if (auto ok = check_map(view.depth, view.colour); !ok) return ok;
  }
  return {};
}

Expected<WantedVolume> choose_volume(std::span<const SurfaceCutView> views,
                                     const SurfaceCutOptions& options) {
  Eigen::AlignedBox3d box = options.box.value_or(Eigen::AlignedBox3d());
  double voxel_size = options.voxel_size;
  if (!options.box || voxel_size == 0) {
    PointSample sample = sample_points(views);
    if (sample.spacing.empty()) {
      return fail(ErrorCode::invalid_argument, "the depth maps have no points", kWhere,
                  "views without texture, or that nothing overlaps, have no depth");
    }
    if (voxel_size == 0) voxel_size = percentile(sample.spacing, 0.5);
    if (!options.box) {
      constexpr double kCut = 0.005, kRoom = 0.02;
      constexpr double kBorder = 6;  // voxels around, so that the crust lies in the volume
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const auto i = static_cast<Eigen::Index>(axis);
        const double low = percentile(sample.axes[axis], kCut);
        const double high = percentile(sample.axes[axis], 1 - kCut);
        const double room = kRoom * (high - low) + kBorder * voxel_size;
        box.min()[i] = low - room;
        box.max()[i] = high + room;
      }
    }
  }
  if (!(voxel_size > 0 && std::isfinite(voxel_size) && box.sizes().allFinite())) {
    return fail(ErrorCode::invalid_argument, "the points lie at distances that are not finite",
                kWhere);
  }
  if (volume_of(box, voxel_size).size.minCoeff() < 2) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("the volume of {:.4g} x {:.4g} x {:.4g} is less than two voxels of "
                            "{:.4g} along an axis",
                            box.sizes().x(), box.sizes().y(), box.sizes().z(), voxel_size),
                kWhere, "smaller voxels; are both in the unit of the depth maps?");
  }
  return WantedVolume{box, voxel_size};
}

CutVolume volume_of(const Eigen::AlignedBox3d& box, double voxel_size) {
  constexpr double kMost = 1e9;
  const Eigen::Array3d voxels =
      (box.sizes().array() / voxel_size - 1e-6).ceil().max(1.0).min(kMost);
  CutVolume out;
  out.voxel_size = voxel_size;
  out.size = voxels.cast<int>();
  out.p_low = box.center().array() - 0.5 * voxel_size * (voxels - 1);
  return out;
}

Eigen::AlignedBox3d box_of(const CutVolume& volume) {
  const Eigen::Vector3d low = volume.p_low - Eigen::Vector3d::Constant(0.5 * volume.voxel_size);
  return {low, low + volume.voxel_size * volume.size.cast<double>()};
}

Expected<void> check_place(const CutVolume& volume) {
  constexpr double kFarthest = 1e5;
  const Eigen::AlignedBox3d box = box_of(volume);
  const double far = std::max(box.min().cwiseAbs().maxCoeff(), box.max().cwiseAbs().maxCoeff());
  if (far <= kFarthest * volume.voxel_size) return {};
  return fail(ErrorCode::invalid_argument,
              fmt::format("the volume lies {:.3g} voxels from the origin: vertices are kept as "
                          "floats, which are too coarse beyond {:.0g} voxels",
                          far / volume.voxel_size, kFarthest),
              kWhere, "move the origin of the world nearer, or take larger voxels");
}

double dense_bytes(const CutVolume& volume, int threads) {
  // Bits: points (one set per thread), crust and two more while it spreads. Per cell: label, state,
  // and up to two fronts of 8 bytes at the surface of what is spread, taken as 1.
  const double voxels = volume.size.cast<double>().prod();
  return voxels * ((threads + 4) / 8.0 + 3 / 8.0) + 4 * voxels / CrustBlocks::kBlockVoxels;
}

Error too_large(const CutVolume& volume, double bytes, std::size_t max_bytes) {
  return Error{
      ErrorCode::invalid_argument,
      fmt::format("a volume of {} x {} x {} voxels of {:.4g} needs {:.0f} MB, more than the "
                  "{:.0f} MB allowed",
                  volume.size.x(), volume.size.y(), volume.size.z(), volume.voxel_size, bytes / 1e6,
                  static_cast<double>(max_bytes) / 1e6),
      kWhere,
      "larger voxels, a smaller volume or more memory for it; is the voxel size in the unit of "
      "the depth maps?"};
}

Error too_many(const CutVolume& volume, std::size_t places) {
  return Error{ErrorCode::invalid_argument,
               fmt::format("a volume of {} x {} x {} voxels of {:.4g} has {:.1f} thousand million "
                           "of them near points, more than 4.2",
                           volume.size.x(), volume.size.y(), volume.size.z(), volume.voxel_size,
                           1e-9 * static_cast<double>(places)),
               kWhere, "larger voxels or a smaller volume"};
}

}  // namespace corvid
