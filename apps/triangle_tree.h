#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "corvid/mesh_stream.h"

namespace corvid {

using TriangleCorners = std::array<Eigen::Vector3d, 3>;

/// The corners of one triangle of a mesh; nothing if an index is out of range, a coordinate is not
/// finite, or the triangle has no area.
[[nodiscard]] std::optional<TriangleCorners> triangle_corners(const TriangleMesh& mesh,
                                                              std::size_t triangle);
/// The point of a triangle nearest to p. Triangles without area are segments or points.
[[nodiscard]] Eigen::Vector3d nearest_in_triangle(const Eigen::Vector3d& p,
                                                  const TriangleCorners& triangle);

/// Exact distances to a mesh: a hierarchy of boxes round its triangles, each range of triangles
/// split at the median of their middles along the widest side. Build O(N log^2 N), search O(log N)
/// where triangles overlap little. Triangles without corners (above) are passed over.
class TriangleTree {
 public:
  explicit TriangleTree(const TriangleMesh& mesh);
  [[nodiscard]] bool empty() const { return triangles_.empty(); }
  /// Distance to the nearest point of the mesh, which must not be empty.
  [[nodiscard]] double distance(const Eigen::Vector3d& p) const;

 private:
  struct Node {
    Eigen::AlignedBox3d box;
    std::size_t first = 0, last = 0;  ///< triangles in it
    std::size_t right = 0;            ///< second child; the first one follows its parent; 0: a leaf
  };
  std::size_t build(std::size_t first, std::size_t last);
  void search(std::size_t node, const Eigen::Vector3d& p, double& best_squared) const;

  std::vector<TriangleCorners> triangles_;
  std::vector<Node> nodes_;
};

}  // namespace corvid
