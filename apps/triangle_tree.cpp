#include "apps/triangle_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/check.h"

namespace corvid {
namespace {

constexpr std::size_t kLeafTriangles = 4;

double middle(const TriangleCorners& t, Eigen::Index axis) {
  return t[0][axis] + t[1][axis] + t[2][axis];
}

}  // namespace

std::optional<TriangleCorners> triangle_corners(const TriangleMesh& mesh, std::size_t triangle) {
  TriangleCorners c;
  for (std::size_t k = 0; k < 3; ++k) {
    const std::size_t vertex = mesh.triangles[triangle][k];
    if (vertex >= mesh.vertices.size() || !mesh.vertices[vertex].allFinite()) return std::nullopt;
    c[k] = mesh.vertices[vertex].cast<double>();
  }
  if (!((c[1] - c[0]).cross(c[2] - c[0]).squaredNorm() > 0)) return std::nullopt;
  return c;
}

Eigen::Vector3d nearest_in_triangle(const Eigen::Vector3d& p, const TriangleCorners& triangle) {
  // Over the triangle it is the foot of the perpendicular, elsewhere it lies on an edge.
  const auto& [a, b, c] = triangle;
  const Eigen::Vector3d u = b - a, v = c - a, n = u.cross(v), w = p - a;
  const double nn = n.squaredNorm();
  if (nn > 0) {
    const double beta = w.cross(v).dot(n) / nn, gamma = u.cross(w).dot(n) / nn;
    if (beta >= 0 && gamma >= 0 && beta + gamma <= 1) return a + beta * u + gamma * v;
  }
  Eigen::Vector3d best = a;
  for (std::size_t k = 0; k < 3; ++k) {
    const Eigen::Vector3d& from = triangle[k];
    const Eigen::Vector3d edge = triangle[(k + 1) % 3] - from;
    const double length = edge.squaredNorm();
    const double t = length > 0 ? std::clamp((p - from).dot(edge) / length, 0.0, 1.0) : 0.0;
    const Eigen::Vector3d candidate = from + t * edge;
    if ((candidate - p).squaredNorm() < (best - p).squaredNorm()) best = candidate;
  }
  return best;
}

TriangleTree::TriangleTree(const TriangleMesh& mesh) {
  triangles_.reserve(mesh.triangles.size());
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
    if (const auto c = triangle_corners(mesh, i)) triangles_.push_back(*c);
  }
  nodes_.reserve(triangles_.size());
  if (!triangles_.empty()) build(0, triangles_.size());
}

std::size_t TriangleTree::build(std::size_t first, std::size_t last) {
  const std::size_t index = nodes_.size();
  Node node;
  node.first = first;
  node.last = last;
  for (std::size_t i = first; i < last; ++i) {
    for (const auto& corner : triangles_[i]) node.box.extend(corner);
  }
  nodes_.push_back(node);
  if (last - first <= kLeafTriangles) return index;
  Eigen::Index axis = 0;
  node.box.sizes().maxCoeff(&axis);
  const std::size_t half = first + (last - first) / 2;
  const auto at = [this](std::size_t i) {
    return triangles_.begin() + static_cast<std::ptrdiff_t>(i);
  };
  std::nth_element(at(first), at(half), at(last), [axis](const auto& a, const auto& b) {
    return middle(a, axis) < middle(b, axis);
  });
  build(first, half);
  nodes_[index].right = build(half, last);
  return index;
}

double TriangleTree::distance(const Eigen::Vector3d& p) const {
  CORVID_CHECK(!triangles_.empty(), "a search needs triangles");
  double best_squared = std::numeric_limits<double>::infinity();
  search(0, p, best_squared);
  return std::sqrt(best_squared);
}

void TriangleTree::search(std::size_t index, const Eigen::Vector3d& p, double& best_squared) const {
  const Node& node = nodes_[index];
  if (node.right == 0) {
    for (std::size_t i = node.first; i < node.last; ++i) {
      best_squared =
          std::min(best_squared, (nearest_in_triangle(p, triangles_[i]) - p).squaredNorm());
    }
    return;
  }
  std::pair<double, std::size_t> near(nodes_[index + 1].box.squaredExteriorDistance(p), index + 1);
  std::pair<double, std::size_t> far(nodes_[node.right].box.squaredExteriorDistance(p), node.right);
  if (far.first < near.first) std::swap(near, far);
  for (const auto& [squared, child] : {near, far}) {
    if (squared < best_squared) search(child, p, best_squared);
  }
}

}  // namespace corvid
