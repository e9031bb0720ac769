#include "replay/solid.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/check.h"
#include "replay/random.h"

namespace corvid {
namespace {
using Polygon = std::vector<Eigen::Vector3d>;

/// The part of the polygon inside normal . p <= offset (Sutherland-Hodgman).
Polygon clip(const Polygon& polygon, const Eigen::Vector3d& normal, double offset) {
  Polygon inside;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Eigen::Vector3d& a = polygon[i];
    const Eigen::Vector3d& b = polygon[(i + 1) % polygon.size()];
    const double da = normal.dot(a) - offset, db = normal.dot(b) - offset;
    if (da <= 0) inside.push_back(a);
    if ((da < 0 && db > 0) || (da > 0 && db < 0)) inside.push_back(a + (b - a) * (da / (da - db)));
  }
  return inside;
}

double area(const Polygon& polygon) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t i = 2; i < polygon.size(); ++i)
    sum += (polygon[i - 1] - polygon[0]).cross(polygon[i] - polygon[0]);
  return 0.5 * sum.norm();
}

void set_axes(Face& face) {
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  face.u_axis = std::abs(face.normal.z()) > 0.999 ? Eigen::Vector3d(Eigen::Vector3d::UnitX())
                                                  : up.cross(face.normal).normalized();
  face.v_axis = face.normal.cross(face.u_axis);
}

Face half_space(const Eigen::Vector3d& normal, const Eigen::Vector3d& point, const Style& style,
                bool in_mesh = true) {
  Face face;
  face.normal = normal.normalized();
  face.offset = face.normal.dot(point);
  face.style = style;
  face.in_mesh = in_mesh;
  return face;
}

struct Axes {
  Eigen::Vector3d x, y, z;
};
Axes axes_of(const Placement& at) {
  const double c = std::cos(at.yaw_rad), s = std::sin(at.yaw_rad);
  return {{c, s, 0}, {-s, c, 0}, {0, 0, 1}};
}
Eigen::Vector3d at_height(const Eigen::Vector3d& foot, double z) { return {foot.x(), foot.y(), z}; }
}  // namespace

Solid make_solid(std::vector<Face> half_spaces, double ground_z) {
  constexpr double kFar = 1000;
  Solid solid;
  solid.ground_z = ground_z;
  for (std::size_t i = 0; i < half_spaces.size(); ++i) {
    Face face = half_spaces[i];
    set_axes(face);
    const Eigen::Vector3d origin = face.normal * face.offset;
    for (const auto& [a, b] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}})
      face.polygon.push_back(origin + kFar * (a * face.u_axis + b * face.v_axis));
    for (std::size_t j = 0; j < half_spaces.size() && !face.polygon.empty(); ++j)
      if (j != i) face.polygon = clip(face.polygon, half_spaces[j].normal, half_spaces[j].offset);
    if (face.polygon.size() < 3 || area(face.polygon) < 1e-9) continue;
    solid.faces.push_back(std::move(face));
  }
  CORVID_CHECK(solid.faces.size() >= 4, "a solid needs at least four faces");

  Eigen::Vector3d low = solid.faces[0].polygon[0], high = low;
  for (const Face& face : solid.faces)
    for (const Eigen::Vector3d& p : face.polygon) {
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
  CORVID_CHECK((high - low).maxCoeff() < kFar / 2, "a solid must be bounded");
  solid.centre = 0.5 * (low + high);
  for (Face& face : solid.faces) {
    double u_low = 1e300, u_high = -1e300, v_low = 1e300, v_high = -1e300;
    for (const Eigen::Vector3d& p : face.polygon) {
      solid.radius = std::max(solid.radius, (p - solid.centre).norm());
      u_low = std::min(u_low, face.u_axis.dot(p));
      u_high = std::max(u_high, face.u_axis.dot(p));
      v_low = std::min(v_low, face.v_axis.dot(p));
      v_high = std::max(v_high, face.v_axis.dot(p));
    }
    face.u0 = u_low;
    // Walls measure v from the ground, so that floors are level whatever the foundation's depth.
    face.v0 = std::abs(face.normal.z()) < 0.01 ? std::max(v_low, ground_z) : v_low;
    face.width_m = static_cast<float>(u_high - u_low);
    face.height_m = static_cast<float>(v_high - face.v0);
  }
  return solid;
}

Solid make_box(const Placement& at, double length, double width, double bottom_z, double top_z,
               const Style& style, const Style& top_style, bool top_in_mesh, double ground_z) {
  const Axes a = axes_of(at);
  const Eigen::Vector3d low = at_height(at.foot, bottom_z), high = at_height(at.foot, top_z);
  return make_solid({half_space(a.x, low + a.x * length / 2, style),
                     half_space(-a.x, low - a.x * length / 2, style),
                     half_space(a.y, low + a.y * width / 2, style),
                     half_space(-a.y, low - a.y * width / 2, style),
                     half_space(a.z, high, top_style, top_in_mesh),
                     half_space(-a.z, low, style, bottom_z > ground_z)},
                    ground_z);
}

Solid make_roof(const Placement& at, double length, double width, double eaves_z, double ridge_z,
                double hip, const Style& tiles, const Style& gable, double ground_z) {
  const Axes a = axes_of(at);
  const Eigen::Vector3d low = at_height(at.foot, eaves_z);
  const double rise = ridge_z - eaves_z;
  return make_solid(
      {half_space(a.y * rise + a.z * (width / 2), low + a.y * width / 2, tiles),
       half_space(-a.y * rise + a.z * (width / 2), low - a.y * width / 2, tiles),
       half_space(a.x * rise + a.z * hip, low + a.x * length / 2, hip > 0 ? tiles : gable),
       half_space(-a.x * rise + a.z * hip, low - a.x * length / 2, hip > 0 ? tiles : gable),
       half_space(-a.z, low, gable)},
      ground_z);
}

Solid make_cone(const Eigen::Vector3d& foot, double radius_bottom, double radius_top,
                double bottom_z, double top_z, int sides, const Style& style, bool top_in_mesh,
                double ground_z) {
  std::vector<Face> faces;
  const double rise = top_z - bottom_z;
  for (int i = 0; i < sides; ++i) {
    const double angle = 2 * std::numbers::pi * i / sides;
    const Eigen::Vector3d out(std::cos(angle), std::sin(angle), 0);
    faces.push_back(half_space(out * rise + Eigen::Vector3d(0, 0, radius_bottom - radius_top),
                               at_height(foot, bottom_z) + out * radius_bottom, style));
  }
  faces.push_back(half_space(Eigen::Vector3d::UnitZ(), at_height(foot, top_z), style, top_in_mesh));
  faces.push_back(
      half_space(-Eigen::Vector3d::UnitZ(), at_height(foot, bottom_z), style, bottom_z > ground_z));
  Solid solid = make_solid(std::move(faces), ground_z);
  solid.round = style.material == Material::smooth;
  return solid;
}

Solid make_blob(const Eigen::Vector3d& centre, const Eigen::Vector3d& half_axes, int sides,
                std::uint64_t seed, const Style& style, double ground_z) {
  Random random(seed);
  const double turn = random.uniform(0, 2 * std::numbers::pi);
  std::vector<Face> faces;
  for (int i = 0; i < sides; ++i) {
    // Directions along a spiral of equal areas (Saff, Kuijlaars, 1997).
    const double z = 1 - (2 * i + 1.0) / sides, r = std::sqrt(1 - z * z);
    const double angle = turn + i * std::numbers::pi * (3 - std::sqrt(5.0));
    const Eigen::Vector3d direction(r * std::cos(angle), r * std::sin(angle), z);
    const Eigen::Vector3d touch =
        centre + random.uniform(0.78, 1.0) * direction.cwiseProduct(half_axes);
    faces.push_back(half_space(direction.cwiseQuotient(half_axes), touch, style));
  }
  return make_solid(std::move(faces), ground_z);
}

void append_mesh(const Solid& solid, TriangleMesh& mesh) {
  for (const Face& face : solid.faces) {
    if (!face.in_mesh) continue;
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    for (const Eigen::Vector3d& p : face.polygon) mesh.vertices.push_back(p.cast<float>());
    for (std::uint32_t i = 2; i < face.polygon.size(); ++i)
      mesh.triangles.push_back({first, first + i - 1, first + i});
  }
}

}  // namespace corvid
