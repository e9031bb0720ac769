#include "kernels/corners.h"

#include <algorithm>
#include <cmath>
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

FloatImage without_pitch(const Buffer<float>& plane, int width, int height, int pitch, Lane lane) {
  std::vector<float> padded(area(pitch, height));
  plane.download(padded, 0, lane);
  FloatImage out(width, height);
  for (int y = 0; y < height; ++y) std::copy_n(padded.data() + area(pitch, y), width, out.row(y));
  return out;
}

}  // namespace

CornerDetector::CornerDetector(std::shared_ptr<Device> device, const cl::Program& program)
    : device_(std::move(device)),
      columns_(program, "columns"),
      scores_(program, "scores"),
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
                                                const std::string& extra_options) {
  const auto program = build_program(*device, "corners", extra_options);
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device, [&] {
    CornerDetector detector(device, *program);
    // Drivers compile for a launch shape at its first use: not in front of the first frame.
    const DeviceImage image = upload(*device, GreyImage(64, 48));
    (void)detector.detect(image, {});
    const Eigen::Vector2f point(20, 20);
    (void)detector.score_at(image, {&point, 1}, 0.04);
    return detector;
  });
}

void CornerDetector::run_scores(const DeviceImage& image, double kappa, Lane lane) {
  const int pitch = score_pitch(image);
  const std::size_t plane = area(pitch, image.height_px);
  // One vector more at the end: neighbours of the last pixels are read as whole vectors.
  products_.resize(3 * plane + 2 * kLanes);
  lambda_min_.resize(plane + 2 * kLanes);
  harris_.resize(plane + 2 * kLanes);
  const int zero[2] = {0, 0};
  state_.upload(zero, lane);
  on_device("corner scores", [&] {
    set_arguments(columns_, image.pixels, image.width_px, image.height_px, pitch, products_.cl());
    launch_rows(*device_, lane, columns_, pitch / kLanes, image.height_px);
    set_arguments(scores_, products_.cl(), image.width_px, image.height_px, pitch,
                  static_cast<float>(kappa), lambda_min_.cl(), harris_.cl(), state_.cl());
    launch_rows(*device_, lane, scores_, pitch / kLanes, image.height_px);
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
    set_arguments(maxima_, lambda_min_.cl(), harris_.cl(), width, height, score_pitch(image),
                  static_cast<float>(quality), std::max(border_px, kCornerMargin_px), found_.cl(),
                  state_.cl());
    launch_rows(*device_, lane, maxima_, divide_up(width, kLanes), height);
  });
  int count = 0;
  state_.download({&count, 1}, 1, lane);
  std::vector<Corner> corners(static_cast<std::size_t>(count));
  found_.download(corners, 0, lane);
  std::sort(corners.begin(), corners.end(), [](const Corner& a, const Corner& b) {
    return std::tuple(-a.lambda_min, a.y_px, a.x_px) < std::tuple(-b.lambda_min, b.y_px, b.x_px);
  });
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
