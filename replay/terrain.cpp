#include "replay/terrain.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "replay/random.h"

namespace corvid {

Terrain::Terrain(std::uint64_t seed) {
  Random random(seed);
  struct Wave {
    double kx, ky, phase, amplitude;
  };
  std::array<Wave, 7> waves{};
  for (std::size_t i = 0; i < waves.size(); ++i) {
    const double length = 260.0 / (1 + 0.45 * static_cast<double>(i));
    const double angle = random.uniform(0, 2 * std::numbers::pi);
    const double k = 2 * std::numbers::pi / length;
    waves[i] = {k * std::cos(angle), k * std::sin(angle), random.uniform(0, 6.28), length / 170};
  }
  heights_.resize(static_cast<std::size_t>((kCells + 1) * (kCells + 1)));
  double sum = 0;
  for (int j = 0; j <= kCells; ++j)
    for (int i = 0; i <= kCells; ++i) {
      const double x = i * kCell_m - kHalf_m, y = j * kCell_m - kHalf_m;
      double z = 0;
      for (const Wave& w : waves) z += w.amplitude * std::sin(w.kx * x + w.ky * y + w.phase);
      const double rim = std::max(0.0, std::hypot(x, y) - 240) / 160;
      const double hills = 1 + 0.5 * std::sin(0.021 * x + 1) * std::sin(0.017 * y + 2);
      z = 0.75 * z + 26 * hills * rim * rim * (rim < 1 ? 1 : 1 / (rim * rim));
      heights_[static_cast<std::size_t>(j * (kCells + 1) + i)] = static_cast<float>(z);
      sum += std::hypot(x, y) < 200 ? z : 0;
    }
  const auto mean = static_cast<float>(sum / (std::numbers::pi * 200 * 200 / (kCell_m * kCell_m)));
  inner_max_ = -std::numeric_limits<double>::infinity();
  for (int j = 0; j <= kCells; ++j)
    for (int i = 0; i <= kCells; ++i) {
      float& z = heights_[static_cast<std::size_t>(j * (kCells + 1) + i)];
      z -= mean;
      const double x = i * kCell_m - kHalf_m, y = j * kCell_m - kHalf_m;
      if (std::max(std::abs(x), std::abs(y)) <= kInner_m + kCell_m)
        inner_max_ = std::max(inner_max_, static_cast<double>(z));
    }
  for (int j = 0; j <= kCells; ++j)
    for (int i = 0; i <= kCells; ++i) {
      const int w = std::max(0, i - 1), e = std::min(kCells, i + 1);
      const int o = std::max(0, j - 1), n = std::min(kCells, j + 1);
      const auto span_x = static_cast<float>((e - w) * kCell_m);
      const auto span_y = static_cast<float>((n - o) * kCell_m);
      normals_.push_back(
          Eigen::Vector3f((at(w, j) - at(e, j)) / span_x, (at(i, o) - at(i, n)) / span_y, 1)
              .normalized());
    }
}

double Terrain::height(double x, double y) const {
  const double gx = std::clamp((x + kHalf_m) / kCell_m, 0.0, kCells - 1e-9);
  const double gy = std::clamp((y + kHalf_m) / kCell_m, 0.0, kCells - 1e-9);
  const int i = static_cast<int>(gx), j = static_cast<int>(gy);
  const double fx = gx - i, fy = gy - j;
  const double h00 = at(i, j), h10 = at(i + 1, j), h01 = at(i, j + 1), h11 = at(i + 1, j + 1);
  return fx >= fy ? h00 + fx * (h10 - h00) + fy * (h11 - h10)
                  : h00 + fx * (h11 - h01) + fy * (h01 - h00);
}

Eigen::Vector3f Terrain::smooth_normal(double x, double y) const {
  const double gx = std::clamp((x + kHalf_m) / kCell_m, 0.0, kCells - 1e-9);
  const double gy = std::clamp((y + kHalf_m) / kCell_m, 0.0, kCells - 1e-9);
  const int i = static_cast<int>(gx), j = static_cast<int>(gy);
  const auto fx = static_cast<float>(gx - i), fy = static_cast<float>(gy - j);
  const Eigen::Vector3f* row = normals_.data() + j * (kCells + 1) + i;
  const Eigen::Vector3f low = row[0] + fx * (row[1] - row[0]);
  const Eigen::Vector3f high = row[kCells + 1] + fx * (row[kCells + 2] - row[kCells + 1]);
  return (low + fy * (high - low)).normalized();
}

std::optional<Terrain::Hit> Terrain::intersect(const Eigen::Vector3d& origin,
                                               const Eigen::Vector3d& ray, double t_max) const {
  // In cells: (gx, gy) = g0 + t * d.
  const double gx0 = (origin.x() + kHalf_m) / kCell_m, gy0 = (origin.y() + kHalf_m) / kCell_m;
  const double dx = ray.x() / kCell_m, dy = ray.y() / kCell_m;
  double t = 0, t_end = t_max;
  for (const auto& [g, d] : {std::pair{gx0, dx}, {gy0, dy}}) {
    if (d == 0) {
      if (g <= 0 || g >= kCells) return std::nullopt;
      continue;
    }
    const double a = -g / d, b = (kCells - g) / d;
    t = std::max(t, std::min(a, b));
    t_end = std::min(t_end, std::max(a, b));
  }
  if (t >= t_end) return std::nullopt;
  // Nothing of the inner square is higher than inner_max_: skip the air above it.
  if (ray.z() < 0 && origin.z() > inner_max_) {
    const double t_low = (inner_max_ - origin.z()) / ray.z();
    const auto inner = [&](double s) {
      return std::max(std::abs(origin.x() + s * ray.x()), std::abs(origin.y() + s * ray.y())) <
             kInner_m;
    };
    if (t_low > t && inner(0) && inner(t_low)) t = t_low;
    if (t >= t_end) return std::nullopt;
  }

  int i = std::clamp(static_cast<int>(gx0 + t * dx), 0, kCells - 1);
  int j = std::clamp(static_cast<int>(gy0 + t * dy), 0, kCells - 1);
  const int step_i = dx > 0 ? 1 : -1, step_j = dy > 0 ? 1 : -1;
  constexpr double kNever = std::numeric_limits<double>::infinity();
  const double per_i = dx != 0 ? std::abs(1 / dx) : kNever;
  const double per_j = dy != 0 ? std::abs(1 / dy) : kNever;
  double next_i = dx != 0 ? ((dx > 0 ? i + 1 : i) - gx0) / dx : kNever;
  double next_j = dy != 0 ? ((dy > 0 ? j + 1 : j) - gy0) / dy : kNever;
  while (t < t_end) {
    const double t_out = std::min({next_i, next_j, t_end});
    const double h00 = at(i, j), h10 = at(i + 1, j), h01 = at(i, j + 1), h11 = at(i + 1, j + 1);
    const double fx0 = gx0 - i, fy0 = gy0 - j;
    // The height above a triangle is linear in t: gap = g0 + g1 t.
    const auto meet = [&](bool lower, double from, double to) -> std::optional<Hit> {
      const double sx = lower ? h10 - h00 : h11 - h01, sy = lower ? h11 - h10 : h01 - h00;
      const double g0 = origin.z() - (h00 + sx * fx0 + sy * fy0);
      const double g1 = ray.z() - (sx * dx + sy * dy);
      if (g0 + g1 * to > 0 || g1 >= 0) return std::nullopt;
      return Hit{std::max(from, -g0 / g1), {-sx / kCell_m, -sy / kCell_m, 1}};
    };
    // Which triangle: the sign of fx - fy, which changes at most once on the way.
    const double side = fx0 - fy0 + (dx - dy) * t, side_out = fx0 - fy0 + (dx - dy) * t_out;
    std::optional<Hit> hit;
    if ((side > 0 && side_out < 0) || (side < 0 && side_out > 0)) {
      const double t_cross = t + (t_out - t) * side / (side - side_out);
      hit = meet(side > 0, t, t_cross);
      if (!hit) hit = meet(side < 0, t_cross, t_out);
    } else {
      hit = meet(side + side_out >= 0, t, t_out);
    }
    if (hit) {
      if (hit->t <= 0 || hit->t >= t_max) return std::nullopt;
      return hit;
    }
    t = t_out;
    if (next_i < next_j) {
      i += step_i;
      next_i += per_i;
      if (i < 0 || i >= kCells) break;
    } else {
      j += step_j;
      next_j += per_j;
      if (j < 0 || j >= kCells) break;
    }
  }
  return std::nullopt;
}

void Terrain::append_mesh(TriangleMesh& mesh) const {
  const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
  for (int j = 0; j <= kCells; ++j)
    for (int i = 0; i <= kCells; ++i)
      mesh.vertices.emplace_back(static_cast<float>(i * kCell_m - kHalf_m),
                                 static_cast<float>(j * kCell_m - kHalf_m), at(i, j));
  const auto id = [&](int i, int j) {
    return first + static_cast<std::uint32_t>(j * (kCells + 1) + i);
  };
  for (int j = 0; j < kCells; ++j)
    for (int i = 0; i < kCells; ++i) {
      mesh.triangles.push_back({id(i, j), id(i + 1, j), id(i + 1, j + 1)});
      mesh.triangles.push_back({id(i, j), id(i + 1, j + 1), id(i, j + 1)});
    }
}

}  // namespace corvid
