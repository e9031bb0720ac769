#include "replay/tile_texture.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>

#include "replay/random.h"

namespace corvid {
namespace {
constexpr int kLevels = 10;  // 512 to 1

int wrap(int i) { return i & (TileTexture::kSide - 1); }

/// Stretches to mean 0.5 and standard deviation 0.2.
void normalise(std::vector<float>& values) {
  const double n = static_cast<double>(values.size());
  const double mean = std::accumulate(values.begin(), values.end(), 0.0) / n;
  double variance = 0;
  for (const float v : values) variance += (v - mean) * (v - mean);
  const double scale = 0.2 / std::sqrt(variance / n);
  for (float& v : values) v = static_cast<float>(std::clamp(0.5 + (v - mean) * scale, 0.0, 1.0));
}

std::size_t at(int x, int y) {
  return static_cast<std::size_t>(wrap(y)) * TileTexture::kSide + static_cast<std::size_t>(wrap(x));
}

/// log2 by the float's bits: continuous, rising, exact at powers of two, enough to blend levels.
float rough_log2(float x) {
  return static_cast<float>(std::bit_cast<std::int32_t>(x)) * 0x1p-23f - 127.0f;
}

double floor_of(double x) {
  const double i = static_cast<double>(static_cast<std::int64_t>(x));
  return x < i ? i - 1 : i;
}
}  // namespace

float SurfacePoint::width_u() const { return std::sqrt(ux * ux + uy * uy); }
float SurfacePoint::width_v() const { return std::sqrt(vx * vx + vy * vy); }

TileTexture::TileTexture(std::vector<float> finest) {
  normalise(finest);
  int side = kSide;
  for (int level = 0; level < kLevels; ++level) {
    std::vector<std::uint8_t> bytes(finest.size());
    std::transform(finest.begin(), finest.end(), bytes.begin(),
                   [](float v) { return static_cast<std::uint8_t>(std::lround(v * 255)); });
    levels_.push_back(std::move(bytes));
    const int half = side / 2;
    std::vector<float> coarser(static_cast<std::size_t>(half) * static_cast<std::size_t>(half));
    for (int y = 0; y < half; ++y)
      for (int x = 0; x < half; ++x) {
        const auto i = static_cast<std::size_t>(2 * y * side + 2 * x);
        const auto s = static_cast<std::size_t>(side);
        coarser[static_cast<std::size_t>(y * half + x)] =
            0.25f * (finest[i] + finest[i + 1] + finest[i + s] + finest[i + s + 1]);
      }
    finest = std::move(coarser);
    side = half;
  }
}

TileTexture TileTexture::clouds(std::uint64_t seed) {
  std::vector<float> sum(static_cast<std::size_t>(kSide) * kSide, 0);
  for (int octave = 0; octave < 7; ++octave) {
    const int cells = 4 << octave;
    const int cell = kSide / cells;
    const float amplitude = std::pow(0.62f, static_cast<float>(octave));
    const auto lattice = [&](int i, int j) {
      const auto key = static_cast<std::uint64_t>((octave * 4096 + (j % cells)) * 4096 + i % cells);
      return static_cast<float>(mix64(seed ^ mix64(key)) >> 40) * 0x1p-24f;
    };
    const auto smooth = [](float t) { return t * t * (3 - 2 * t); };
    for (int y = 0; y < kSide; ++y)
      for (int x = 0; x < kSide; ++x) {
        const int i = x / cell, j = y / cell;
        const float fx = smooth(static_cast<float>(x % cell) / static_cast<float>(cell));
        const float fy = smooth(static_cast<float>(y % cell) / static_cast<float>(cell));
        sum[at(x, y)] +=
            amplitude * std::lerp(std::lerp(lattice(i, j), lattice(i + 1, j), fx),
                                  std::lerp(lattice(i, j + 1), lattice(i + 1, j + 1), fx), fy);
      }
  }
  return TileTexture(std::move(sum));
}

TileTexture TileTexture::leaves(std::uint64_t seed) {
  std::vector<float> image(static_cast<std::size_t>(kSide) * kSide, 0.5f);
  Random random(seed);
  for (int n = 0; n < 9000; ++n) {
    // Radii with density r^-3 between 1.5 and 60 texels; large ones fall first so that the small
    // ones are not buried.
    const double share = n / 9000.0;
    const double radius = 1.5 / std::sqrt(1 - (1 - share) * (1 - 1.5 * 1.5 / (60.0 * 60.0)));
    const double cx = random.uniform(0, kSide), cy = random.uniform(0, kSide);
    const double angle = random.uniform(0, 3.2), ca = std::cos(angle), sa = std::sin(angle);
    const bool square = random.uniform() < 0.5;
    const double stretch = random.uniform(0.5, 1);
    const auto value = static_cast<float>(random.uniform());
    const int reach = static_cast<int>(radius * 1.5) + 2;
    for (int y = static_cast<int>(cy) - reach; y <= static_cast<int>(cy) + reach; ++y)
      for (int x = static_cast<int>(cx) - reach; x <= static_cast<int>(cx) + reach; ++x) {
        const double a = std::abs(ca * (x - cx) + sa * (y - cy));
        const double b = std::abs(ca * (y - cy) - sa * (x - cx)) / stretch;
        const double distance = (square ? std::max(a, b) : std::hypot(a, b)) - radius;
        const auto cover = static_cast<float>(std::clamp(0.5 - distance, 0.0, 1.0));
        float& texel = image[at(x, y)];
        texel += cover * (value - texel);
      }
  }
  return TileTexture(std::move(image));
}

float TileTexture::bilinear(int level, double u_texel, double v_texel) const {
  const int side = kSide >> level;
  const double scale = 1.0 / static_cast<double>(1 << level);
  const double u = u_texel * scale - 0.5, v = v_texel * scale - 0.5;
  const double iu = floor_of(u), iv = floor_of(v);
  const auto fu = static_cast<float>(u - iu), fv = static_cast<float>(v - iv);
  const int mask = side - 1;
  const int x0 = static_cast<int>(iu) & mask, x1 = (x0 + 1) & mask;
  const int y0 = static_cast<int>(iv) & mask, y1 = (y0 + 1) & mask;
  const std::uint8_t* row0 = levels_[static_cast<std::size_t>(level)].data() + y0 * side;
  const std::uint8_t* row1 = levels_[static_cast<std::size_t>(level)].data() + y1 * side;
  const float a = static_cast<float>(row0[x0]), b = static_cast<float>(row0[x1]);
  const float c = static_cast<float>(row1[x0]), d = static_cast<float>(row1[x1]);
  const float top = a + (b - a) * fu, bottom = c + (d - c) * fu;
  return (top + (bottom - top) * fv) * (1.0f / 255.0f);
}

float TileTexture::trilinear(float lod, double u_texel, double v_texel) const {
  if (lod <= 0) return bilinear(0, u_texel, v_texel);
  const int level = static_cast<int>(lod);
  if (level >= kLevels - 1) return bilinear(kLevels - 1, u_texel, v_texel);
  const float fine = bilinear(level, u_texel, v_texel);
  const float coarse = bilinear(level + 1, u_texel, v_texel);
  return fine + (coarse - fine) * (lod - static_cast<float>(level));
}

float TileTexture::sample(const SurfacePoint& p, float texel_m) const {
  const float inverse = 1 / texel_m;
  const double u = p.u * static_cast<double>(inverse), v = p.v * static_cast<double>(inverse);
  const float xx = p.ux * p.ux + p.vx * p.vx, yy = p.uy * p.uy + p.vy * p.vy;
  const bool x_is_long = xx >= yy;
  const float length = std::sqrt(std::max(xx, yy)) * inverse + 1e-6f;
  if (length <= 1) return bilinear(0, u, v);
  const float area = std::abs(p.ux * p.vy - p.uy * p.vx) * inverse * inverse;
  const float width = area / length;
  // Probes along the long side; one will do up to twice the width, between blur and aliasing.
  const int probes = std::clamp(static_cast<int>(length / (width + 0.2f)), 1, 4);
  const float step = length / static_cast<float>(probes);
  const float lod = 0.5f * (rough_log2(std::max(width, 0.25f * step)) + rough_log2(step));
  if (probes == 1) return trilinear(lod, u, v);
  const double du = static_cast<double>((x_is_long ? p.ux : p.uy) * inverse);
  const double dv = static_cast<double>((x_is_long ? p.vx : p.vy) * inverse);
  float sum = 0;
  for (int i = 0; i < probes; ++i) {
    const double shift = (i + 0.5) / probes - 0.5;
    sum += trilinear(lod, u + shift * du, v + shift * dv);
  }
  return sum / static_cast<float>(probes);
}

}  // namespace corvid
