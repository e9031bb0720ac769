#include "replay/shading.h"

#include <algorithm>
#include <cmath>

#include "replay/random.h"

namespace corvid {
namespace {
using Colour = Eigen::Vector3f;

Colour mix(const Colour& a, const Colour& b, float share) { return a + share * (b - a); }

double floor_of(double x) {
  const double i = static_cast<double>(static_cast<std::int64_t>(x));
  return x < i ? i - 1 : i;
}
float smooth_step(float x, float low, float high) {
  const float t = std::clamp((x - low) / (high - low), 0.0f, 1.0f);
  return t * t * (3 - 2 * t);
}

/// Share of a footprint of width w about x that lies in [a, b].
float box(double x, float w, double a, double b) {
  const double half = 0.5 * static_cast<double>(w) + 1e-4;
  return static_cast<float>(std::max(0.0, std::min(x + half, b) - std::max(x - half, a)) /
                            (2 * half));
}
/// The same for the train of stretches [a, b] + k * period, 0 <= a < b <= period.
float pulse(double x, float w, double period, double a, double b) {
  const double half = 0.5 * static_cast<double>(w) + 1e-4;
  const auto covered = [&](double s) {  // length of stretches in [0, s]
    const double k = floor_of(s / period);
    return k * (b - a) + std::clamp(s - k * period - a, 0.0, b - a);
  };
  return static_cast<float>((covered(x + half) - covered(x - half)) / (2 * half));
}

SurfacePoint scaled(SurfacePoint p, float su, float sv) {
  p.u *= static_cast<double>(su);
  p.ux *= su;
  p.uy *= su;
  p.v *= static_cast<double>(sv);
  p.vx *= sv;
  p.vy *= sv;
  return p;
}

/// Sun and sky on a Lambertian surface.
Colour lit(const Town& town, const Colour& albedo, const SurfaceHit& hit,
           const Eigen::Vector3f& normal, float sky_share) {
  static const Colour kSunlight(1.18f, 1.08f, 0.90f), kSkylight(0.36f, 0.42f, 0.52f),
      kBounce(0.16f, 0.14f, 0.11f);
  const float facing = normal.dot(Light::to_sun().cast<float>());
  const float sun = facing > 0 ? facing * town.light.sun(hit.point, hit.normal) : 0;
  const float up = 0.5f + 0.5f * normal.z();
  const Colour light = sun * kSunlight + sky_share * (up * kSkylight + (1 - up) * kBounce);
  return albedo.cwiseProduct(light);
}

/// Walls with their grids of identical windows.
Colour facade(const Town& town, const Face& face, const SurfacePoint& p) {
  const Style& s = face.style;
  const float wu = p.width_u(), wv = p.width_v();
  const float stain = town.clouds.sample(p, 0.05f), grain = town.leaves.sample(p, 0.03f);
  Colour colour = s.colour * (0.72f + 0.35f * stain + 0.22f * grain);

  const double pitch = static_cast<double>(s.window_pitch_m);
  const double floor_m = static_cast<double>(s.floor_height_m);
  const double width = static_cast<double>(face.width_m);
  const double half = 0.5 * static_cast<double>(s.window_width_m);
  const double sill = 0.95, lintel = sill + static_cast<double>(s.window_height_m);
  const int columns = static_cast<int>((width - 0.8) / pitch);
  const int floors = static_cast<int>((static_cast<double>(face.height_m) + 0.2) / floor_m);
  const double margin = 0.5 * (width - columns * pitch);
  const float field = box(p.u, wu, margin, width - margin) * box(p.v, wv, 0, floors * floor_m);
  const double x = p.u - margin;

  const Colour stone(0.30f, 0.28f, 0.26f), glass(0.035f, 0.05f, 0.065f);
  colour = mix(colour, 0.8f * colour, box(p.v, wv, -50, 1e6) * pulse(p.v, wv, floor_m, 0, 0.14));
  colour = mix(colour, stone * (0.7f + 0.6f * grain), box(p.v, wv, -50, 0.55));
  if (field > 0) {
    const float across = pulse(x, wu, pitch, pitch / 2 - half - 0.12, pitch / 2 + half + 0.12);
    const float frame = across * pulse(p.v, wv, floor_m, sill - 0.1, lintel + 0.12);
    const float ledge = pulse(x, wu, pitch, pitch / 2 - half - 0.22, pitch / 2 + half + 0.22) *
                        pulse(p.v, wv, floor_m, sill - 0.24, sill - 0.1);
    const float panes = (pulse(x, wu, pitch, pitch / 2 - half, pitch / 2 - 0.035) +
                         pulse(x, wu, pitch, pitch / 2 + 0.035, pitch / 2 + half)) *
                        (pulse(p.v, wv, floor_m, sill, sill + 0.62 * (lintel - sill) - 0.03) +
                         pulse(p.v, wv, floor_m, sill + 0.62 * (lintel - sill) + 0.03, lintel));
    colour = mix(colour, 0.55f * colour, field * ledge);
    colour = mix(colour, s.trim, field * frame);
    colour = mix(colour, glass, field * panes);
  }
  if (width > 5) {  // a door in the middle
    const float door = box(p.u, wu, width / 2 - 0.72, width / 2 + 0.72) * box(p.v, wv, -1, 2.35);
    const float leaf = box(p.u, wu, width / 2 - 0.55, width / 2 + 0.55) * box(p.v, wv, -1, 2.15);
    colour = mix(colour, s.trim, door);
    colour = mix(colour, Colour(0.16f, 0.09f, 0.06f), leaf);
  }
  return colour;
}

Colour face_albedo(const Town& town, const Face& face, const SurfacePoint& p) {
  const Colour& base = face.style.colour;
  switch (face.style.material) {
    case Material::facade:
      return facade(town, face, p);
    case Material::plaster:
      return base *
             (0.6f + 0.45f * town.clouds.sample(p, 0.04f) + 0.4f * town.leaves.sample(p, 0.035f));
    case Material::roof_tile: {
      const float wu = p.width_u(), wv = p.width_v();
      const float rows = pulse(p.v, wv, 0.36, 0, 0.1), columns = pulse(p.u, wu, 0.3, 0, 0.06);
      const float patch = town.leaves.sample(scaled(p, 1, 0.8f), 0.11f);
      const float moss = town.clouds.sample(p, 0.07f);
      const Colour tile = base * (0.35f + 0.75f * patch + 0.55f * moss);
      return tile * (1 - 0.5f * rows) * (1 - 0.3f * columns);
    }
    case Material::gravel:
      return base *
             (0.35f + 0.7f * town.leaves.sample(p, 0.045f) + 0.6f * town.clouds.sample(p, 0.1f));
    case Material::foliage: {
      const float leaf = town.leaves.sample(p, 0.055f), clump = town.clouds.sample(p, 0.03f);
      return base * std::max(0.15f, -0.55f + 1.7f * leaf + 1.4f * clump);
    }
    case Material::bark:
      return base * (0.5f + town.leaves.sample(p, 0.02f));
    case Material::paint:
      return base;
    case Material::smooth:
      return base * (0.97f + 0.06f * town.clouds.sample(p, 0.2f));
  }
  return base;
}

/// Asphalt, kerbs, markings and what lies between the streets.
Colour town_ground(const Town& town, const Eigen::Vector2d& plan, const SurfacePoint& p,
                   float grain, float stain, float broad) {
  constexpr double kBlock = TownPlan::kBlock_m, kHalf = TownPlan::kHalf_m;
  const float w = 0.5f * (p.width_u() + p.width_v());
  const auto street = [&](double s, double half) {  // distance from a street's middle line
    return pulse(s + half, w, kBlock, 0, 2 * half);
  };
  const float road_x = street(plan.x(), TownPlan::kRoadHalf_m);
  const float road_y = street(plan.y(), TownPlan::kRoadHalf_m);
  const float walk_x = street(plan.x(), TownPlan::kStreetHalf_m);
  const float walk_y = street(plan.y(), TownPlan::kStreetHalf_m);
  const float road = 1 - (1 - road_x) * (1 - road_y);
  const float walk = 1 - (1 - walk_x) * (1 - walk_y);

  Colour colour = Colour::Zero();
  if (walk < 1) {
    const int i =
        std::clamp(static_cast<int>((plan.x() + kHalf) / kBlock), 0, TownPlan::kBlocks - 1);
    const int j =
        std::clamp(static_cast<int>((plan.y() + kHalf) / kBlock), 0, TownPlan::kBlocks - 1);
    const BlockKind kind = town.plan.kind(i, j);
    const auto tint =
        static_cast<float>(mix64(static_cast<std::uint64_t>(i * 64 + j)) & 255) / 255.0f;
    const Colour grass = mix(Colour(0.11f, 0.17f, 0.05f), Colour(0.20f, 0.21f, 0.08f),
                             std::clamp(0.4f * tint + 1.2f * (broad - 0.3f), 0.0f, 1.0f));
    const Colour soil(0.24f, 0.18f, 0.12f), paving(0.40f, 0.38f, 0.35f);
    const Colour lawn = grass * (0.35f + 0.7f * stain + 0.6f * grain);
    const Colour yard =
        (kind == BlockKind::square || kind == BlockKind::apartments ? paving : soil) *
        (0.45f + 0.35f * stain + 0.75f * grain);
    const float green = kind == BlockKind::park     ? smooth_step(stain + broad, 0.62f, 0.72f)
                        : kind == BlockKind::houses ? smooth_step(stain + 0.5f * broad, 0.62f, 0.7f)
                                                    : smooth_step(stain, 0.68f, 0.74f);
    colour = mix(yard, lawn, green);
    if (kind == BlockKind::square || kind == BlockKind::apartments) {
      const float joints =
          1 - (1 - pulse(plan.x(), w, 1.6, 0, 0.09)) * (1 - pulse(plan.y(), w, 1.6, 0, 0.09));
      colour *= 1 - 0.35f * joints * (1 - green);
    }
  }
  if (walk > 0) {
    const float slabs =
        1 - (1 - pulse(plan.x(), w, 0.9, 0, 0.06)) * (1 - pulse(plan.y(), w, 0.9, 0, 0.06));
    const Colour pavement =
        Colour(0.42f, 0.40f, 0.38f) * (0.6f + 0.35f * stain + 0.45f * grain) * (1 - 0.3f * slabs);
    colour = mix(colour, pavement, walk);
  }
  if (road > 0) {
    const float patch = smooth_step(broad, 0.56f, 0.6f);
    Colour asphalt = mix(Colour(0.125f, 0.125f, 0.13f), Colour(0.075f, 0.075f, 0.08f), patch) *
                     (0.45f + 0.5f * stain + 0.65f * grain);
    const float crossing = road_x * road_y;
    const Colour white(0.62f, 0.62f, 0.60f);
    const auto markings = [&](double along, double across, float on) {
      const double d = along - kBlock * floor_of(along / kBlock + 0.5);  // from the crossing
      const float away = box(std::abs(d), w, 9, 1e6);
      const float line = street(across, 0.08) * pulse(along, w, 4, 0, 2) * away;
      const float zebra = box(std::abs(d), w, 5, 7.6) * pulse(across, w, 1.0, 0, 0.5);
      asphalt = mix(asphalt, white, 0.85f * on * (1 - crossing) * std::min(1.0f, line + zebra));
    };
    if (road_x > 0) markings(plan.y(), plan.x(), road_x);
    if (road_y > 0) markings(plan.x(), plan.y(), road_y);
    colour = mix(colour, asphalt, road);
  }
  return colour;
}

/// Fields with crop rows, parted by paths.
Colour field_ground(const SurfacePoint& p, float grain, float stain, float broad) {
  constexpr double kLong = 74, kWide = 52;
  const float wu = p.width_u(), wv = p.width_v();
  const double row = floor_of(p.v / kWide);
  const double u = p.u + 31 * row;
  const double column = floor_of(u / kLong);
  const std::uint64_t hash = mix64(static_cast<std::uint64_t>(
      static_cast<std::int64_t>(row) * 7919 + static_cast<std::int64_t>(column)));
  const std::array<Colour, 5> crops = {Colour{0.30f, 0.25f, 0.11f},
                                       {0.13f, 0.19f, 0.06f},
                                       {0.23f, 0.16f, 0.10f},
                                       {0.20f, 0.23f, 0.08f},
                                       {0.10f, 0.14f, 0.05f}};
  Colour colour = crops[hash % crops.size()] * (0.3f + 0.5f * stain + 0.5f * grain + 0.4f * broad);
  const double period = 1.2 + 0.25 * static_cast<double>((hash >> 8) % 8);
  const float furrow =
      hash & 64 ? pulse(p.u, wu, period, 0, 0.4 * period) : pulse(p.v, wv, period, 0, 0.4 * period);
  colour *= 1 - 0.4f * furrow;
  const float path =
      1 - (1 - pulse(u + 1.1, wu, kLong, 0, 2.2)) * (1 - pulse(p.v + 1.1, wv, kWide, 0, 2.2));
  return mix(colour, Colour(0.34f, 0.28f, 0.20f) * (0.5f + 0.4f * stain + 0.6f * grain), path);
}
}  // namespace

Eigen::Vector3f shade_ground(const Town& town, const SurfaceHit& hit) {
  SurfacePoint p;
  p.u = hit.point.x();
  p.v = hit.point.y();
  p.ux = static_cast<float>(hit.dx.x());
  p.vx = static_cast<float>(hit.dx.y());
  p.uy = static_cast<float>(hit.dy.x());
  p.vy = static_cast<float>(hit.dy.y());
  const float grain = town.leaves.sample(p, 0.045f);
  const float stain = 0.5f * (town.clouds.sample(p, 0.16f) + town.leaves.sample(p, 0.23f));
  const float broad = town.clouds.sample(p, 1.1f);
  const Eigen::Vector2d plan = town.plan.to_plan(p.u, p.v);
  constexpr double kEdge = TownPlan::kHalf_m + TownPlan::kStreetHalf_m;
  const float w = 0.5f * (p.width_u() + p.width_v());
  const float inside = box(plan.x(), w, -kEdge, kEdge) * box(plan.y(), w, -kEdge, kEdge);
  Colour colour = Colour::Zero();
  if (inside > 0) colour += inside * town_ground(town, plan, p, grain, stain, broad);
  if (inside < 1) colour += (1 - inside) * field_ground(p, grain, stain, broad);
  return lit(town, colour, hit, town.terrain.smooth_normal(p.u, p.v),
             town.light.ground_sky(p.u, p.v));
}

Eigen::Vector3f shade_face(const Town& town, const Solid& solid, const Face& face,
                           const SurfaceHit& hit) {
  SurfacePoint p;
  p.u = face.u_axis.dot(hit.point) - face.u0;
  p.v = face.v_axis.dot(hit.point) - face.v0;
  p.ux = static_cast<float>(face.u_axis.dot(hit.dx));
  p.vx = static_cast<float>(face.v_axis.dot(hit.dx));
  p.uy = static_cast<float>(face.u_axis.dot(hit.dy));
  p.vy = static_cast<float>(face.v_axis.dot(hit.dy));
  const Colour albedo = face_albedo(town, face, p);
  Eigen::Vector3f normal = face.normal.cast<float>();
  if (solid.round && std::abs(normal.z()) < 0.99f) {
    const Eigen::Vector2d out = (hit.point - solid.centre).head<2>().normalized();
    const float flat = std::sqrt(std::max(0.0f, 1 - normal.z() * normal.z()));
    normal.head<2>() = flat * out.cast<float>();
  }
  const auto above = static_cast<float>(hit.point.z() - solid.ground_z);
  const float sky = 0.62f + 0.38f * std::clamp(above / 5, 0.0f, 1.0f);
  return lit(town, albedo, hit, normal, face.style.material == Material::foliage ? 0.85f : sky);
}

Eigen::Vector3f shade_sky(const Town& town, const Eigen::Vector3d& ray) {
  const Eigen::Vector3d d = ray.normalized();
  const auto up = static_cast<float>(std::max(0.0, d.z()));
  const Colour clear =
      mix(Colour(0.72f, 0.78f, 0.84f), Colour(0.25f, 0.42f, 0.72f), std::min(1.0f, 1.6f * up));
  SurfacePoint p;  // clouds on a plane far above
  p.u = d.x() / (0.15 + static_cast<double>(up));
  p.v = d.y() / (0.15 + static_cast<double>(up));
  p.ux = p.vy = 0.002f / (0.15f + up);
  const float cloud = smooth_step(town.clouds.sample(p, 0.006f), 0.5f, 0.75f);
  return mix(clear, Colour(0.9f, 0.9f, 0.9f), 0.8f * cloud);
}

}  // namespace corvid
