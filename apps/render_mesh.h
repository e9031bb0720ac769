#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "corvid/camera.h"
#include "corvid/image.h"
#include "corvid/mesh_stream.h"
#include "corvid/pose.h"

namespace corvid {

struct MeshPicture {
  ColourImage colour;
  GreyImage alpha;  ///< 0 where no surface is seen
};

/// A picture of a mesh by a z-buffer on the CPU: vertex colours (grey without them) times a lambert
/// term of a light beside the camera, two samples per pixel and axis. Backs of triangles are drawn
/// dark and bluish. Triangles that reach behind the camera are left out.
/// @param camera  pinhole (CORVID_CHECK).
[[nodiscard]] MeshPicture render_mesh(const TriangleMesh& mesh, const Camera& camera,
                                      const Pose& T_world_camera);

/// Right-handed axes for looking at a map: world directions that a reader calls right, forward, up.
struct ViewAxes {
  Eigen::Vector3d right = {1, 0, 0}, forward = {0, 0, 1}, up = {0, -1, 0};
  std::string right_name = "x", forward_name = "z", up_name = "−y";
  [[nodiscard]] Eigen::Vector2d top(const Eigen::Vector3d& p) const {
    return {right.dot(p), forward.dot(p)};
  }
  [[nodiscard]] Eigen::Vector2d side(const Eigen::Vector3d& p) const {
    return {forward.dot(p), up.dot(p)};
  }
};

/// The world is the first camera's, whose attitude is unknown. People and aircraft hold a camera
/// without roll most of the time, so that its x axis stays level: up is the direction that the x
/// axes of all poses spread least along, where they turn enough to tell. Otherwise up is -y (a
/// camera that looks ahead), or -z (one that looks down) where the path spreads far more along y
/// than along z.
[[nodiscard]] ViewAxes guess_axes(const std::vector<Pose>& T_world_camera);

struct MeshView {
  std::string name;
  Camera camera;
  Pose T_world_camera;
};

/// Up to two views from outside, which frame the middle 96 % of the mesh from the side that the
/// cameras looked from; none for an empty mesh.
[[nodiscard]] std::vector<MeshView> outside_views(const TriangleMesh& mesh, const ViewAxes& axes,
                                                  const std::vector<Pose>& T_world_camera,
                                                  int width_px, int height_px);

}  // namespace corvid
