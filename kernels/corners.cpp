#include "kernels/corners.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <tuple>
#include <utility>

#include "kernels/launch.h"
#include "kernels/program.h"

namespace corvid {
namespace {

constexpr int kLanes = 16;  // as in corners.cl

int score_pitch(const DeviceImage& image) { return divide_up(image.width_px, kLanes) * kLanes; }
std::size_t area(int width, int height) {
  return static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
}
bool too_small(const DeviceImage& image) {
  return std::min(image.width_px, image.height_px) <= 2 * kCornerMargin_px;
}

// By lambda_min (positive), then from top to bottom and from left to right. By digits, since
// comparisons of thousands of corners would take as long as their scores.
void sort_strongest_first(std::vector<Corner>& corners) {
  struct Key {
    std::uint32_t weakness, index;
  };
  constexpr unsigned kDigitBits = 11, kDigits = 1U << kDigitBits;
  std::vector<Key> keys(corners.size()), sorted(corners.size());
  for (std::size_t i = 0; i < keys.size(); ++i)
    keys[i] = {~std::bit_cast<std::uint32_t>(corners[i].lambda_min), static_cast<std::uint32_t>(i)};
  for (unsigned shift = 0; shift < 32; shift += kDigitBits) {
    const auto digit = [&](const Key& key) { return (key.weakness >> shift) & (kDigits - 1); };
    std::array<std::uint32_t, kDigits + 1> start{};
    for (const Key& key : keys) ++start[digit(key) + 1];
    std::partial_sum(start.begin(), start.end(), start.begin());
    for (const Key& key : keys) sorted[start[digit(key)]++] = key;
    std::swap(keys, sorted);
  }
  std::vector<Corner> out;
  out.reserve(corners.size());
  for (const Key& key : keys) out.push_back(corners[key.index]);
  for (auto run = out.begin(); run != out.end();) {
    const auto end = std::find_if(run, out.end(),
                                  [&](const Corner& c) { return c.lambda_min != run->lambda_min; });
    if (end - run > 1)
      std::sort(run, end, [](const Corner& a, const Corner& b) {
        return std::tuple(a.y_px, a.x_px) < std::tuple(b.y_px, b.x_px);
      });
    run = end;
  }
  corners = std::move(out);
}

FloatImage without_pitch(const Buffer<float>& plane, int width, int height, int pitch, Lane lane) {
  std::vector<float> padded(area(pitch, height));
  plane.download(padded, 0, lane);
  FloatImage out(width, height);
  for (int y = 0; y < height; ++y) std::copy_n(padded.data() + area(pitch, y), width, out.row(y));
  return out;
}

}  // namespace

CornerDetector::CornerDetector(std::shared_ptr<Device> device, bool gpu, const cl::Program& program)
    : device_(std::move(device)),
      gpu_(gpu),
      scores_(program, gpu ? "scores" : "score_bands"),
      maxima_(program, "maxima"),
      points_(program, "points"),
      products_(device_),
      lambda_min_(device_),
      harris_(device_),
      state_(device_),
      found_(device_),
      asked_(device_),
      answered_(device_) {}

Expected<CornerDetector> CornerDetector::create(std::shared_ptr<Device> device,
                                                const std::string& extra_options, KernelKind kind) {
  const bool gpu = for_gpu(kind, *device);
  const auto program =
      build_program(*device, "corners", (gpu ? "-DLANES=1 " : "-DLANES=16 ") + extra_options);
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device, [&] {
    CornerDetector detector(device, gpu, *program);
    if (gpu) detector.columns_ = cl::Kernel(*program, "columns");
    // Drivers compile for a launch shape at its first use: not in front of the first frame.
    const DeviceImage image = upload(*device, GreyImage(64, 48));
    (void)detector.detect(image, {});
    const Eigen::Vector2f point(20, 20);
    (void)detector.score_at(image, {&point, 1}, 0.04);
    return detector;
  });
}

int CornerDetector::rows_each(const DeviceImage& image) const {
  constexpr int kMinBand_px = 4096;
  return band_rows(*device_, image.width_px, image.height_px, kMinBand_px);
}

void CornerDetector::run_scores(const DeviceImage& image, double kappa, Lane lane) {
  CORVID_CHECK(image.format == PixelFormat::grey8, "corners are found in grey8 images");
  const int width = image.width_px, height = image.height_px, pitch = score_pitch(image);
  const auto kappa_f = static_cast<float>(kappa);
  const std::size_t plane = area(pitch, height);
  // One vector more at the end: neighbours of the last pixels are read as whole vectors.
  lambda_min_.resize(plane + 2 * kLanes);
  harris_.resize(plane + 2 * kLanes);
  state_.resize(2);
  on_device("corner scores", [&] {
    device_->queue(lane).enqueueFillBuffer(state_.cl(), cl_int{0}, 0, 2 * sizeof(cl_int));
    if (gpu_) {
      products_.resize(3 * plane);
      set_arguments(columns_, image.pixels, width, height, pitch, products_.cl());
      launch_rows(*device_, lane, columns_, width, height);
      set_arguments(scores_, products_.cl(), width, height, pitch, kappa_f, lambda_min_.cl(),
                    harris_.cl(), state_.cl());
      launch_rows(*device_, lane, scores_, pitch, height);
    } else {
      const int rows = rows_each(image);
      set_arguments(scores_, image.pixels, width, height, pitch, kappa_f, lambda_min_.cl(),
                    harris_.cl(), state_.cl(), rows);
      launch_items(*device_, lane, scores_, divide_up(height, rows));
    }
  });
}

CornerScoreImages CornerDetector::scores(const DeviceImage& image, double kappa, Lane lane) {
  run_scores(image, kappa, lane);
  const int pitch = score_pitch(image);
  return {without_pitch(lambda_min_, image.width_px, image.height_px, pitch, lane),
          without_pitch(harris_, image.width_px, image.height_px, pitch, lane)};
}

std::vector<Corner> CornerDetector::detect_all(const DeviceImage& image, double quality,
                                               double kappa, int border_px, Lane lane) {
  if (too_small(image)) return {};
  run_scores(image, kappa, lane);
  const int width = image.width_px, height = image.height_px;
  // Strict 3x3 maxima are no neighbours: there cannot be more of them.
  found_.resize(area((width + 1) / 2, (height + 1) / 2));
  on_device("corner maxima", [&] {
    const int rows = rows_each(image);
    set_arguments(maxima_, lambda_min_.cl(), harris_.cl(), width, height, score_pitch(image),
                  static_cast<float>(quality), std::max(border_px, kCornerMargin_px), found_.cl(),
                  state_.cl(), rows);
    if (gpu_)
      launch_rows(*device_, lane, maxima_, width, height);
    else
      launch_items(*device_, lane, maxima_, divide_up(height, rows));
  });
  int count = 0;
  state_.download({&count, 1}, 1, lane);
  std::vector<Corner> corners(static_cast<std::size_t>(count));
  found_.download(corners, 0, lane);
  sort_strongest_first(corners);
  return corners;
}

std::vector<Corner> CornerDetector::detect(const DeviceImage& image, const CornerOptions& options,
                                           Lane lane) {
  return select_evenly(detect_all(image, options.quality, options.kappa, options.border_px, lane),
                       options);
}

std::vector<CornerScore> CornerDetector::score_at(const DeviceImage& image,
                                                  std::span<const Eigen::Vector2f> points,
                                                  double kappa, Lane lane) {
  CORVID_CHECK(image.format == PixelFormat::grey8, "corners are scored in grey8 images");
  std::vector<CornerScore> scores(points.size());
  if (points.empty()) return scores;
  asked_.upload({points.data()->data(), 2 * points.size()}, lane);
  answered_.resize(points.size());
  on_device("corner points", [&] {
    set_arguments(points_, image.pixels, image.width_px, image.height_px, static_cast<float>(kappa),
                  asked_.cl(), static_cast<int>(points.size()), answered_.cl());
    launch_rows(*device_, lane, points_, static_cast<int>(points.size()), 1);
  });
  answered_.download(scores, 0, lane);
  return scores;
}

}  // namespace corvid
