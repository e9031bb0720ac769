// Whole maps of coefficients: the one job for which there are several ways on a CPU.
#include <fmt/core.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "kernels/launch.h"
#include "kernels/ncc.h"
#include "kernels/ncc_frequency.h"
#include "kernels/program.h"
#include "kernels/tuning.h"

namespace corvid {
namespace {

// Smaller windows, or thinner ones, are not worth a choice.
constexpr int kDenseSide_px = 128;
// Smaller templates are nowhere faster by Fourier transforms: with 4 numbers per vector these begin
// to win at 15 x 15, with 16 at 31 x 31 (docs/decisions/correlation.md).
constexpr int kLeastFrequencyArea = 13 * 13;

// What ways are compared on: neither smooth nor noise, the same everywhere.
template <class Pixel>
Image<Pixel> sample_image() {
  Image<Pixel> image(640, 480);
  std::uint32_t random = 1;
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x) {
      random = random * 1664525U + 1013904223U;
      const double wave = std::sin(0.11 * x + 0.05 * y) + std::sin(0.23 * y - 0.04 * x);
      image(x, y) = static_cast<Pixel>(128 + 40 * wave + 20 * (random >> 8) / 16777216.0);
    }
  return image;
}

// A buffer in the host's memory; on a CPU that is where it is.
template <class T>
class Mapped {
 public:
  Mapped(const cl::CommandQueue& queue, const cl::Buffer& buffer, cl_map_flags flags,
         std::size_t count)
      : queue_(queue),
        buffer_(buffer),
        mapped_(queue.enqueueMapBuffer(buffer, CL_TRUE, flags, 0, count * sizeof(T))) {}
  Mapped(const Mapped&) = delete;
  Mapped& operator=(const Mapped&) = delete;
  ~Mapped() {
    try {
      queue_.enqueueUnmapMemObject(buffer_, mapped_);
      queue_.finish();
    } catch (const cl::Error&) {  // the next call finds the fault
    }
  }
  [[nodiscard]] T* data() const { return static_cast<T*>(mapped_); }

 private:
  cl::CommandQueue queue_;
  cl::Buffer buffer_;
  void* mapped_;
};

}  // namespace

void NccMatcher::score(const DeviceImage& reference, const DeviceImage& target, const NccJob& job,
                       const NccOptions& options, NccScores& out, Lane lane) {
  out.x_px = out.y_px = out.width_px = out.height_px = 0;
  out.scores.resize(0);
  DeviceJob placed{};
  CORVID_CHECK(reference.format == target.format, "images to correlate have one pixel format");
  if (!place(job, reference, target, checked_kernels(target, options, variant_), placed)) return;
  const bool dense = placed.width >= kDenseSide_px && placed.height >= kDenseSide_px;
  const NccVariant variant = variant_ == NccVariant::by_device && !groups_ && dense
                                 ? fastest_variant(options, target.format, lane)
                                 : variant_;
  score_as(variant, reference, target, placed, options, out, lane);
}

void NccMatcher::score_as(NccVariant variant, const DeviceImage& reference,
                          const DeviceImage& target, const DeviceJob& job,
                          const NccOptions& options, NccScores& out, Lane lane) {
  Kernels& kernels = checked_kernels(target, options, variant);
  out.scores.resize(static_cast<std::size_t>(job.width) * static_cast<std::size_t>(job.height));
  out.x_px = job.x;
  out.y_px = job.y;
  out.width_px = job.width;
  out.height_px = job.height;
  jobs_.clear();
  piece_list_.clear();
  add_job(job);
  if (variant == NccVariant::frequency)
    score_frequencies(kernels, reference, target, out.scores, lane);
  const Templates templates{&reference, 0, 1};
  if (!piece_list_.empty())
    run_batch(kernels, std::span(&templates, 1), target, options, &out.scores, lane);
}

// Scores the one job; what is left for the spatial way becomes the list of pieces.
void NccMatcher::score_frequencies(Kernels& kernels, const DeviceImage& reference,
                                   const DeviceImage& target, Buffer<float>& map, Lane lane) {
  Denominators& kept = denominators(kernels, target);
  complete_denominators(kernels, target, kept, lane);
  device_jobs_.upload(jobs_, lane);
  templates_.resize(kernels.stored_floats);
  on_device("correlation", [&] {
    set_arguments(kernels.templates, reference.pixels, reference.width_px, reference.height_px,
                  device_jobs_.cl(), 1, templates_.cl());
    launch_items(*device_, lane, kernels.templates, 1);
    const cl::CommandQueue& queue = device_->queue(lane);
    const auto pixels =
        static_cast<std::size_t>(target.width_px) * static_cast<std::size_t>(target.height_px);
    const Mapped<const float> taps(queue, templates_.cl(), CL_MAP_READ, kernels.stored_floats);
    FrequencyJob job;
    job.taps = taps.data();
    job.taps_pitch = divide_up(kernels.width, lanes_) * lanes_;
    // SUM_AT of ncc_common.cl: there is no template, and so no score.
    if (std::isnan(taps.data()[kernels.height * job.taps_pitch])) return;
    const Mapped<const unsigned char> image(
        queue, target.pixels, CL_MAP_READ,
        pixels * (target.format == PixelFormat::grey8 ? 1 : sizeof(float)));
    const Mapped<const float> means(queue, kept.means.cl(), CL_MAP_READ, pixels);
    const Mapped<const float> inverses(queue, kept.inverses.cl(), CL_MAP_READ, pixels);
    const Mapped<float> scores(queue, map.cl(), CL_MAP_WRITE, map.size());
    job.target = image.data();
    job.format = target.format;
    job.target_width_px = target.width_px;
    job.means = means.data();
    job.inverses = inverses.data();
    job.template_width_px = kernels.width;
    job.template_height_px = kernels.height;
    job.x_px = jobs_[0].x;
    job.y_px = jobs_[0].y;
    job.width_px = jobs_[0].width;
    job.height_px = jobs_[0].height;
    job.threads = std::max(device_->info().compute_units, 1);
    piece_list_.clear();
    for (const CandidateBox& box : score_by_frequency(job, scores.data()))
      piece_list_.push_back({0, box.x_px, box.y_px, box.width_px, box.height_px});
  });
}

// Measured once per device for the template's size, its weights and the format.
NccVariant NccMatcher::fastest_variant(const NccOptions& options, PixelFormat format, Lane lane) {
  const bool grey = format == PixelFormat::grey8;
  const int height = options.height_px();
  if (options.template_px * height < kLeastFrequencyArea) return NccVariant::by_device;
  const std::string key = fmt::format(
      "dense correlation 2: {}x{} {} {}, {} lanes{}{}", options.template_px, height,
      options.weights == NccWeights::uniform ? "uniform" : "weighted", grey ? "grey8" : "float32",
      lanes_, extra_options_.empty() ? "" : ", ", extra_options_);
  if (const auto found = fastest_.find(key); found != fastest_.end()) return found->second;

  constexpr std::array kWays{std::pair{"space", NccVariant::by_device},
                             std::pair{"frequency", NccVariant::frequency}};
  std::optional<DeviceImage> image;  // uploaded if anything is measured
  NccScores scores(device_);
  std::vector<Tuning::Candidate> candidates;
  for (const auto& [name, variant] : kWays) {
    candidates.push_back(
        {name, [&, variant = variant] {
           if (!image)
             image = grey ? upload(*device_, sample_image<std::uint8_t>(), lane)
                          : upload(*device_, sample_image<float>(), lane);
           // Of an image that is new, denominators included.
           for (Denominators& kept : denominators_)
             if (kept.image == image->id) kept.done.assign(kept.done.size(), false);
           NccJob job;
           job.template_x_px = job.window_x_px = job.radius_x_px = image->width_px / 2;
           job.template_y_px = job.window_y_px = job.radius_y_px = image->height_px / 2;
           DeviceJob placed{};
           CORVID_CHECK(
               place(job, *image, *image, checked_kernels(*image, options, variant), placed),
               "the sample image holds the template");
           score_as(variant, *image, *image, placed, options, scores, lane);
         }});
  }
  const auto sources = program_id(kCpuProgram);
  const std::string name =
      device_->tuning().choose(key, sources ? *sources : std::string(), candidates);
  if (image) denominators_.remove_if([&](const Denominators& d) { return d.image == image->id; });
  NccVariant fastest = NccVariant::by_device;
  for (const auto& [candidate, variant] : kWays)
    if (candidate == name) fastest = variant;
  return fastest_[key] = fastest;
}

}  // namespace corvid
