#include "replay/synthetic_flight.h"

#include <fmt/format.h>

#include <cmath>

#include "core/check.h"
#include "replay/flight_curve.h"
#include "replay/random.h"
#include "replay/renderer.h"
#include "replay/sensor.h"

namespace corvid {
namespace {
Camera make_camera(const FlightOptions& o) {
  Camera camera;
  camera.model = o.model;
  camera.width_px = o.width_px;
  camera.height_px = o.height_px;
  camera.cx_px = 0.5 * (o.width_px - 1);
  camera.cy_px = 0.5 * (o.height_px - 1);
  const double half_width = 0.5 * o.width_px, half_angle = 0.5 * o.horizontal_fov_rad;
  double focal = half_width / std::tan(half_angle);
  switch (o.model) {
    case CameraModel::pinhole:
      break;
    case CameraModel::radtan:
      camera.distortion = {-0.28, 0.07, 2e-4, 2e-5, 0};
      break;
    case CameraModel::equidistant:
      focal = half_width / half_angle;
      camera.distortion = {-0.012, 0.006, -0.004, 0.0008, 0};
      break;
    case CameraModel::fov: {
      constexpr double kOmega = 0.9;
      focal = half_width * kOmega / std::atan(2 * std::tan(half_angle) * std::tan(kOmega / 2));
      camera.distortion = {kOmega, 0, 0, 0, 0};
      break;
    }
  }
  camera.fx_px = camera.fy_px = focal;
  return camera;
}
}  // namespace

std::vector<std::string> FlightOptions::validate() const {
  std::vector<std::string> problems;
  const auto need = [&](bool good, const char* problem) {
    if (!good) problems.emplace_back(problem);
  };
  need(width_px >= 16 && width_px <= 16384, "width_px must be from 16 to 16384");
  need(height_px >= 16 && height_px <= 16384, "height_px must be from 16 to 16384");
  need(rate_hz > 0 && rate_hz <= 1e4, "rate_hz must be over 0 and at most 10000");
  need(duration_s > 0 && duration_s <= 1e6, "duration_s must be over 0 and at most 1000000");
  need(duration_s * rate_hz < 4e9, "duration_s times rate_hz must be under 4e9 frames");
  need(speed_mps >= 0 && speed_mps <= 100, "speed_mps must be from 0 (the path's own) to 100");
  need(horizontal_fov_rad >= 0.2 && horizontal_fov_rad <= 2.6,
       "horizontal_fov_rad must be from 0.2 to 2.6");
  need(noise_sigma >= 0 && noise_sigma <= 64, "noise_sigma must be from 0 to 64");
  need(optical_blur_px >= 0 && optical_blur_px <= 10, "optical_blur_px must be from 0 to 10");
  need(shutter_s >= 0 && shutter_s <= 1, "shutter_s must be from 0 to 1");
  need(vignetting >= 0 && vignetting <= 0.9, "vignetting must be from 0 to 0.9");
  need(exposure_change >= 0 && exposure_change <= 0.9, "exposure_change must be from 0 to 0.9");
  need(start_time_ns >= 0, "start_time_ns must not be negative");
  need(threads >= 0 && threads <= 1024, "threads must be from 0 (one per core) to 1024");
  return problems;
}

struct SyntheticFlight::Impl {
  explicit Impl(const FlightOptions& o)
      : options(o),
        frames(static_cast<std::size_t>(
            std::max<long long>(1, std::llround(o.duration_s * o.rate_hz)))),
        camera(std::make_shared<const Camera>(make_camera(o))),
        town(std::make_shared<const Town>(o.seed)),
        curve(o, *town, seconds(frames - 1)),
        renderer(town, *camera, o.threads) {
    info.kind = "synthetic flight";
    info.path = fmt::format("seed {}", o.seed);
    info.frames = frames;
    info.rate_hz = o.rate_hz;
    info.colour = o.colour;
    info.camera = camera;
  }
  [[nodiscard]] double seconds(std::size_t frame) const {
    return static_cast<double>(frame) / options.rate_hz;
  }
  [[nodiscard]] std::int64_t time_ns(std::size_t frame) const {
    return options.start_time_ns + std::llround(seconds(frame) * 1e9);
  }

  FlightOptions options;
  std::size_t frames;
  std::shared_ptr<const Camera> camera;
  std::shared_ptr<const Town> town;
  FlightCurve curve;
  Renderer renderer;
  SourceInfo info;
  std::size_t next = 0;

  [[nodiscard]] FramePtr picture(const RadianceImage& light, std::size_t frame) const {
    const double t = seconds(frame);
    // The gain wanders as an automatic exposure does: two slow swings that never repeat together.
    const double phase = static_cast<double>(mix64(options.seed) & 1023) / 163.0;
    const double swing = 0.6 * std::sin(0.37 * t + phase) + 0.4 * std::sin(0.91 * t + 2 * phase);
    SensorOptions sensor;
    sensor.gain = 1.15 * (1 + options.exposure_change * swing);
    sensor.vignetting = options.vignetting;
    sensor.noise_sigma = options.noise_sigma;
    sensor.seed = mix64(options.seed ^ mix64(frame));
    auto result = std::make_shared<Frame>();
    result->id = FrameId(static_cast<std::uint32_t>(frame));
    result->time_ns = time_ns(frame);
    result->colour = expose(light, sensor);
    result->grey = to_grey(result->colour);
    if (!options.colour) result->colour = {};
    result->camera = camera;
    result->name = fmt::format("{:06}.png", frame);
    return result;
  }
};

Expected<std::unique_ptr<SyntheticFlight>> SyntheticFlight::open(const FlightOptions& options) {
  const auto problems = options.validate();
  if (!problems.empty())
    return fail(ErrorCode::invalid_argument, fmt::format("{}", fmt::join(problems, "; ")),
                "synthetic flight");
  return std::make_unique<SyntheticFlight>(options);
}

SyntheticFlight::SyntheticFlight(const FlightOptions& options) {
  CORVID_CHECK(options.validate().empty(), "the flight's options are wrong");
  impl_ = std::make_unique<Impl>(options);
}
SyntheticFlight::~SyntheticFlight() = default;

const SourceInfo& SyntheticFlight::info() const { return impl_->info; }
std::size_t SyntheticFlight::frame_count() const { return impl_->frames; }
const Camera& SyntheticFlight::camera() const { return *impl_->camera; }

Expected<FramePtr> SyntheticFlight::next(const std::stop_token& stop) {
  if (stop.stop_requested() || impl_->next >= impl_->frames) return FramePtr{};
  FramePtr frame = render(impl_->next);
  ++impl_->next;
  return frame;
}

SourceCounts SyntheticFlight::counts() const {
  SourceCounts counts;
  counts.delivered = impl_->next;
  return counts;
}

std::int64_t SyntheticFlight::time_ns(std::size_t frame) const { return impl_->time_ns(frame); }

Pose SyntheticFlight::true_pose(std::size_t frame) const {
  return impl_->curve.at(impl_->seconds(frame));
}

Trajectory SyntheticFlight::truth() const {
  Trajectory truth;
  truth.reserve(impl_->frames);
  for (std::size_t i = 0; i < impl_->frames; ++i) truth.push_back({time_ns(i), true_pose(i)});
  return truth;
}

std::optional<TriangleMesh> SyntheticFlight::true_surface() const { return impl_->town->surface(); }

FramePtr SyntheticFlight::render(const Pose& T_world_camera, std::size_t frame) const {
  RadianceImage light = impl_->renderer.render(T_world_camera);
  blur(light, impl_->options.optical_blur_px);
  return impl_->picture(light, frame);
}

FramePtr SyntheticFlight::render(std::size_t frame) const {
  CORVID_CHECK(frame < impl_->frames, "there is no such frame");
  constexpr int kInstants = 4;
  const double shutter = impl_->options.shutter_s;
  if (shutter <= 0) return render(true_pose(frame), frame);
  RadianceImage light(impl_->camera->width_px, impl_->camera->height_px);
  for (int i = 0; i < kInstants; ++i) {
    const double t = impl_->seconds(frame) + shutter * ((i + 0.5) / kInstants - 0.5);
    const RadianceImage part = impl_->renderer.render(impl_->curve.at(t));
    for (std::size_t p = 0; p < light.size(); ++p) {
      light.data()[p].r += part.data()[p].r / kInstants;
      light.data()[p].g += part.data()[p].g / kInstants;
      light.data()[p].b += part.data()[p].b / kInstants;
    }
  }
  blur(light, impl_->options.optical_blur_px);
  return impl_->picture(light, frame);
}

FloatImage SyntheticFlight::render_depth(std::size_t frame) const {
  CORVID_CHECK(frame < impl_->frames, "there is no such frame");
  return render_depth(true_pose(frame));
}
FloatImage SyntheticFlight::render_depth(const Pose& T_world_camera) const {
  return impl_->renderer.depth(T_world_camera);
}

}  // namespace corvid
