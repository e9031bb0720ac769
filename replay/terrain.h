#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "corvid/mesh_stream.h"

namespace corvid {

/// The ground: a square grid of heights, two triangles per cell (split along +x+y), gentle in
/// the middle and rising to hills at the rim. What is rendered is exactly these triangles.
class Terrain {
 public:
  static constexpr double kCell_m = 5;
  static constexpr int kCells = 160;
  static constexpr double kHalf_m = kCell_m * kCells / 2;

  explicit Terrain(std::uint64_t seed);

  /// Height of the triangles [m]; the rim's height outside.
  [[nodiscard]] double height(double x, double y) const;
  /// Normal blended over the neighbouring cells: for shading only.
  [[nodiscard]] Eigen::Vector3f smooth_normal(double x, double y) const;

  struct Hit {
    double t = 0;
    Eigen::Vector3d normal;  ///< of the triangle, not of unit length, z = 1
  };
  /// The first t in (0, t_max) at which origin + t * ray meets the ground.
  [[nodiscard]] std::optional<Hit> intersect(const Eigen::Vector3d& origin,
                                             const Eigen::Vector3d& ray, double t_max) const;
  void append_mesh(TriangleMesh& mesh) const;

 private:
  [[nodiscard]] float at(int i, int j) const {
    return heights_[static_cast<std::size_t>(j * (kCells + 1) + i)];
  }
  std::vector<float> heights_;
  std::vector<Eigen::Vector3f> normals_;  ///< at the grid's points, blended
  double inner_max_ = 0;                  ///< highest ground within kInner_m of the middle
  static constexpr double kInner_m = 230;
};

}  // namespace corvid
