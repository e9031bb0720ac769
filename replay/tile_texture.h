#pragma once

#include <cstdint>
#include <vector>

namespace corvid {

/// A position on a surface [m] and how far it moves per pixel in the image's x and y: what a
/// texture needs to be filtered over the pixel's footprint.
struct SurfacePoint {
  double u = 0, v = 0;
  float ux = 0, vx = 0, uy = 0, vy = 0;
  /// Width of the footprint along u and along v [m].
  [[nodiscard]] float width_u() const;
  [[nodiscard]] float width_v() const;
};

/// A pattern that repeats, with its mip levels. Values in [0, 1], mean near 0.5.
class TileTexture {
 public:
  static constexpr int kSide = 512;
  /// Band-limited noise of all wavelengths (a sum of octaves of value noise).
  [[nodiscard]] static TileTexture clouds(std::uint64_t seed);
  /// Discs and squares of all sizes that cover one another ("dead leaves"): the statistics of
  /// natural images (Lee, Mumford, Huang, IJCV 2001), and corners at every scale.
  [[nodiscard]] static TileTexture leaves(std::uint64_t seed);

  /// The mean over the pixel's footprint: trilinear, with up to four probes along the footprint's
  /// long axis.
  /// @param texel_m  size of the finest texel on the surface.
  [[nodiscard]] float sample(const SurfacePoint& p, float texel_m) const;

 private:
  explicit TileTexture(std::vector<float> finest);
  [[nodiscard]] float bilinear(int level, double u_texel, double v_texel) const;
  [[nodiscard]] float trilinear(float lod, double u_texel, double v_texel) const;
  std::vector<std::vector<std::uint8_t>> levels_;
};

}  // namespace corvid
