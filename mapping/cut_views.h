#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <stop_token>
#include <vector>

#include "corvid/map.h"
#include "mapping/bit_grid.h"
#include "mapping/crust_blocks.h"
#include "mapping/depth_tiles.h"

namespace corvid {

/// A box of voxels in the world. Voxel coordinates have voxel (0,0,0)'s centre as their origin.
struct CutVolume {
  Eigen::Vector3d p_low = Eigen::Vector3d::Zero();  ///< centre of voxel (0,0,0) [map units]
  double voxel_size = 1;                            ///< [map units]
  Eigen::Vector3i size = Eigen::Vector3i::Zero();   ///< [voxels]
};

/// A depth map as the snapshot reads it, in voxel coordinates.
class CutView {
 public:
  /// @pre map.camera is a pinhole, depth and confidence have one size; the map outlives the view.
  CutView(const DepthMap& map, const CutVolume& volume);

  /// The camera coordinates [map units] of voxel coordinates q are origin() + axes() * q.
  [[nodiscard]] const Eigen::Vector3f& origin() const { return origin_; }
  [[nodiscard]] const Eigen::Matrix3f& axes() const { return axes_; }
  /// Where the camera stands [voxels].
  [[nodiscard]] const Eigen::Vector3d& centre() const { return centre_; }

  /// The pixel that shows a point of camera coordinates; -1 if it is behind the camera or outside
  /// the image.
  [[nodiscard]] std::ptrdiff_t pixel(const Eigen::Vector3f& p_camera) const {
    if (!(p_camera.z() > nearest_)) return -1;
    const float inverse = 1 / p_camera.z();
    const float u = fx_ * p_camera.x() * inverse + cx_, v = fy_ * p_camera.y() * inverse + cy_;
    if (!(u >= 0 && v >= 0 && u < width_ && v < height_)) return -1;
    return static_cast<std::ptrdiff_t>(v) * stride_ + static_cast<std::ptrdiff_t>(u);
  }
  /// z [map units]; 0: no answer. Finite.
  [[nodiscard]] float depth(std::ptrdiff_t pixel) const {
    const float d = depth_[pixel];
    return d < kFarthest ? d : 0;
  }
  [[nodiscard]] float confidence(std::ptrdiff_t pixel) const { return confidence_[pixel]; }
  /// Depth at a place between pixels: bilinear where the four around differ by less than `reach`,
  /// otherwise the nearest one's.
  [[nodiscard]] float smooth_depth(const Eigen::Vector3f& p_camera, std::ptrdiff_t pixel,
                                   float reach) const;

  /// What lies around a ball, in camera coordinates [map units].
  [[nodiscard]] const DepthTiles& tiles() const { return tiles_; }

  /// Calls with the voxel coordinates and the confidence of every point.
  template <class Call>
  void for_each_point(Call&& call) const {
    std::ptrdiff_t i = 0;
    for (int y = 0; y < rows_; ++y) {
      for (int x = 0; x < stride_; ++x, ++i) {
        const float d = depth(i);
        if (!(d > 0 && confidence(i) > 0)) continue;
        call(Eigen::Vector3d(centre_ + static_cast<double>(d) * (rays_ * Eigen::Vector3d(x, y, 1))),
             confidence(i));
      }
    }
  }

 private:
  static constexpr float kFarthest = 1e30F;
  const float *depth_, *confidence_;
  int stride_, rows_;
  float fx_, fy_, cx_, cy_;  ///< the principal point is half a pixel larger, to round by truncation
  float width_, height_, nearest_;
  Eigen::Vector3f origin_;
  Eigen::Matrix3f axes_;
  Eigen::Vector3d centre_;
  static constexpr int kTile_px = 8;
  DepthTiles tiles_;
  Eigen::Matrix3d rays_;  ///< from (u, v, 1) to the ray of z = 1 [voxels per map unit]
};

/// The voxels that hold a point, and how many points there are in the volume.
struct PointVoxels {
  BitGrid voxels;
  std::size_t points = 0;
};
[[nodiscard]] PointVoxels find_points(std::span<const CutView> views, const CutVolume& volume,
                                      int threads);

/// What the views say of a voxel that is not near any point.
enum class CutLabel : std::uint8_t { unknown, outside, inside };

/// Labels of cells of 2x2x2 voxels, by their middle.
struct CutCells {
  Eigen::Vector3i size = Eigen::Vector3i::Zero();  ///< [cells]
  std::vector<CutLabel> labels;
  [[nodiscard]] std::size_t index(int x, int y, int z) const {
    return static_cast<std::size_t>(x) +
           static_cast<std::size_t>(size.x()) *
               (static_cast<std::size_t>(y) +
                static_cast<std::size_t>(size.y()) * static_cast<std::size_t>(z));
  }
  [[nodiscard]] bool inside(const Eigen::Vector3i& voxel) const {
    return labels[index(voxel.x() >> 1, voxel.y() >> 1, voxel.z() >> 1)] == CutLabel::inside;
  }
};

/// Labels by visibility (thesis 6.7.3), at the volume's borders like everywhere. A cell is
/// - inside if it lies behind a point for at least `inside_share` of the views whose ray through it
///   has a depth, and if these views are about as many as have a depth where there is a surface:
///   what many views see before an empty background is not inside;
/// - outside if it is not inside, and at least `outside_share` of the views that look at it see
///   through it: those that are not held up farther in front of it.
/// Cells of which that says nothing take the label of the nearest cell that has one, counted in
/// steps that do not cross the crust; cells that none reaches are inside if more views lie behind a
/// point than see through. Cells that lie wholly in the crust stay unknown.
/// Asked to stop, it returns early, here and below: what it returns is then of no use.
[[nodiscard]] CutCells label_cells(std::span<const CutView> views, double voxel_size,
                                   const BitGrid& crust, double outside_share, double inside_share,
                                   int threads, const std::stop_token& stop = {});

/// Votes for the links between a voxel and the next one along each axis, in steps of 1/kVoteSteps.
inline constexpr int kVoteSteps = 32;
struct LinkVotes {
  /// By axis, by place.
  std::array<std::vector<std::uint8_t>, 3> sums;
};
/// A point votes for the three links (one per axis) that it lies on: those between the voxels
/// around it. Each view votes once per link, with the point's confidence. Sums saturate at 255.
[[nodiscard]] LinkVotes count_votes(std::span<const CutView> views, const CrustBlocks& blocks,
                                    int threads, const std::stop_token& stop = {});

/// How far in front of the measured surface the voxels of the crust lie.
struct CutDistances {
  static constexpr float kReach = 4;      ///< farther is cut off in front, and not seen behind
  static constexpr int kSteps = 31;       ///< per voxel
  static constexpr int kWeightSteps = 8;  ///< per view of full confidence
  std::vector<std::int8_t> distance;      ///< mean over the views [voxels / kSteps], by place
  std::vector<std::uint8_t> weight;       ///< sum of confidences, saturating; 0: not seen
};
/// Mean signed distances along the views' rays, positive in front (Curless and Levoy 1996), of the
/// voxels of the crust.
[[nodiscard]] CutDistances measure_distances(std::span<const CutView> views, double voxel_size,
                                             const BitGrid& crust, const CrustBlocks& blocks,
                                             int threads, const std::stop_token& stop = {});

}  // namespace corvid
