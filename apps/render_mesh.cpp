#include "apps/render_mesh.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>

#include "core/check.h"

namespace corvid {
namespace {

constexpr int kSamples = 2;  ///< per pixel and axis

/// A triangle's corners in the sample raster.
struct Corner {
  double x = 0, y = 0, inverse_z = 0;
  Eigen::Vector3d colour = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();
};

struct Raster {
  int width, height;
  std::vector<float> inverse_depth;  ///< 0: nothing
  std::vector<Eigen::Vector3f> colour;
};

void draw_triangle(const std::array<Corner, 3>& c, bool back, Raster& raster) {
  const double area = (c[1].x - c[0].x) * (c[2].y - c[0].y) - (c[2].x - c[0].x) * (c[1].y - c[0].y);
  if (std::abs(area) < 1e-9) return;
  const auto [low_x, high_x] = std::minmax({c[0].x, c[1].x, c[2].x});
  const auto [low_y, high_y] = std::minmax({c[0].y, c[1].y, c[2].y});
  const int x0 = static_cast<int>(std::ceil(std::clamp(low_x, 0.0, 1e6)));
  const int y0 = static_cast<int>(std::ceil(std::clamp(low_y, 0.0, 1e6)));
  const int x1 = static_cast<int>(std::floor(std::clamp(high_x, -1.0, raster.width - 1.0)));
  const int y1 = static_cast<int>(std::floor(std::clamp(high_y, -1.0, raster.height - 1.0)));
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      double w[3];
      w[0] = ((c[1].x - x) * (c[2].y - y) - (c[2].x - x) * (c[1].y - y)) / area;
      w[1] = ((c[2].x - x) * (c[0].y - y) - (c[0].x - x) * (c[2].y - y)) / area;
      w[2] = 1 - w[0] - w[1];
      if (w[0] < 0 || w[1] < 0 || w[2] < 0) continue;
      double inverse_z = 0;
      for (int i = 0; i < 3; ++i) inverse_z += w[i] * c[static_cast<std::size_t>(i)].inverse_z;
      const std::size_t at = static_cast<std::size_t>(y) * static_cast<std::size_t>(raster.width) +
                             static_cast<std::size_t>(x);
      if (inverse_z <= raster.inverse_depth[at]) continue;
      raster.inverse_depth[at] = static_cast<float>(inverse_z);
      Eigen::Vector3d colour = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();
      for (int i = 0; i < 3; ++i) {  // perspective-correct: weights times 1/z
        const Corner& corner = c[static_cast<std::size_t>(i)];
        colour += w[i] * corner.inverse_z / inverse_z * corner.colour;
        normal += w[i] * corner.inverse_z / inverse_z * corner.normal;
      }
      // Light from above the viewer's left shoulder, in camera coordinates (y down).
      const Eigen::Vector3d to_light = Eigen::Vector3d(-0.45, -0.65, -0.8).normalized();
      const double length = normal.norm();
      const double lambert = length > 0 ? std::abs(normal.dot(to_light)) / length : 0.5;
      Eigen::Vector3d shaded = colour * (0.45 + 0.6 * lambert);
      if (back) shaded = shaded.cwiseProduct(Eigen::Vector3d(0.35, 0.4, 0.55));
      raster.colour[at] = shaded.cast<float>();
    }
  }
}

MeshPicture resolve(const Raster& raster, int width, int height) {
  MeshPicture out{ColourImage(width, height), GreyImage(width, height)};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      Eigen::Vector3f sum = Eigen::Vector3f::Zero();
      int hits = 0;
      for (int sy = 0; sy < kSamples; ++sy) {
        for (int sx = 0; sx < kSamples; ++sx) {
          const std::size_t at =
              static_cast<std::size_t>(y * kSamples + sy) * static_cast<std::size_t>(raster.width) +
              static_cast<std::size_t>(x * kSamples + sx);
          if (!(raster.inverse_depth[at] > 0)) continue;
          sum += raster.colour[at];
          ++hits;
        }
      }
      if (hits == 0) continue;
      const auto byte = [&](int i) {
        return static_cast<std::uint8_t>(
            std::lround(std::clamp(sum[i] / static_cast<float>(hits), 0.0f, 255.0f)));
      };
      out.colour(x, y) = {byte(0), byte(1), byte(2)};
      out.alpha(x, y) = static_cast<std::uint8_t>(255 * hits / (kSamples * kSamples));
    }
  }
  return out;
}

/// Value below which the given share of the values lies; values must not be empty.
float quantile(std::vector<float> values, double share) {
  const auto nth =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

/// Camera at `eye` that looks at `target` with `up` upwards in the image.
Pose look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target, const Eigen::Vector3d& up) {
  const Eigen::Vector3d z = (target - eye).normalized();
  const Eigen::Vector3d x = z.cross(up).normalized();
  Eigen::Matrix3d R;
  R << x, z.cross(x), z;
  return {R, eye};
}

}  // namespace

MeshPicture render_mesh(const TriangleMesh& mesh, const Camera& camera,
                        const Pose& T_world_camera) {
  CORVID_CHECK(camera.model == CameraModel::pinhole && camera.width_px > 0 && camera.height_px > 0,
               "meshes are rendered by pinhole cameras");
  Raster raster{camera.width_px * kSamples, camera.height_px * kSamples, {}, {}};
  const std::size_t size =
      static_cast<std::size_t>(raster.width) * static_cast<std::size_t>(raster.height);
  raster.inverse_depth.assign(size, 0);
  raster.colour.assign(size, Eigen::Vector3f::Zero());

  const Pose T_camera_world = T_world_camera.inverse();
  const Eigen::Matrix3d R = T_camera_world.R();
  const std::size_t n = mesh.vertices.size();
  const bool has_colours = mesh.colours.size() == n, has_normals = mesh.normals.size() == n;
  std::vector<Corner> corners(n);
  std::vector<Eigen::Vector3d> p_camera(n);
  for (std::size_t i = 0; i < n; ++i) {
    p_camera[i] = R * mesh.vertices[i].cast<double>() + T_camera_world.translation();
    Corner& c = corners[i];
    if (!p_camera[i].allFinite() || !(p_camera[i].z() > 1e-6)) continue;
    c.inverse_z = 1 / p_camera[i].z();
    // Pixel centres are whole numbers: sample k of pixel x lies at x - 0.5 + (k + 0.5) / kSamples.
    const double u = camera.fx_px * p_camera[i].x() * c.inverse_z + camera.cx_px;
    const double v = camera.fy_px * p_camera[i].y() * c.inverse_z + camera.cy_px;
    c.x = (u + 0.5) * kSamples - 0.5;
    c.y = (v + 0.5) * kSamples - 0.5;
    const Rgb8 colour = has_colours ? mesh.colours[i] : Rgb8{190, 190, 190};
    c.colour = Eigen::Vector3d(colour.r, colour.g, colour.b);
    if (has_normals) c.normal = R * mesh.normals[i].cast<double>();
  }
  for (const auto& t : mesh.triangles) {
    if (std::max({t[0], t[1], t[2]}) >= n) continue;
    std::array<Corner, 3> c = {corners[t[0]], corners[t[1]], corners[t[2]]};
    if (!(c[0].inverse_z > 0) || !(c[1].inverse_z > 0) || !(c[2].inverse_z > 0)) continue;
    const Eigen::Vector3d face =
        (p_camera[t[1]] - p_camera[t[0]]).cross(p_camera[t[2]] - p_camera[t[0]]);
    if (!has_normals) {
      for (Corner& corner : c) corner.normal = face;
    }
    draw_triangle(c, face.dot(p_camera[t[0]]) > 0, raster);
  }
  return resolve(raster, camera.width_px, camera.height_px);
}

ViewAxes guess_axes(const std::vector<Pose>& T_world_camera) {
  Eigen::Vector3d low = Eigen::Vector3d::Zero(), high = low;
  Eigen::Vector3d back = Eigen::Vector3d::Zero(), above = back;  // sums of -z and -y
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();              // of the x axes
  double count = 0;
  for (const Pose& T : T_world_camera) {
    if (!T.finite()) continue;
    low = low.cwiseMin(T.translation());
    high = high.cwiseMax(T.translation());
    const Eigen::Matrix3d R = T.R();
    spread += R.col(0) * R.col(0).transpose();
    above -= R.col(1);
    back -= R.col(2);
    ++count;
  }
  ViewAxes axes;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(spread);
  const Eigen::Vector3d& values = eigen.eigenvalues();  // rising
  // 0.01 is a turn of some 10 degrees to both sides; a tenth keeps rolling cameras out.
  if (count > 2 && values[1] > 0.01 * count && values[0] < 0.1 * values[1]) {
    axes.up = eigen.eigenvectors().col(0);
    // Its sign: where the cameras' tops point, or their backs if they look straight down.
    const double top = axes.up.dot(above), bottom = axes.up.dot(back);
    if ((std::abs(top) > 0.1 * count ? top : bottom) < 0) axes.up = -axes.up;
    Eigen::Vector3d ahead = Eigen::Vector3d::UnitZ();
    if (std::abs(axes.up.z()) > 0.95) ahead = -Eigen::Vector3d::UnitY();
    axes.forward = (ahead - ahead.dot(axes.up) * axes.up).normalized();
    axes.right = axes.forward.cross(axes.up);
    axes.right_name = "right";
    axes.forward_name = "forward";
    axes.up_name = "up";
    return axes;
  }
  const Eigen::Vector3d size = high - low;
  if (size.z() < 0.5 * size.y()) {
    axes.forward = {0, -1, 0};
    axes.up = {0, 0, -1};
    axes.forward_name = "−y";
    axes.up_name = "−z";
  }
  return axes;
}

std::vector<MeshView> outside_views(const TriangleMesh& mesh, const ViewAxes& axes,
                                    const std::vector<Pose>& T_world_camera, int width_px,
                                    int height_px) {
  if (mesh.empty()) return {};
  Eigen::Vector3d low, high;
  for (int i = 0; i < 3; ++i) {
    std::vector<float> values;
    values.reserve(mesh.vertices.size());
    for (const Eigen::Vector3f& v : mesh.vertices) {
      if (v.allFinite()) values.push_back(v[i]);
    }
    if (values.empty()) return {};
    low[i] = quantile(values, 0.02);
    high[i] = quantile(std::move(values), 0.98);
  }
  const Eigen::Vector3d centre = (low + high) / 2;
  const double radius = std::max((high - low).norm() / 2, 1e-9);

  Eigen::Vector3d gaze = Eigen::Vector3d::Zero();
  for (const Pose& T : T_world_camera) gaze += T.R().col(2);
  Eigen::Vector3d ahead = gaze - gaze.dot(axes.up) * axes.up;
  ahead = ahead.norm() > 0.2 * std::max(gaze.norm(), 1e-9) ? Eigen::Vector3d(ahead.normalized())
                                                           : axes.forward;
  Camera camera;
  camera.width_px = width_px;
  camera.height_px = height_px;
  camera.fx_px = camera.fy_px = 1.2 * width_px;
  camera.cx_px = (width_px - 1) / 2.0;
  camera.cy_px = (height_px - 1) / 2.0;
  const double distance =
      radius * std::hypot(1.0, camera.fy_px / (0.5 * std::min(width_px, height_px)));
  std::vector<MeshView> views;
  const auto add = [&](const char* name, double azimuth_rad, double elevation_rad, double closer) {
    const Eigen::Vector3d level = Eigen::AngleAxisd(azimuth_rad, axes.up) * Eigen::Vector3d(-ahead);
    const Eigen::Vector3d to_eye =
        std::cos(elevation_rad) * level + std::sin(elevation_rad) * axes.up;
    views.push_back({name, camera, look_at(centre + closer * distance * to_eye, centre, axes.up)});
  };
  add("From behind and above", 0.45, 0.6, 0.78);
  add("From high above", -0.35, 1.15, 0.78);
  return views;
}

}  // namespace corvid
