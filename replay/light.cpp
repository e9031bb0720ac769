#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "replay/town.h"

namespace corvid {
namespace {
// The shadow plane: across the sun's direction, centred on the town.
constexpr double kTexel_m = 0.3;
constexpr int kShadowSide = 1500;
constexpr double kShadowHalf_m = kTexel_m * kShadowSide / 2;
constexpr int kSkySide = 480;  // 1 m texels
constexpr double kSkyHalf_m = kSkySide / 2;

const Eigen::Vector3d kSun = Eigen::Vector3d(-0.55, -0.5, 0.78).normalized();
const Eigen::Vector3d kAcross = Eigen::Vector3d::UnitZ().cross(kSun).normalized();
const Eigen::Vector3d kAlong = kSun.cross(kAcross);

std::size_t texel(int i, int j, int side) {
  return static_cast<std::size_t>(j) * static_cast<std::size_t>(side) + static_cast<std::size_t>(i);
}
}  // namespace

Eigen::Vector3d Light::to_sun() { return kSun; }

Light::Light(const std::vector<Solid>& solids, const Terrain& terrain) {
  bake_shadow(solids);
  bake_sky(solids, terrain);
}

void Light::bake_shadow(const std::vector<Solid>& solids) {
  constexpr float kNothing = -std::numeric_limits<float>::infinity();
  shadow_.assign(static_cast<std::size_t>(kShadowSide) * kShadowSide, kNothing);
  for (const Solid& solid : solids) {
    const auto range = [&](double middle) {
      const auto to_index = [](double d) {
        return std::clamp(static_cast<int>((d + kShadowHalf_m) / kTexel_m), 0, kShadowSide - 1);
      };
      return std::pair{to_index(middle - solid.radius), to_index(middle + solid.radius)};
    };
    const auto [i0, i1] = range(kAcross.dot(solid.centre));
    const auto [j0, j1] = range(kAlong.dot(solid.centre));
    for (int j = j0; j <= j1; ++j)
      for (int i = i0; i <= i1; ++i) {
        const Eigen::Vector3d foot = kAcross * ((i + 0.5) * kTexel_m - kShadowHalf_m) +
                                     kAlong * ((j + 0.5) * kTexel_m - kShadowHalf_m);
        // The stretch [low, high] of the line foot + s * sun inside the solid.
        double low = -1e9, high = 1e9;
        for (const Face& face : solid.faces) {
          const double slope = face.normal.dot(kSun), room = face.offset - face.normal.dot(foot);
          if (slope > 1e-9) {
            high = std::min(high, room / slope);
          } else if (slope < -1e-9) {
            low = std::max(low, room / slope);
          } else if (room < 0) {
            high = -1e9;
          }
        }
        float& height = shadow_[texel(i, j, kShadowSide)];
        if (low < high) height = std::max(height, static_cast<float>(high));
      }
  }
}

void Light::bake_sky(const std::vector<Solid>& solids, const Terrain& terrain) {
  sky_.assign(static_cast<std::size_t>(kSkySide) * kSkySide, 1.0f);
  for (const Solid& solid : solids) {
    const double reach = solid.radius + 6;
    const auto index = [](double d) {
      return std::clamp(static_cast<int>(d + kSkyHalf_m), 0, kSkySide - 1);
    };
    const double top = solid.centre.z() + 0.7 * solid.radius - solid.ground_z;
    const double strength = 0.5 * std::clamp(top / 6, 0.15, 1.0);
    for (int j = index(solid.centre.y() - reach); j <= index(solid.centre.y() + reach); ++j)
      for (int i = index(solid.centre.x() - reach); i <= index(solid.centre.x() + reach); ++i) {
        const double x = i + 0.5 - kSkyHalf_m, y = j + 0.5 - kSkyHalf_m;
        const Eigen::Vector3d p(x, y, terrain.height(x, y));
        double distance = 0;  // a lower bound of the distance to the solid
        for (const Face& face : solid.faces)
          distance = std::max(distance, face.normal.dot(p) - face.offset);
        sky_[texel(i, j, kSkySide)] *= static_cast<float>(1 - strength * std::exp(-distance / 2.5));
      }
  }
}

float Light::sun(const Eigen::Vector3d& point, const Eigen::Vector3d& normal) const {
  // Moved off its own surface, so that a surface does not shade itself through the texels' size.
  const Eigen::Vector3d p = point + 0.35 * normal + 0.25 * kSun;
  const double a = (kAcross.dot(p) + kShadowHalf_m) / kTexel_m;
  const double b = (kAlong.dot(p) + kShadowHalf_m) / kTexel_m;
  if (a < 1 || b < 1 || a >= kShadowSide - 3 || b >= kShadowSide - 3) return 1;
  const auto height = static_cast<float>(kSun.dot(p));
  const int i = static_cast<int>(a), j = static_cast<int>(b);
  const auto fa = static_cast<float>(a - i), fb = static_cast<float>(b - j);
  // A window of 2 x 2 texels that glides over 3 x 3 comparisons.
  const float weight_a[3] = {1 - fa, 1, fa}, weight_b[3] = {1 - fb, 1, fb};
  float lit = 0;
  for (int v = 0; v < 3; ++v)
    for (int u = 0; u < 3; ++u) {
      const float blocker = shadow_[texel(i + u - 1, j + v - 1, kShadowSide)];
      lit += blocker > height ? 0 : weight_a[u] * weight_b[v];
    }
  return 0.25f * lit;
}

float Light::ground_sky(double x, double y) const {
  const double a = x + kSkyHalf_m - 0.5, b = y + kSkyHalf_m - 0.5;
  if (a < 0 || b < 0 || a >= kSkySide - 1 || b >= kSkySide - 1) return 1;
  const int i = static_cast<int>(a), j = static_cast<int>(b);
  const auto fa = static_cast<float>(a - i), fb = static_cast<float>(b - j);
  const float* row = sky_.data() + texel(i, j, kSkySide);
  const float top = row[0] + fa * (row[1] - row[0]);
  const float bottom = row[kSkySide] + fa * (row[kSkySide + 1] - row[kSkySide]);
  return top + fb * (bottom - top);
}

}  // namespace corvid
