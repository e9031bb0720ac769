#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <vector>

namespace corvid {

/// Delaunay triangulation of points in an image (thesis 3.3). Points that coincide, to 1 in 2^21 of
/// the extent of all, are one vertex: the first of them is named as a neighbour or corner, and all
/// of them have its neighbours. Edges along the convex hull may be missing where it is nearly
/// straight.
class Delaunay {
 public:
  using Triangle = std::array<std::size_t, 3>;

  /// Any number of points in any position. Points that are not finite have no neighbours.
  explicit Delaunay(std::span<const Eigen::Vector2d> points = {});
  ~Delaunay();
  Delaunay(Delaunay&&) noexcept;
  Delaunay& operator=(Delaunay&&) noexcept;

  /// The points that an edge joins to point i.
  [[nodiscard]] std::span<const std::size_t> neighbours(std::size_t i) const {
    const std::size_t v = vertex_of_[i];
    return std::span(neighbours_).subspan(first_[v], first_[v + 1] - first_[v]);
  }

  /// The corners of the triangle that holds each place; nothing outside of the triangulation, and
  /// at a vertex.
  [[nodiscard]] std::vector<std::optional<Triangle>> triangles(
      std::span<const Eigen::Vector2d> places);

 private:
  struct Mesh;
  /// What is triangulated: the points moved and scaled onto a grid on which it is exact.
  [[nodiscard]] std::optional<Eigen::Vector2f> on_grid(const Eigen::Vector2d& point) const;

  Eigen::Vector2d origin_ = Eigen::Vector2d::Zero();
  double scale_ = 1;
  std::vector<std::size_t> vertex_of_;   ///< of each point; 0: of none
  std::vector<std::size_t> first_;       ///< of each vertex, its range in neighbours_
  std::vector<std::size_t> neighbours_;  ///< points
  std::vector<std::size_t> point_of_;    ///< of each vertex
  std::unique_ptr<Mesh> mesh_;
};

}  // namespace corvid
