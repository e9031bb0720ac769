#pragma once

#include <cstdint>

#include "corvid/image.h"
#include "replay/renderer.h"

namespace corvid {

/// Blurs by a Gaussian, in place; sigma under 0.05 px does nothing.
void blur(RadianceImage& image, double sigma_px);

struct SensorOptions {
  double gain = 1;
  double vignetting = 0;   ///< share of the light lost in the corners (as the squared radius)
  double noise_sigma = 0;  ///< [grey levels], the same in the three channels of a pixel
  std::uint64_t seed = 0;  ///< of this frame's noise
};
/// Light to 8-bit levels: 255 sqrt(gain * light), vignetting, noise, rounding.
[[nodiscard]] ColourImage expose(const RadianceImage& light, const SensorOptions& options);
/// The grey image that OpenCV makes of a colour image, so that a recording read back is the same.
[[nodiscard]] GreyImage to_grey(const ColourImage& colour);

}  // namespace corvid
