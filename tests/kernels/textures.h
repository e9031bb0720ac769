#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "corvid/image.h"

namespace corvid {

/// Random band-limited texture: a function of the plane that can be sampled anywhere.
class Texture {
 public:
  /// @param max_frequency  [cycles/px]; amplitudes fall with frequency as in natural images.
  explicit Texture(double max_frequency, unsigned seed = 1, int waves = 80) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> unit(0, 1);
    double power = 0;
    for (int i = 0; i < waves; ++i) {
      const double f = max_frequency * (0.1 + 0.9 * unit(random));
      const double angle = 2 * std::numbers::pi * unit(random);
      const double amplitude = 1 / std::sqrt(f);
      waves_.push_back({2 * std::numbers::pi * f * std::cos(angle),
                        2 * std::numbers::pi * f * std::sin(angle),
                        2 * std::numbers::pi * unit(random), amplitude});
      power += amplitude * amplitude / 2;
    }
    for (auto& wave : waves_) wave[3] *= 45 / std::sqrt(power);
  }
  [[nodiscard]] double operator()(double x, double y) const {
    double value = 128;
    for (const auto& [fx, fy, phase, amplitude] : waves_)
      value += amplitude * std::sin(fx * x + fy * y + phase);
    return value;
  }

 private:
  std::vector<std::array<double, 4>> waves_;
};

inline std::uint8_t to_grey(double value) {
  return static_cast<std::uint8_t>(std::lrint(std::clamp(value, 0., 255.)));
}

/// f(x, y) at every pixel.
template <class F>
GreyImage paint(int width, int height, F&& f) {
  GreyImage image(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) image(x, y) = to_grey(f(x, y));
  return image;
}

inline GreyImage noise(int width, int height, unsigned seed = 5) {
  std::mt19937 random(seed);
  return paint(width, height, [&](int, int) { return random() % 256; });
}

/// The kinds of image that kernels are compared on, by name.
inline std::vector<std::pair<std::string, GreyImage>> test_images(int width, int height) {
  const Texture smooth(0.12, 3), fine(0.45, 4);
  return {
      {"natural",
       paint(width, height, [&](int x, int y) { return 0.7 * smooth(x, y) + 0.3 * fine(x, y); })},
      {"noise", noise(width, height)},
      {"ramp", paint(width, height, [&](int x, int y) { return 0.7 * x + 1.1 * y; })},
      {"constant areas", paint(width, height,
                               [&](int x, int y) {
                                 return (x / 24 + y / 24) % 2 == 0 ? 90. : 2 * smooth(x, y) - 128;
                               })},
      {"saturated",
       paint(width, height, [&](int x, int y) { return 6 * (smooth(x, y) - 128) + 200; })},
      {"faint",
       paint(width, height, [&](int x, int y) { return 230 + 0.04 * (smooth(x, y) - 128); })},
  };
}

}  // namespace corvid
