#include "kernels/ncc.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "kernels/launch.h"
#include "kernels/program.h"

namespace corvid {
namespace {

// Windows of at most this many candidates are done by one work-item on a CPU, from the template to
// the peaks, while their coefficients are in its cache.
constexpr int kSmallWindow = 40 * 40;
constexpr int kWideTileRows = 32, kFineTileRows = 8;

std::optional<Error> check_options(const NccOptions& options) {
  const auto error = [](std::string what) {
    return Error{ErrorCode::invalid_argument, std::move(what), "NccOptions", {}};
  };
  if (options.template_px < 3 || options.template_px > 31 || options.template_px % 2 == 0)
    return error(fmt::format("template_px is {}: an odd number from 3 to 31 is wanted",
                             options.template_px));
  if (!(options.peak_quality >= 0 && options.peak_quality <= 1))
    return error("peak_quality must be in [0, 1]");
  if (options.align_iterations < 0) return error("align_iterations must not be negative");
  return std::nullopt;
}

// 1-d weights of sum 1, as a compiler option.
std::string weights(const NccOptions& options) {
  const int half = options.template_px / 2;
  const double sigma = options.template_px / 6.0;
  const auto weight = [&](int i) {
    return options.gaussian ? std::exp(-0.5 * i * i / (sigma * sigma)) : 1.0;
  };
  double sum = 0;
  for (int i = -half; i <= half; ++i) sum += weight(i);
  std::string list;
  for (int i = -half; i <= half; ++i)
    list += fmt::format("{}{:.9e}f", i == -half ? "" : ",", weight(i) / sum);
  return list;
}

}  // namespace

NccMatcher::NccMatcher(std::shared_ptr<Device> device, std::string extra_options, bool wide)
    : device_(std::move(device)),
      extra_options_(std::move(extra_options)),
      wide_(wide),
      lanes_(wide ? 16 : 4),
      device_jobs_(device_),
      device_tiles_(device_),
      templates_(device_),
      scores_(device_),
      device_results_(device_) {}

Expected<NccMatcher> NccMatcher::create(std::shared_ptr<Device> device, std::string extra_options,
                                        NccVariant variant) {
  const bool wide =
      variant == NccVariant::by_device ? !device->info().gpu : variant == NccVariant::wide;
  NccMatcher matcher(std::move(device), std::move(extra_options), wide);
  if (auto ready = matcher.prepare({}); !ready) return tl::unexpected(ready.error());
  return matcher;
}

Expected<NccMatcher::Kernels*> NccMatcher::kernels(const NccOptions& options) {
  if (auto error = check_options(options)) return tl::unexpected(std::move(*error));
  const std::pair key(options.template_px, options.gaussian);
  if (const auto found = kernels_.find(key); found != kernels_.end()) return &found->second;
  const auto program = build_program(
      *device_, "ncc",
      fmt::format("-DT={} -DWEIGHTS={} -DLANES={} -DROWS=4 -DTILE_ROWS={}{}{}{}",
                  options.template_px, weights(options), lanes_,
                  wide_ ? kWideTileRows : kFineTileRows, options.gaussian ? " -DGAUSSIAN" : "",
                  extra_options_.empty() ? "" : " ", extra_options_));
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device_, [&] {
    const auto kernel = [&](const char* name) { return cl::Kernel(*program, name); };
    return &kernels_
                .emplace(key, Kernels{kernel("small"), kernel("templates"), kernel("tiles"),
                                      kernel("peaks")})
                .first->second;
  });
}

Expected<void> NccMatcher::prepare(const NccOptions& options) {
  const auto ready = kernels(options);
  if (!ready) return tl::unexpected(ready.error());
  // Drivers compile for a launch shape at its first use: not in front of the first frame.
  const auto warm = opening_on_device(*device_, [&] {
    const DeviceImage image = upload(*device_, GreyImage(96, 96));
    NccJob job;
    job.template_x_px = job.template_y_px = 48;
    job.window_x_px = job.window_y_px = 48;
    for (const int radius : {2, 48}) {
      job.radius_x_px = job.radius_y_px = radius;
      (void)match(image, image, {&job, 1}, options);
    }
    return true;
  });
  if (!warm) return tl::unexpected(warm.error());
  return {};
}

// TEMPLATE_FLOATS of ncc.cl.
std::size_t NccMatcher::template_size(int template_px) const {
  return static_cast<std::size_t>(template_px * divide_up(template_px, lanes_) * lanes_ + 1);
}

bool NccMatcher::place(const NccJob& job, const DeviceImage& reference, const DeviceImage& target,
                       int template_px, DeviceJob& out) {
  const double half = template_px / 2;
  const double cx = job.template_x_px, cy = job.template_y_px;
  // The footprint is a parallelogram: it lies in the image if its corners do. False for NaN.
  const double reach_x = half * (std::abs(double{job.warp[0]}) + std::abs(double{job.warp[1]}));
  const double reach_y = half * (std::abs(double{job.warp[2]}) + std::abs(double{job.warp[3]}));
  if (!(cx - reach_x >= 0 && cx + reach_x <= reference.width_px - 1 && cy - reach_y >= 0 &&
        cy + reach_y <= reference.height_px - 1))
    return false;
  if (job.radius_x_px < 0 || job.radius_y_px < 0) return false;
  const auto clip = [&](std::int64_t centre, std::int64_t radius, int size, std::int32_t& first,
                        std::int32_t& count) {
    const std::int64_t low = std::max<std::int64_t>(centre - radius, template_px / 2);
    const std::int64_t high = std::min<std::int64_t>(centre + radius, size - 1 - template_px / 2);
    if (high < low) return false;
    first = static_cast<std::int32_t>(low);
    count = static_cast<std::int32_t>(high - low + 1);
    return true;
  };
  if (!clip(job.window_x_px, job.radius_x_px, target.width_px, out.x, out.width) ||
      !clip(job.window_y_px, job.radius_y_px, target.height_px, out.y, out.height))
    return false;
  out.reference_x = static_cast<std::int32_t>(std::floor(cx));
  out.reference_y = static_cast<std::int32_t>(std::floor(cy));
  out.fraction_x = static_cast<float>(cx - out.reference_x);
  out.fraction_y = static_cast<float>(cy - out.reference_y);
  std::copy_n(job.warp, 4, out.warp);
  out.flat = (job.radius_y_px == 0 ? 1 : 0) | (job.radius_x_px == 0 ? 2 : 0);
  return true;
}

std::vector<NccResult> NccMatcher::match(const DeviceImage& reference, const DeviceImage& target,
                                         std::span<const NccJob> jobs, const NccOptions& options,
                                         Lane lane) {
  const auto ready = kernels(options);
  if (!ready) {
    CORVID_CHECK(ready.error().code == ErrorCode::device, ready.error().to_string());
    throw DeviceFault(ready.error().to_string(), CL_BUILD_PROGRAM_FAILURE);
  }
  std::vector<NccResult> results(jobs.size());
  const std::size_t template_floats = template_size(options.template_px);
  constexpr std::size_t kMostFloats = std::numeric_limits<std::int32_t>::max();

  for (const bool small : {true, false}) {
    std::vector<std::size_t> batch;  // indices into jobs
    std::size_t floats = 0;
    const auto flush = [&] {
      if (batch.empty()) return;
      scores_.resize(floats + static_cast<std::size_t>(2 * lanes_));
      run_batch(**ready, reference, target, options, small, lane);
      for (std::size_t i = 0; i < batch.size(); ++i) results[batch[i]] = results_[i];
      batch.clear();
      jobs_.clear();
      floats = 0;
    };
    jobs_.clear();
    for (std::size_t i = 0; i < jobs.size(); ++i) {
      DeviceJob placed{};
      if (!place(jobs[i], reference, target, options.template_px, placed)) continue;
      const bool is_small = wide_ && placed.width <= kSmallWindow / placed.height;
      if (is_small != small) continue;
      placed.pitch = divide_up(placed.width, lanes_) * lanes_;
      const std::size_t needed =
          static_cast<std::size_t>(placed.pitch) * static_cast<std::size_t>(placed.height) +
          static_cast<std::size_t>(lanes_);
      const std::size_t bytes =
          (floats + needed) * sizeof(float) +
          (jobs_.size() + 1) * (sizeof(DeviceJob) + sizeof(NccResult) +
                                (small ? 0 : template_floats * sizeof(float)));
      if (bytes > options.memory_budget_bytes || floats + needed > kMostFloats) flush();
      if (needed > kMostFloats)
        throw DeviceFault("a search window has too many candidates", CL_INVALID_BUFFER_SIZE);
      placed.scores = static_cast<std::int32_t>(floats);
      floats += needed;
      jobs_.push_back(placed);
      batch.push_back(i);
    }
    flush();
  }
  return results;
}

void NccMatcher::run_batch(Kernels& kernels, const DeviceImage& reference,
                           const DeviceImage& target, const NccOptions& options, bool small,
                           Lane lane) {
  const int count = static_cast<int>(jobs_.size());
  const auto quality = static_cast<float>(options.peak_quality);
  device_jobs_.upload(jobs_, lane);
  device_results_.resize(jobs_.size());
  results_.resize(jobs_.size());
  if (small) {
    on_device("correlation", [&] {
      set_arguments(kernels.small, reference.pixels, reference.width_px, reference.height_px,
                    target.pixels, target.width_px, target.height_px, device_jobs_.cl(), count,
                    scores_.cl(), quality, options.align_iterations, device_results_.cl());
      launch_items(*device_, lane, kernels.small, count);
    });
  } else {
    const int tile_rows = wide_ ? kWideTileRows : kFineTileRows;
    tile_list_.clear();
    for (int job = 0; job < count; ++job) {
      const DeviceJob& placed = jobs_[static_cast<std::size_t>(job)];
      for (int y = 0; y < placed.height; y += tile_rows)
        for (int x = 0; x < placed.width; x += lanes_)
          tile_list_.push_back({job, x, y, std::min(tile_rows, placed.height - y)});
    }
    device_tiles_.upload(tile_list_, lane);
    templates_.resize(jobs_.size() * template_size(options.template_px));
    const int tiles = static_cast<int>(tile_list_.size());
    on_device("correlation", [&] {
      set_arguments(kernels.templates, reference.pixels, reference.width_px, reference.height_px,
                    device_jobs_.cl(), count, templates_.cl());
      launch_items(*device_, lane, kernels.templates, count);
      set_arguments(kernels.tiles, target.pixels, target.width_px, device_jobs_.cl(),
                    device_tiles_.cl(), tiles, templates_.cl(), scores_.cl());
      launch_items(*device_, lane, kernels.tiles, tiles);
      set_arguments(kernels.peaks, target.pixels, target.width_px, target.height_px,
                    device_jobs_.cl(), count, templates_.cl(), scores_.cl(), quality,
                    options.align_iterations, device_results_.cl());
      launch_items(*device_, lane, kernels.peaks, count);
    });
  }
  device_results_.download(results_, 0, lane);
}

}  // namespace corvid
