#include "replay/renderer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <span>

#include "replay/parallel_rows.h"
#include "replay/shading.h"

namespace corvid {
namespace {
constexpr int kTile = 16, kSubTile = 8;
constexpr double kFar_m = 2000;
// Eight rooks: each of the eight columns and rows of the pixel has one sample, so that an edge of
// any direction near the axes is seen in eight steps.
constexpr double kSamples[8][2] = {{-0.4375, 0.0625},  {-0.3125, -0.3125}, {-0.1875, 0.3125},
                                   {-0.0625, -0.0625}, {0.0625, 0.4375},   {0.1875, -0.4375},
                                   {0.3125, 0.1875},   {0.4375, -0.1875}};
}  // namespace

/// One pose, made ready: planes relative to the camera's centre.
struct Renderer::View {
  Eigen::Vector3d centre;
  Eigen::Matrix3d R;
  std::vector<double>
      room;  ///< per plane: offset - normal . centre; negative where the camera sees it
  std::vector<int> solids;  ///< all of them
};

/// What a ray meets. id: -2 no ray, -1 sky, 0 ground, 1 + plane index otherwise.
struct Renderer::Visible {
  int id = -1;
  int solid = -1;
  double depth = 0;
  Eigen::Vector3d ground_normal;
};

Renderer::Renderer(std::shared_ptr<const Town> town, const Camera& camera, int threads)
    : town_(std::move(town)), threads_(threads), rays_(camera.width_px, camera.height_px) {
  parallel_rows(camera.height_px, 16, threads_, [&](int first, int last) {
    for (int y = first; y < last; ++y)
      for (int x = 0; x < camera.width_px; ++x) {
        const auto ray = camera.unproject({x, y});
        const double z = ray ? ray->z() : 0;
        rays_(x, y) = z > 0.02
                          ? Eigen::Vector2d(ray->head<2>() / z)
                          : Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
      }
  });
  for (const Solid& solid : town_->solids) {
    first_plane_.push_back(static_cast<int>(planes_.size()));
    for (const Face& face : solid.faces)
      planes_.emplace_back(face.normal.x(), face.normal.y(), face.normal.z(), face.offset);
  }
  first_plane_.push_back(static_cast<int>(planes_.size()));
}

Renderer::View Renderer::prepare(const Pose& T_world_camera) const {
  View view;
  view.centre = T_world_camera.translation();
  view.R = T_world_camera.R();
  view.room.reserve(planes_.size());
  for (const Eigen::Vector4d& plane : planes_)
    view.room.push_back(plane.w() - plane.head<3>().dot(view.centre));
  view.solids.resize(town_->solids.size());
  std::iota(view.solids.begin(), view.solids.end(), 0);
  return view;
}

/// The solids whose bounding sphere meets the cone about a rectangle of pixels, nearest first.
std::vector<int> Renderer::candidates(const View& view, int x0, int y0, int x1, int y1,
                                      std::span<const int> among) const {
  const auto direction = [&](int x, int y) -> Eigen::Vector3d {
    return (view.R * rays_(x, y).homogeneous()).normalized();
  };
  const Eigen::Vector3d axis = direction((x0 + x1) / 2, (y0 + y1) / 2);
  // The widest ray of a rectangle is on its border.
  double cosine = 1;
  bool all = !axis.allFinite();
  const auto widen = [&](int x, int y) {
    const double c = axis.dot(direction(x, y));
    all = all || !std::isfinite(c);
    cosine = std::min(cosine, c);
  };
  for (int x = x0; x <= x1; ++x)
    for (const int y : {y0, y1}) widen(x, y);
  for (int y = y0; y <= y1; ++y)
    for (const int x : {x0, x1}) widen(x, y);
  double angle = std::acos(std::clamp(cosine, -1.0, 1.0));
  angle += 1.5 * angle / std::max(4, std::min(x1 - x0, y1 - y0));  // the border pixels' own width
  all = all || angle > 1.5;
  const double c = std::cos(angle), s = std::sin(angle);
  std::vector<std::pair<double, int>> found;
  for (const int index : among) {
    const Solid& solid = town_->solids[static_cast<std::size_t>(index)];
    const Eigen::Vector3d to = solid.centre - view.centre;
    const double distance = to.norm();
    if (!all && distance > solid.radius) {
      const double along = to.dot(axis);
      const double off = std::sqrt(std::max(0.0, distance * distance - along * along));
      if (off * c - along * s > solid.radius) continue;
    }
    found.emplace_back(distance - solid.radius, index);
  }
  std::sort(found.begin(), found.end());
  std::vector<int> result;
  result.reserve(found.size());
  for (const auto& entry : found) result.push_back(entry.second);
  return result;
}

Renderer::Visible Renderer::cast(const View& view, const Eigen::Vector3d& ray,
                                 std::span<const int> solids) const {
  Visible visible;
  double best = kFar_m;
  for (const int index : solids) {
    const auto i = static_cast<std::size_t>(index);
    const Eigen::Vector3d to = town_->solids[i].centre - view.centre;
    const double radius = town_->solids[i].radius;
    // The sphere: |to - t ray| <= radius somewhere before best.
    const double along = to.dot(ray), length2 = ray.squaredNorm();
    if ((to.squaredNorm() - radius * radius) * length2 > along * along) continue;
    double in = 0, out = best;
    int face = -1;
    for (int k = first_plane_[i]; k < first_plane_[i + 1]; ++k) {
      const auto kk = static_cast<std::size_t>(k);
      const double room = view.room[kk];
      const double slope =
          planes_[kk].x() * ray.x() + planes_[kk].y() * ray.y() + planes_[kk].z() * ray.z();
      if (room < 0) {  // the camera is outside of this plane: the ray must come in through it
        if (slope >= 0) {
          in = out;
          break;
        }
        const double t = room / slope;
        if (t > in) {
          in = t;
          face = k;
        }
      } else if (slope > 0) {
        out = std::min(out, room / slope);
      }
      if (in >= out) break;
    }
    if (in < out && face >= 0) {
      best = in;
      visible.id = 1 + face;
      visible.solid = index;
    }
  }
  if (const auto ground = town_->terrain.intersect(view.centre, ray, best)) {
    best = ground->t;
    visible.id = 0;
    visible.ground_normal = ground->normal;
  }
  visible.depth = visible.id >= 0 ? best : 0;
  return visible;
}

Eigen::Vector3f Renderer::colour(const View& view, const Visible& visible,
                                 const Eigen::Vector3d& ray, const Eigen::Vector3d& ray_dx,
                                 const Eigen::Vector3d& ray_dy) const {
  if (visible.id < 0) return shade_sky(*town_, ray);
  SurfaceHit hit;
  const Solid* solid = nullptr;
  const Face* face = nullptr;
  if (visible.id == 0) {
    hit.normal = visible.ground_normal.normalized();
  } else {
    const auto s = static_cast<std::size_t>(visible.solid);
    solid = &town_->solids[s];
    face = &solid->faces[static_cast<std::size_t>(visible.id - 1 - first_plane_[s])];
    hit.normal = face->normal;
  }
  hit.point = view.centre + visible.depth * ray;
  // Differentials of a ray that meets a plane (Igehy, SIGGRAPH 1999), held back at grazing angles.
  const double facing = std::min(-1e-3, hit.normal.dot(ray));
  hit.dx = visible.depth * (ray_dx - ray * (hit.normal.dot(ray_dx) / facing));
  hit.dy = visible.depth * (ray_dy - ray * (hit.normal.dot(ray_dy) / facing));
  return solid ? shade_face(*town_, *solid, *face, hit) : shade_ground(*town_, hit);
}

template <class Work>
void Renderer::for_tiles(const View& view, const Work& work) const {
  const int width = rays_.width(), height = rays_.height();
  parallel_rows(height, kTile, threads_, [&](int first, int last) {
    const std::vector<int> band = candidates(view, 0, first, width - 1, last - 1, view.solids);
    for (int x0 = 0; x0 < width; x0 += kTile) {
      const int x1 = std::min(width, x0 + kTile);
      const std::vector<int> tile = candidates(view, x0, first, x1 - 1, last - 1, band);
      for (int sub_y = first; sub_y < last; sub_y += kSubTile)
        for (int sub_x = x0; sub_x < x1; sub_x += kSubTile) {
          const int end_x = std::min(x1, sub_x + kSubTile),
                    end_y = std::min(last, sub_y + kSubTile);
          const std::vector<int> near = candidates(view, sub_x, sub_y, end_x - 1, end_y - 1, tile);
          for (int y = sub_y; y < end_y; ++y)
            for (int x = sub_x; x < end_x; ++x) work(x, y, std::span<const int>(near));
        }
    }
  });
}

FloatImage Renderer::depth(const Pose& T_world_camera) const {
  const View view = prepare(T_world_camera);
  FloatImage depth(rays_.width(), rays_.height());
  for_tiles(view, [&](int x, int y, std::span<const int> solids) {
    const Eigen::Vector3d ray = view.R * rays_(x, y).homogeneous();
    if (ray.allFinite()) depth(x, y) = static_cast<float>(cast(view, ray, solids).depth);
  });
  return depth;
}

RadianceImage Renderer::render(const Pose& T_world_camera) const {
  const View view = prepare(T_world_camera);
  const int width = rays_.width(), height = rays_.height();
  RadianceImage image(width, height);
  Image<int> ids(width, height, -2);
  const auto ray_at = [&](int x, int y) -> Eigen::Vector3d {
    return view.R * rays_(x, y).homogeneous();
  };
  // Movement of the ray per pixel, by central differences.
  const auto ray_steps = [&](int x, int y) {
    const int xa = std::max(0, x - 1), xb = std::min(width - 1, x + 1);
    const int ya = std::max(0, y - 1), yb = std::min(height - 1, y + 1);
    const Eigen::Vector2d dx = (rays_(xb, y) - rays_(xa, y)) / std::max(1, xb - xa);
    const Eigen::Vector2d dy = (rays_(x, yb) - rays_(x, ya)) / std::max(1, yb - ya);
    return std::pair<Eigen::Vector3d, Eigen::Vector3d>{view.R.leftCols<2>() * dx,
                                                       view.R.leftCols<2>() * dy};
  };
  for_tiles(view, [&](int x, int y, std::span<const int> solids) {
    const Eigen::Vector3d ray = ray_at(x, y);
    if (!ray.allFinite()) return;
    const Visible visible = cast(view, ray, solids);
    ids(x, y) = visible.id;
    const auto [dx, dy] = ray_steps(x, y);
    const Eigen::Vector3f c = colour(view, visible, ray, dx, dy);
    image(x, y) = {c.x(), c.y(), c.z()};
  });
  for_tiles(view, [&](int x, int y, std::span<const int> solids) {
    const int id = ids(x, y);
    const auto same = [&](int ox, int oy) {
      const int nx = x + ox, ny = y + oy;
      return nx < 0 || ny < 0 || nx >= width || ny >= height || ids(nx, ny) == id;
    };
    if (id == -2 || (same(-1, 0) && same(1, 0) && same(0, -1) && same(0, 1))) return;
    const auto [dx, dy] = ray_steps(x, y);
    if (!dx.allFinite() || !dy.allFinite()) return;
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    for (const auto& sample : kSamples) {
      const Eigen::Vector3d ray = ray_at(x, y) + sample[0] * dx + sample[1] * dy;
      sum += colour(view, cast(view, ray, solids), ray, dx, dy);
    }
    sum /= static_cast<float>(std::size(kSamples));
    image(x, y) = {sum.x(), sum.y(), sum.z()};
  });
  return image;
}

}  // namespace corvid
