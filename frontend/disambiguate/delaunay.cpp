#include "frontend/disambiguate/delaunay.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <opencv2/imgproc.hpp>
#include <utility>

namespace corvid {
namespace {

constexpr float kGrid = 2048;      // the extent of the points, in units
constexpr float kFraction = 1024;  // grid points per unit
constexpr int kMargin = 8 * 2048;  // keeps OpenCV's three outer vertices far away
constexpr std::size_t kOuter = 4;  // vertices of OpenCV's that are no points

/// Along this order neighbours in the plane follow each other, so that each search is short.
std::uint32_t hilbert_index(const Eigen::Vector2f& place) {
  const auto clamp = [](float v) {
    return static_cast<std::uint32_t>(std::clamp(v, 0.0F, kGrid - 1));
  };
  std::uint32_t x = clamp(place.x()), y = clamp(place.y()), index = 0;
  for (std::uint32_t s = static_cast<std::uint32_t>(kGrid) / 2; s > 0; s /= 2) {
    const bool right = x & s, down = y & s;
    index += s * s * ((right ? 3U : 0U) ^ (down ? 1U : 0U));
    if (down) continue;
    if (right) {
      x = static_cast<std::uint32_t>(kGrid) - 1 - x;
      y = static_cast<std::uint32_t>(kGrid) - 1 - y;
    }
    std::swap(x, y);
  }
  return index;
}

std::vector<std::size_t> short_way(std::span<const std::optional<Eigen::Vector2f>> places) {
  std::vector<std::pair<std::uint32_t, std::size_t>> order;
  for (std::size_t i = 0; i < places.size(); ++i)
    if (places[i]) order.emplace_back(hilbert_index(*places[i]), i);
  std::sort(order.begin(), order.end());
  std::vector<std::size_t> way;
  for (const auto& [index, i] : order) way.push_back(i);
  return way;
}

}  // namespace

struct Delaunay::Mesh {
  cv::Subdiv2D subdivision{cv::Rect(-kMargin, -kMargin, 2 * kMargin + static_cast<int>(kGrid),
                                    2 * kMargin + static_cast<int>(kGrid))};
};

std::optional<Eigen::Vector2f> Delaunay::on_grid(const Eigen::Vector2d& point) const {
  const Eigen::Vector2d units = scale_ * (point - origin_);
  if (!units.allFinite() || units.cwiseAbs().maxCoeff() >= kMargin) return std::nullopt;
  return (units * kFraction).array().round().matrix().cast<float>() / kFraction;
}

Delaunay::~Delaunay() = default;
Delaunay::Delaunay(Delaunay&&) noexcept = default;
Delaunay& Delaunay::operator=(Delaunay&&) noexcept = default;

Delaunay::Delaunay(std::span<const Eigen::Vector2d> points)
    : vertex_of_(points.size()), mesh_(std::make_unique<Mesh>()) {
  Eigen::AlignedBox2d box;
  for (const Eigen::Vector2d& point : points)
    if (point.allFinite()) box.extend(point);
  if (!box.isEmpty()) {
    origin_ = box.min();
    const double extent = box.sizes().maxCoeff();
    if (extent > 0 && std::isfinite(extent)) scale_ = kGrid / extent;
  }
  std::vector<std::optional<Eigen::Vector2f>> places;
  for (const Eigen::Vector2d& point : points) places.push_back(on_grid(point));

  cv::Subdiv2D& subdivision = mesh_->subdivision;
  point_of_.assign(kOuter, 0);
  for (std::size_t i : short_way(places)) {
    const auto vertex =
        static_cast<std::size_t>(subdivision.insert({places[i]->x(), places[i]->y()}));
    vertex_of_[i] = vertex;
    if (vertex == point_of_.size()) {
      point_of_.push_back(i);
    } else {
      point_of_[vertex] = std::min(point_of_[vertex], i);
    }
  }

  first_.reserve(point_of_.size() + 1);
  neighbours_.reserve(6 * point_of_.size());
  first_.assign(kOuter + 1, 0);
  for (std::size_t vertex = kOuter; vertex < point_of_.size(); ++vertex) {
    int first_edge = 0;
    subdivision.getVertex(static_cast<int>(vertex), &first_edge);
    int edge = first_edge;
    do {
      const auto other = static_cast<std::size_t>(subdivision.edgeDst(edge));
      if (other >= kOuter) neighbours_.push_back(point_of_[other]);
      edge = subdivision.getEdge(edge, cv::Subdiv2D::NEXT_AROUND_ORG);
    } while (edge != first_edge);
    first_.push_back(neighbours_.size());
  }
}

std::vector<std::optional<Delaunay::Triangle>> Delaunay::triangles(
    std::span<const Eigen::Vector2d> places) {
  cv::Subdiv2D& subdivision = mesh_->subdivision;
  std::vector<std::optional<Eigen::Vector2f>> wanted;
  for (const Eigen::Vector2d& place : places) wanted.push_back(on_grid(place));
  std::vector<std::optional<Triangle>> found(places.size());
  for (std::size_t i : short_way(wanted)) {
    int edge = 0, vertex = 0;
    const int where = subdivision.locate({wanted[i]->x(), wanted[i]->y()}, edge, vertex);
    if (where != cv::Subdiv2D::PTLOC_INSIDE && where != cv::Subdiv2D::PTLOC_ON_EDGE) continue;
    // An edge has a triangle on either side: of a place on the hull, one has an outer vertex.
    for (int direction : {cv::Subdiv2D::NEXT_AROUND_LEFT, cv::Subdiv2D::NEXT_AROUND_RIGHT}) {
      Triangle corners{};
      bool inside = true;
      Eigen::Vector2f corner[3];
      for (std::size_t k = 0; k < 3; ++k) {
        const int origin = subdivision.edgeOrg(edge);
        inside = inside && static_cast<std::size_t>(origin) >= kOuter;
        const cv::Point2f at = subdivision.getVertex(origin);
        corner[k] = {at.x, at.y};
        corners[k] = point_of_[static_cast<std::size_t>(origin)];
        edge = subdivision.getEdge(edge, direction);
      }
      double least = 0, most = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        const Eigen::Vector2d side = (corner[(k + 1) % 3] - corner[k]).cast<double>();
        const Eigen::Vector2d to = (*wanted[i] - corner[k]).cast<double>();
        const double area = side.x() * to.y() - side.y() * to.x();
        least = std::min(least, area);
        most = std::max(most, area);
      }
      if (!inside || (least < 0 && most > 0)) continue;
      found[i] = corners;
      break;
    }
  }
  return found;
}

}  // namespace corvid
