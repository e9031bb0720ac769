#include "replay/sensor.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "replay/random.h"

namespace corvid {

void blur(RadianceImage& image, double sigma_px) {
  static_assert(sizeof(Radiance) == 3 * sizeof(float));
  if (sigma_px < 0.05 || image.empty()) return;
  const int reach = std::max(1, static_cast<int>(std::ceil(3 * sigma_px)));
  std::vector<float> kernel;
  float sum = 0;
  for (int i = 0; i <= reach; ++i) {
    kernel.push_back(static_cast<float>(std::exp(-0.5 * i * i / (sigma_px * sigma_px))));
    sum += kernel.back() * (i == 0 ? 1 : 2);
  }
  for (float& k : kernel) k /= sum;

  const int width = image.width(), height = image.height(), n = 3 * width;
  // Rows first, with the border's pixels repeated; then columns, row by row.
  std::vector<float> padded(static_cast<std::size_t>(n + 6 * reach));
  FloatImage rows(n, height);
  for (int y = 0; y < height; ++y) {
    for (int x = -reach; x < width + reach; ++x) {
      const Radiance& p = image(std::clamp(x, 0, width - 1), y);
      float* out = padded.data() + 3 * (x + reach);
      out[0] = p.r;
      out[1] = p.g;
      out[2] = p.b;
    }
    const float* in = padded.data() + 3 * reach;
    float* out = rows.row(y);
    for (int i = 0; i < n; ++i) out[i] = kernel[0] * in[i];
    for (int k = 1; k <= reach; ++k) {
      const float weight = kernel[static_cast<std::size_t>(k)];
      for (int i = 0; i < n; ++i) out[i] += weight * (in[i - 3 * k] + in[i + 3 * k]);
    }
  }
  std::vector<float> line(static_cast<std::size_t>(n));
  for (int y = 0; y < height; ++y) {
    const float* middle = rows.row(y);
    for (int i = 0; i < n; ++i) line[static_cast<std::size_t>(i)] = kernel[0] * middle[i];
    for (int k = 1; k <= reach; ++k) {
      const float weight = kernel[static_cast<std::size_t>(k)];
      const float* above = rows.row(std::max(0, y - k));
      const float* below = rows.row(std::min(height - 1, y + k));
      for (int i = 0; i < n; ++i)
        line[static_cast<std::size_t>(i)] += weight * (above[i] + below[i]);
    }
    for (int x = 0; x < width; ++x) {
      const float* p = line.data() + 3 * x;
      image(x, y) = {p[0], p[1], p[2]};
    }
  }
}

ColourImage expose(const RadianceImage& light, const SensorOptions& options) {
  const int width = light.width(), height = light.height();
  ColourImage image(width, height);
  const auto gain = static_cast<float>(options.gain * 255 * 255);
  const float cx = 0.5f * static_cast<float>(width - 1), cy = 0.5f * static_cast<float>(height - 1);
  const float loss = static_cast<float>(options.vignetting) / std::max(1.0f, cx * cx + cy * cy);
  // A sum of four even 16-bit numbers has standard deviation sqrt(4 (2^32 - 1) / 12).
  const auto noise_scale = static_cast<float>(options.noise_sigma / 37837.0);
  for (int y = 0; y < height; ++y) {
    const float dy = static_cast<float>(y) - cy;
    for (int x = 0; x < width; ++x) {
      const float dx = static_cast<float>(x) - cx;
      const float through = gain * (1 - loss * (dx * dx + dy * dy));
      const std::uint64_t h = mix64(
          options.seed ^ (static_cast<std::uint64_t>(y) << 32 | static_cast<std::uint64_t>(x)));
      const auto sum = static_cast<std::int32_t>((h & 0xffff) + ((h >> 16) & 0xffff) +
                                                 ((h >> 32) & 0xffff) + (h >> 48));
      const float noise = noise_scale * static_cast<float>(sum - 131070);
      const auto level = [&](float radiance) {
        const float v = std::sqrt(std::max(0.0f, through * radiance)) + noise;
        return static_cast<std::uint8_t>(std::clamp(v + 0.5f, 0.0f, 255.0f));
      };
      const Radiance& p = light(x, y);
      image(x, y) = {level(p.r), level(p.g), level(p.b)};
    }
  }
  return image;
}

GreyImage to_grey(const ColourImage& colour) {
  GreyImage grey(colour.width(), colour.height());
  const cv::Mat in(colour.height(), colour.width(), CV_8UC3,
                   const_cast<Rgb8*>(colour.data()));  // only read
  cv::Mat out(colour.height(), colour.width(), CV_8UC1, grey.data());
  cv::cvtColor(in, out, cv::COLOR_RGB2GRAY);
  return grey;
}

}  // namespace corvid
