#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <stop_token>
#include <string_view>

#include "corvid/error.h"
#include "corvid/map.h"
#include "corvid/mesh_stream.h"

namespace corvid {

struct SurfaceCutOptions {
  /// Where to look for the surface [map units]; nothing: around the points, without the outermost
  /// of them (half a percent at each end of each axis).
  std::optional<Eigen::AlignedBox3d> box;
  /// [map units]; 0: the typical distance between neighbouring rays at their points.
  double voxel_size = 0;
  /// Whether larger voxels than asked for are taken where max_bytes would not do.
  bool coarsen = false;
  double decay = 15;  ///< mu: rho = exp(-mu * sum of votes) (thesis 6.30)
  /// lambda * h: the cost of a voxel's volume, lambda h^3, as a share of what a voxel's face costs
  /// where nothing votes for it, h^2. In [0, 1]. See docs/decisions/surface-cut.md.
  double ballooning = 0.4;
  double outside_share = 0.4;  ///< of the looks that see through a cell (thesis 6.7.3)
  double inside_share = 0.95;  ///< of the looks that end before a cell (thesis 6.7.3)
  int smoothing = 8;           ///< passes; 0: none
  double min_island = 0.002;   ///< smaller separate pieces are left out; share of the largest
  bool closed = true;          ///< false: without the parts that no point supports, and the caps
  std::size_t max_bytes = std::size_t{2} << 30;  ///< of memory for the cut
  int threads = 0;                               ///< 0: one per core; changes no result
};

/// What the snapshot took.
struct SurfaceCutStatistics {
  std::uint64_t voxels = 0;        ///< of the volume
  std::uint64_t crust_voxels = 0;  ///< that entered the optimization
  std::uint64_t points = 0;        ///< of the depth maps, in the volume
  std::int64_t flow = 0;           ///< maximum flow [1 / SurfaceCut::kLinkSteps of a voxel's face]
  double graph_s = 0;              ///< votes, labels and capacities
  double maxflow_s = 0;
  double mesh_s = 0;             ///< marching cubes, normals, colours
  std::uint64_t peak_bytes = 0;  ///< of the arrays for graph and flow, at their largest
};

struct SurfaceCut {
  static constexpr int kLinkSteps = 4000;  ///< capacity of a voxel's face for which nothing votes
  TriangleMesh mesh;                       ///< empty if no voxel is inside
  double voxel_size = 0;                   ///< [map units]
  Eigen::AlignedBox3d box;                 ///< of the volume, whole voxels
  SurfaceCutStatistics statistics;
};

/// A depth map to cut from.
struct SurfaceCutView {
  const DepthMap* depth = nullptr;
  const ColourImage* colour = nullptr;  ///< of the size of the depth map; may be null
};

struct SurfaceCutControl {
  std::stop_token stop;
  /// Gets "points", "labels", "votes", "distances", "flow", "mesh" and "colours" as they begin. May
  /// be empty.
  std::function<void(std::string_view stage)> on_stage;
};

/// The minimal surface through the points of depth maps that have one common frame, as the minimum
/// cut of a grid of voxels (thesis 6.7; Vogiatzis, Torr and Cipolla, "Multi-view stereo via
/// volumetric graph-cuts", 2005): docs/decisions/surface-cut.md.
///
/// The mesh is closed (unless asked otherwise), manifold, and its faces look outward; normals are
/// by vertex, colours, too, if any view has some. Deterministic, whatever the number of threads.
///
/// Errors: invalid_argument if an option or a depth map is wrong, if no point lies in the volume,
/// if the volume is smaller than 2 voxels, needs more memory than max_bytes, or lies so far from
/// the origin that its vertices cannot be told apart; interrupted.
[[nodiscard]] Expected<SurfaceCut> cut_surface(std::span<const SurfaceCutView> views,
                                               const SurfaceCutOptions& options,
                                               const SurfaceCutControl& control = {});

}  // namespace corvid
