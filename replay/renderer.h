#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "corvid/camera.h"
#include "corvid/image.h"
#include "corvid/pose.h"
#include "replay/town.h"

namespace corvid {

struct Radiance {
  float r = 0, g = 0, b = 0;
};
using RadianceImage = Image<Radiance>;

/// Casts the exact ray of every pixel of a camera into the town.
///
/// Depth and visibility are those of the pixel centre's ray. Colour is that of the centre where a
/// surface's pattern can be integrated over the pixel, and the mean of eight rays where surfaces
/// meet. Thread-safe; the number of threads never changes a result.
class Renderer {
 public:
  Renderer(std::shared_ptr<const Town> town, const Camera& camera, int threads);

  /// Linear light before lens and sensor.
  [[nodiscard]] RadianceImage render(const Pose& T_world_camera) const;
  /// z in camera coordinates [m]; 0 where there is sky or the lens model has no ray.
  [[nodiscard]] FloatImage depth(const Pose& T_world_camera) const;

 private:
  struct View;
  struct Visible;
  [[nodiscard]] View prepare(const Pose& T_world_camera) const;
  [[nodiscard]] std::vector<int> candidates(const View& view, int x0, int y0, int x1, int y1,
                                            std::span<const int> among) const;
  [[nodiscard]] Visible cast(const View& view, const Eigen::Vector3d& ray,
                             std::span<const int> solids, bool ground = true) const;
  [[nodiscard]] Eigen::Vector3f colour(const View& view, const Visible& visible,
                                       const Eigen::Vector3d& ray, const Eigen::Vector3d& ray_dx,
                                       const Eigen::Vector3d& ray_dy) const;
  template <class Work>
  void for_pixels(const View& view, const Work& work) const;

  std::shared_ptr<const Town> town_;
  int threads_;
  Image<Eigen::Vector2d> rays_;  ///< (x, y) at z = 1; NaN where the lens has no ray
  /// All solids' planes one after the other, in the order of their faces.
  std::vector<Eigen::Vector4d> planes_;  ///< normal, offset
  std::vector<int> first_plane_;         ///< per solid, and one past the last
  std::vector<int> solid_of_;            ///< per plane
};

}  // namespace corvid
