#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "corvid/mesh_stream.h"

namespace corvid {

enum class Material : std::uint8_t {
  plaster,
  facade,
  roof_tile,
  gravel,
  foliage,
  bark,
  paint,
  smooth
};

/// What a face looks like.
struct Style {
  Material material = Material::plaster;
  Eigen::Vector3f colour{0.6f, 0.6f, 0.6f};  ///< linear albedo
  Eigen::Vector3f trim{0.8f, 0.8f, 0.8f};    ///< window frames
  float floor_height_m = 3.1f;
  float window_pitch_m = 2.7f;
  float window_width_m = 1.15f;
  float window_height_m = 1.45f;
};

/// One side of a solid: { p : normal . p = offset }, normal outwards, with coordinates on it:
/// u to the right along the face's horizontal direction, v up along it [m].
struct Face {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double offset = 0;
  Style style;
  bool in_mesh = true;  ///< false: nothing can see it
  Eigen::Vector3d u_axis = Eigen::Vector3d::UnitX(), v_axis = Eigen::Vector3d::UnitY();
  double u0 = 0, v0 = 0;  ///< of the left and lower edge: u = u_axis . p - u0
  float width_m = 0, height_m = 0;
  std::vector<Eigen::Vector3d> polygon;  ///< counter-clockwise from outside
};

/// A convex polyhedron. The whole town but the ground is made of these: a ray meets them exactly,
/// and their faces are exactly the truth's mesh.
struct Solid {
  std::vector<Face> faces;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double radius = 0;    ///< of a sphere about the centre that holds the solid
  double ground_z = 0;  ///< height of the ground at its foot; for the soft shading
  bool round = false;   ///< shaded as a surface of revolution about the vertical through centre
};

/// The solid inside all the half-spaces. Faces that the others cut away entirely are left out.
/// @pre the intersection is bounded and not empty.
[[nodiscard]] Solid make_solid(std::vector<Face> half_spaces, double ground_z);

/// Stands on the plane z = bottom, turned by yaw about the vertical through `foot`; local x is the
/// length, local y the width.
struct Placement {
  Eigen::Vector3d foot;
  double yaw_rad = 0;
};
/// Walls in `style`, bottom never in the mesh, top in `top_style`.
[[nodiscard]] Solid make_box(const Placement& at, double length, double width, double bottom_z,
                             double top_z, const Style& style, const Style& top_style,
                             bool top_in_mesh, double ground_z);
/// A roof: a prism with its ridge along local x; `hip` > 0 slopes the two ends as well, by that
/// many metres of ridge at each end.
[[nodiscard]] Solid make_roof(const Placement& at, double length, double width, double eaves_z,
                              double ridge_z, double hip, const Style& tiles, const Style& gable,
                              double ground_z);
/// A frustum of a cone with n sides about the vertical.
[[nodiscard]] Solid make_cone(const Eigen::Vector3d& foot, double radius_bottom, double radius_top,
                              double bottom_z, double top_z, int sides, const Style& style,
                              bool top_in_mesh, double ground_z);
/// A blob with `sides` flat sides, irregular by the seed: crowns and bushes.
[[nodiscard]] Solid make_blob(const Eigen::Vector3d& centre, const Eigen::Vector3d& half_axes,
                              int sides, std::uint64_t seed, const Style& style, double ground_z);

/// Appends the visible faces.
void append_mesh(const Solid& solid, TriangleMesh& mesh);

}  // namespace corvid
