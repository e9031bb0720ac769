#include "replay/renderer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <span>

#include "core/parallel_rows.h"
#include "replay/shading.h"

namespace corvid {
namespace {
constexpr int kTile = 16, kSubTile = 8;
constexpr double kFar_m = 2000;
constexpr double kNoAngle = std::numeric_limits<double>::quiet_NaN();
constexpr int kNoRay = -2, kSky = -1, kGround = 0;
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
  struct Ball {
    Eigen::Vector3d to;  ///< from the camera's centre to the solid's
    double distance, radius;
  };
  std::vector<Ball> balls;  ///< one per solid
  std::vector<int> solids;  ///< all of them
};

/// What a ray meets.
struct Renderer::Visible {
  int id = kSky;  ///< kSky, kGround, or 1 + the plane's index
  int solid = -1;
  double depth = 0;
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  ///< of the plane that was met, unit
  double room = 0;                                   ///< normal . (point - centre)
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
    solid_of_.resize(planes_.size(), static_cast<int>(first_plane_.size()) - 1);
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
  view.balls.reserve(town_->solids.size());
  for (const Solid& solid : town_->solids) {
    const Eigen::Vector3d to = solid.centre - view.centre;
    view.balls.push_back({to, to.norm(), solid.radius});
  }
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
  double cosine = 1;  // of the widest ray, which is at a corner
  for (const int x : {x0, x1})
    for (const int y : {y0, y1}) {
      const double c = axis.dot(direction(x, y));
      cosine = std::isfinite(c) && std::isfinite(cosine) ? std::min(cosine, c) : kNoAngle;
    }
  double angle = std::acos(std::clamp(cosine, -1.0, 1.0));
  angle += 1.5 * angle / std::max(4, std::min(x1 - x0, y1 - y0));  // the border pixels' own width
  const bool all = !std::isfinite(angle) || angle > 1.5;
  const double c = std::cos(angle), s = std::sin(angle);
  std::vector<std::pair<double, int>> found;
  for (const int index : among) {
    const View::Ball& ball = view.balls[static_cast<std::size_t>(index)];
    if (!all && ball.distance > ball.radius) {
      const double along = ball.to.dot(axis);
      const double off = std::sqrt(std::max(0.0, ball.distance * ball.distance - along * along));
      if (off * c - along * s > ball.radius) continue;
    }
    found.emplace_back(ball.distance - ball.radius, index);
  }
  std::sort(found.begin(), found.end());
  std::vector<int> result;
  result.reserve(found.size());
  for (const auto& entry : found) result.push_back(entry.second);
  return result;
}

/// The first thing that a ray meets among the solids (nearest first) and, if asked for or if it is
/// none of them, the ground.
Renderer::Visible Renderer::cast(const View& view, const Eigen::Vector3d& ray,
                                 std::span<const int> solids, bool ground) const {
  Visible visible;
  double best = kFar_m;
  const double length = ray.norm();
  for (const int index : solids) {
    const auto i = static_cast<std::size_t>(index);
    const View::Ball& ball = view.balls[i];
    if (ball.distance - ball.radius > best * length) break;  // and all that follow
    const double along = ball.to.dot(ray);
    const double gap2 = ball.distance * ball.distance - ball.radius * ball.radius;
    if (gap2 > 0 && (along < 0 || gap2 * length * length > along * along)) continue;
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
  std::optional<Terrain::Hit> hit;
  if (ground || visible.id == kSky) hit = town_->terrain.intersect(view.centre, ray, best);
  if (hit) {
    best = hit->t;
    visible.id = kGround;
    visible.normal = hit->normal.normalized();
    visible.room = best * visible.normal.dot(ray);
  } else if (visible.id > kGround) {
    const auto k = static_cast<std::size_t>(visible.id - 1);
    visible.normal = planes_[k].head<3>();
    visible.room = view.room[k];
  }
  visible.depth = visible.id >= kGround ? best : 0;
  return visible;
}

/// Light along a ray that meets the visible plane; it may be another ray than the one that found
/// it.
Eigen::Vector3f Renderer::colour(const View& view, const Visible& visible,
                                 const Eigen::Vector3d& ray, const Eigen::Vector3d& ray_dx,
                                 const Eigen::Vector3d& ray_dy) const {
  if (visible.id < kGround) return shade_sky(*town_, ray);
  // Differentials of a ray that meets a plane (Igehy, SIGGRAPH 1999), held back at grazing angles.
  const Eigen::Vector3d& normal = visible.normal;
  const double facing = std::min(-1e-3, normal.dot(ray));
  const double t = std::clamp(visible.room / facing, 0.5 * visible.depth, 2 * visible.depth);
  SurfaceHit hit;
  hit.normal = normal;
  hit.point = view.centre + t * ray;
  hit.dx = t * (ray_dx - ray * (normal.dot(ray_dx) / facing));
  hit.dy = t * (ray_dy - ray * (normal.dot(ray_dy) / facing));
  if (visible.id == kGround) return shade_ground(*town_, hit);
  const auto s = static_cast<std::size_t>(visible.solid);
  const Solid& solid = town_->solids[s];
  const auto face = static_cast<std::size_t>(visible.id - 1 - first_plane_[s]);
  return shade_face(*town_, solid, solid.faces[face], hit);
}

/// Calls work(x, y, solids) for every pixel that has a ray, with all solids that its ray can meet.
template <class Work>
void Renderer::for_pixels(const View& view, const Work& work) const {
  const int width = rays_.width(), height = rays_.height();
  parallel_rows(height, kTile, threads_, [&](int first, int last) {
    const std::vector<int> band = candidates(view, 0, first, width - 1, last - 1, view.solids);
    for (int x0 = 0; x0 < width; x0 += kTile) {
      const int x1 = std::min(width, x0 + kTile);
      const std::vector<int> tile = candidates(view, x0, first, x1 - 1, last - 1, band);
      for (int sub_y = first; sub_y < last; sub_y += kSubTile)
        for (int sub_x = x0; sub_x < x1; sub_x += kSubTile) {
          const int end_x = std::min(x1, sub_x + kSubTile);
          const int end_y = std::min(last, sub_y + kSubTile);
          const std::vector<int> near = candidates(view, sub_x, sub_y, end_x - 1, end_y - 1, tile);
          for (int y = sub_y; y < end_y; ++y)
            for (int x = sub_x; x < end_x; ++x)
              if (rays_(x, y).allFinite()) work(x, y, std::span<const int>(near));
        }
    }
  });
}

FloatImage Renderer::depth(const Pose& T_world_camera) const {
  const View view = prepare(T_world_camera);
  FloatImage depth(rays_.width(), rays_.height());
  for_pixels(view, [&](int x, int y, std::span<const int> solids) {
    const Eigen::Vector3d ray = view.R * rays_(x, y).homogeneous();
    depth(x, y) = static_cast<float>(cast(view, ray, solids).depth);
  });
  return depth;
}

RadianceImage Renderer::render(const Pose& T_world_camera) const {
  const View view = prepare(T_world_camera);
  const int width = rays_.width(), height = rays_.height();
  RadianceImage image(width, height);
  Image<int> ids(width, height, kNoRay);
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
  for_pixels(view, [&](int x, int y, std::span<const int> solids) {
    const Eigen::Vector3d ray = ray_at(x, y);
    const Visible visible = cast(view, ray, solids);
    ids(x, y) = visible.id;
    const auto [dx, dy] = ray_steps(x, y);
    const Eigen::Vector3f c = colour(view, visible, ray, dx, dy);
    image(x, y) = {c.x(), c.y(), c.z()};
  });
  // Where surfaces meet, eight rays find their shares, among what the pixel and its neighbours
  // see; each surface is shaded once, in the middle of its share.
  const auto mix_surfaces = [&](int x, int y) {
    const int id = ids(x, y);
    if (id == kNoRay) return;
    std::array<int, 9> solids{};
    std::size_t count = 0;
    bool edge = false, ground = false;
    for (int ny = std::max(0, y - 1); ny <= std::min(height - 1, y + 1); ++ny)
      for (int nx = std::max(0, x - 1); nx <= std::min(width - 1, x + 1); ++nx) {
        const int other = ids(nx, ny);
        edge = edge || (other != id && (nx == x || ny == y));
        ground = ground || other == kGround;
        if (other <= kGround) continue;
        const int solid = solid_of_[static_cast<std::size_t>(other - 1)];
        const auto end = solids.begin() + static_cast<std::ptrdiff_t>(count);
        if (std::find(solids.begin(), end, solid) == end) solids[count++] = solid;
      }
    if (!edge) return;
    const auto near = [&](int solid) {
      const View::Ball& ball = view.balls[static_cast<std::size_t>(solid)];
      return ball.distance - ball.radius;
    };
    std::sort(solids.begin(), solids.begin() + static_cast<std::ptrdiff_t>(count),
              [&](int a, int b) { return near(a) < near(b) || (near(a) == near(b) && a < b); });
    const auto [dx, dy] = ray_steps(x, y);
    if (!dx.allFinite() || !dy.allFinite()) return;
    struct Share {
      Visible visible;
      Eigen::Vector2d shift = Eigen::Vector2d::Zero();
      int samples = 0;
    };
    std::array<Share, std::size(kSamples)> shares;
    std::size_t found = 0;
    for (const auto& sample : kSamples) {
      const Visible visible = cast(view, ray_at(x, y) + sample[0] * dx + sample[1] * dy,
                                   {solids.data(), count}, ground);
      std::size_t i = 0;
      while (i < found && shares[i].visible.id != visible.id) ++i;
      if (i == found) shares[found++].visible = visible;
      shares[i].shift += Eigen::Vector2d(sample[0], sample[1]);
      ++shares[i].samples;
    }
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    for (std::size_t i = 0; i < found; ++i) {
      Share& share = shares[i];
      const Eigen::Vector2d shift = share.shift / share.samples;
      const Eigen::Vector3d ray = ray_at(x, y) + shift.x() * dx + shift.y() * dy;
      sum += static_cast<float>(share.samples) * colour(view, share.visible, ray, dx, dy);
    }
    sum /= static_cast<float>(std::size(kSamples));
    image(x, y) = {sum.x(), sum.y(), sum.z()};
  };
  parallel_rows(height, kTile, threads_, [&](int first, int last) {
    for (int y = first; y < last; ++y)
      for (int x = 0; x < width; ++x) mix_surfaces(x, y);
  });
  return image;
}

}  // namespace corvid
