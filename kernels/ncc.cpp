#include "kernels/ncc.h"

#include <fmt/core.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <optional>
#include <utility>

#include "kernels/launch.h"
#include "kernels/program.h"

namespace corvid {
namespace {

constexpr int kBoxRows = 32;  // BOX_ROWS of ncc_score.cl, SCORED_H of ncc_group.cl
// Candidates of a piece, and candidate rows that a work-item does together: a strip of an image on
// a CPU, whose cache holds its coefficients; a square in a GPU's local memory.
struct PieceSize {
  int width, height, rows;
};
constexpr PieceSize kCpuPiece{704, 32, 4}, kGroupPiece{30, 30, 8};
// Work-items of a group: SCORED_W * GROUP_ROWS of ncc_group.cl.
constexpr int kGroup = (kGroupPiece.width + 2) * (kGroupPiece.height + 2) / kGroupPiece.rows;
constexpr std::size_t kKeptDenominators = 8;
constexpr std::size_t kKeptDenominatorBytes = std::size_t{192} << 20;

std::optional<Error> check_options(const NccOptions& options) {
  const auto error = [](std::string what) {
    return Error{ErrorCode::invalid_argument, std::move(what), "NccOptions", {}};
  };
  for (const auto& [name, side] :
       {std::pair{"template_px", options.template_px}, {"template_height_px", options.height_px()}})
    if (side < 3 || side > 31 || side % 2 == 0)
      return error(fmt::format("{} is {}: an odd number from 3 to 31 is wanted", name, side));
  if (!(options.peak_quality >= 0 && options.peak_quality <= 1))
    return error("peak_quality must be in [0, 1]");
  if (options.align_iterations < 0) return error("align_iterations must not be negative");
  if (options.weights == NccWeights::separable) {
    for (const auto& [name, list, side] :
         {std::tuple{"weights_x", &options.weights_x, options.template_px},
          {"weights_y", &options.weights_y, options.height_px()}}) {
      if (static_cast<int>(list->size()) != side)
        return error(
            fmt::format("{} has {} numbers: the template has {}", name, list->size(), side));
      // A ratio that single precision holds.
      const auto [least, most] = std::minmax_element(list->begin(), list->end());
      if (!std::all_of(list->begin(), list->end(), [](double w) { return std::isfinite(w); }) ||
          !(*least > 0 && *most < 1e6 * *least))
        return error(fmt::format("{} must be positive and within a factor of 1e6", name));
    }
  }
  return std::nullopt;
}

// 1-d weights of sum 1, as a compiler option.
std::string weight_list(NccWeights kind, int side, const std::vector<double>& given) {
  std::vector<double> weights(static_cast<std::size_t>(side), 1.0);
  const double sigma = side / 6.0;
  double sum = 0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const double r = static_cast<double>(i) - side / 2;
    if (kind == NccWeights::gaussian) weights[i] = std::exp(-0.5 * r * r / (sigma * sigma));
    if (kind == NccWeights::separable)
      weights[i] = given[i] / *std::max_element(given.begin(), given.end());
    sum += weights[i];
  }
  for (double& w : weights) w /= sum;
  return fmt::format("{:.9e}f", fmt::join(weights, "f,"));
}

int vector_lanes(const Device& device, bool groups) {
  if (groups) return 4;
  const cl_uint native = device.device().getInfo<CL_DEVICE_NATIVE_VECTOR_WIDTH_INT>();
  return native >= 16 ? 16 : native >= 8 ? 8 : 4;
}

constexpr bool multiplies_pairs() {
#if defined(__x86_64__)
  return true;  // pmaddwd
#else
  return false;
#endif
}

}  // namespace

FloatImage NccScores::download(Lane lane) const {
  if (width_px == 0 || height_px == 0) return {};
  FloatImage out(width_px, height_px);
  scores.download({out.data(), out.size()}, 0, lane);
  return out;
}

NccMatcher::NccMatcher(std::shared_ptr<Device> device, std::string extra_options,
                       NccVariant variant)
    : device_(std::move(device)),
      extra_options_(std::move(extra_options)),
      variant_(variant),
      groups_(variant == NccVariant::by_device ? device_->info().gpu
                                               : variant == NccVariant::group),
      lanes_(vector_lanes(*device_, groups_)),
      device_jobs_(device_),
      device_pieces_(device_),
      device_maxima_(device_),
      templates_(device_),
      device_tiles_(device_),
      device_results_(device_) {}

Expected<NccMatcher> NccMatcher::create(std::shared_ptr<Device> device, std::string extra_options,
                                        NccVariant variant) {
  NccMatcher matcher(std::move(device), std::move(extra_options), variant);
  if (auto ready = matcher.prepare({}); !ready) return tl::unexpected(ready.error());
  return matcher;
}

Expected<NccMatcher::Kernels*> NccMatcher::kernels(const NccOptions& options, PixelFormat format,
                                                   NccVariant variant) {
  if (auto error = check_options(options)) return tl::unexpected(std::move(*error));
  const int width = options.template_px, height = options.height_px();
  const bool uniform = options.weights == NccWeights::uniform;
  const bool floats = format == PixelFormat::float32;
  // With other weights 16 bits are not enough for the taps at the template's border.
  const bool integer = !floats && uniform &&
                       (variant == NccVariant::by_device || variant == NccVariant::frequency
                            ? !groups_ && multiplies_pairs()
                            : variant == NccVariant::integer);
  const PieceSize piece = groups_ ? kGroupPiece : kCpuPiece;
  const std::string key = fmt::format(
      "-DTW={} -DTH={} -DWEIGHTS_X={} -DWEIGHTS_Y={} -DLANES={} -DROWS={} -DPIECE_W={} "
      "-DPIECE_H={}{}{}{}{}{}",
      width, height, weight_list(options.weights, width, options.weights_x),
      weight_list(options.weights, height, options.weights_y), lanes_, piece.rows, piece.width,
      piece.height, uniform ? " -DUNIFORM" : "", floats ? " -DFLOAT_IMAGE" : "",
      integer ? " -DINTEGER" : "", extra_options_.empty() ? "" : " ", extra_options_);
  if (const auto found = kernels_.find(key); found != kernels_.end()) return &found->second;
  const auto program = build_program(*device_, groups_ ? kGpuProgram : kCpuProgram, key);
  if (!program) return tl::unexpected(program.error());
  const auto count = [](int n) { return static_cast<std::size_t>(n); };
  // STORED of ncc_common.cl.
  const std::size_t stored = count(height) * count(divide_up(width, lanes_) * lanes_) + 2 +
                             count(height) * count(integer ? (width + 1) / 2 : width);
  return opening_on_device(*device_, [&] {
    const auto kernel = [&](const char* name) { return cl::Kernel(*program, name); };
    return &kernels_
                .emplace(key, Kernels{width, height, integer, stored, kernel("templates"),
                                      kernel("denominators"), kernel("pieces"), kernel("finish")})
                .first->second;
  });
}

Expected<void> NccMatcher::prepare(const NccOptions& options, PixelFormat format) {
  const auto ready = kernels(options, format, variant_);
  if (!ready) return tl::unexpected(ready.error());
  // Drivers compile for a launch shape at its first use: not in front of the first frame.
  const auto warm = opening_on_device(*device_, [&] {
    const DeviceImage image = format == PixelFormat::grey8 ? upload(*device_, GreyImage(96, 96))
                                                           : upload(*device_, FloatImage(96, 96));
    NccJob job;
    job.template_x_px = job.template_y_px = 48;
    job.window_x_px = job.window_y_px = 48;
    job.radius_x_px = job.radius_y_px = 4;
    (void)match(image, image, std::vector(60, job), options);
    return true;
  });
  if (!warm) return tl::unexpected(warm.error());
  return {};
}

bool NccMatcher::place(const NccJob& job, const DeviceImage& reference, const DeviceImage& target,
                       const Kernels& kernels, DeviceJob& out) {
  const int half_x = kernels.width / 2, half_y = kernels.height / 2;
  const double cx = job.template_x_px, cy = job.template_y_px;
  // The footprint is a parallelogram: it lies in the image if its corners do. False for NaN.
  const double reach_x =
      half_x * std::abs(double{job.warp[0]}) + half_y * std::abs(double{job.warp[1]});
  const double reach_y =
      half_x * std::abs(double{job.warp[2]}) + half_y * std::abs(double{job.warp[3]});
  if (!(cx - reach_x >= 0 && cx + reach_x <= reference.width_px - 1 && cy - reach_y >= 0 &&
        cy + reach_y <= reference.height_px - 1))
    return false;
  if (job.radius_x_px < 0 || job.radius_y_px < 0) return false;
  const auto clip = [&](std::int64_t centre, std::int64_t radius, int size, int half,
                        std::int32_t& first, std::int32_t& count) {
    const std::int64_t low = std::max<std::int64_t>(centre - radius, half);
    const std::int64_t high = std::min<std::int64_t>(centre + radius, size - 1 - half);
    if (high < low) return false;
    first = static_cast<std::int32_t>(low);
    count = static_cast<std::int32_t>(high - low + 1);
    return true;
  };
  if (!clip(job.window_x_px, job.radius_x_px, target.width_px, half_x, out.x, out.width) ||
      !clip(job.window_y_px, job.radius_y_px, target.height_px, half_y, out.y, out.height))
    return false;
  if (std::int64_t{out.width} * out.height > std::numeric_limits<std::int32_t>::max())
    throw DeviceFault("a search window has too many candidates", CL_INVALID_BUFFER_SIZE);
  out.reference_x = static_cast<std::int32_t>(std::floor(cx));
  out.reference_y = static_cast<std::int32_t>(std::floor(cy));
  out.fraction_x = static_cast<float>(cx - out.reference_x);
  out.fraction_y = static_cast<float>(cy - out.reference_y);
  std::copy_n(job.warp, 4, out.warp);
  out.flat = (job.radius_y_px == 0 ? 1 : 0) | (job.radius_x_px == 0 ? 2 : 0);
  return true;
}

// Cuts the job into pieces of nearly equal size.
void NccMatcher::add_job(DeviceJob job) {
  const PieceSize most = groups_ ? kGroupPiece : kCpuPiece;
  const int across = divide_up(job.width, most.width), down = divide_up(job.height, most.height);
  const int width = divide_up(job.width, across), height = divide_up(job.height, down);
  job.first_piece = static_cast<std::int32_t>(piece_list_.size());
  const auto index = static_cast<std::int32_t>(jobs_.size());
  for (int y = 0; y < job.height; y += height)
    for (int x = 0; x < job.width; x += width)
      piece_list_.push_back(
          {index, x, y, std::min(width, job.width - x), std::min(height, job.height - y)});
  job.pieces = static_cast<std::int32_t>(piece_list_.size()) - job.first_piece;
  jobs_.push_back(job);
}

NccMatcher::Kernels& NccMatcher::checked_kernels(const DeviceImage& target,
                                                 const NccOptions& options, NccVariant variant) {
  const auto ready = kernels(options, target.format, variant);
  if (!ready) {
    CORVID_CHECK(ready.error().code == ErrorCode::device, ready.error().to_string());
    throw DeviceFault(ready.error().to_string(), CL_BUILD_PROGRAM_FAILURE);
  }
  return **ready;
}

std::vector<NccResult> NccMatcher::match(const DeviceImage& reference, const DeviceImage& target,
                                         std::span<const NccJob> jobs, const NccOptions& options,
                                         Lane lane) {
  const NccBatch batch{&reference, jobs};
  return match(std::span(&batch, 1), target, options, lane);
}

std::vector<NccResult> NccMatcher::match(std::span<const NccBatch> batches,
                                         const DeviceImage& target, const NccOptions& options,
                                         Lane lane) {
  for (const NccBatch& batch : batches)
    CORVID_CHECK(batch.reference->format == target.format,
                 "images to correlate have one pixel format");
  Kernels& kernels = checked_kernels(target, options, variant_);
  std::size_t count = 0;
  for (const NccBatch& batch : batches) count += batch.jobs.size();
  std::vector<NccResult> results(count);
  const PieceSize most = groups_ ? kGroupPiece : kCpuPiece;
  const std::size_t job_bytes =
      sizeof(DeviceJob) + sizeof(NccResult) + kernels.stored_floats * sizeof(float);
  const std::size_t piece_bytes = sizeof(Piece) + sizeof(Maxima);

  std::vector<std::size_t> slots;  // of the jobs in `results`
  std::vector<Templates> templates;
  const auto flush = [&] {
    if (slots.empty()) return;
    run_batch(kernels, templates, target, options, nullptr, lane);
    for (std::size_t i = 0; i < slots.size(); ++i) results[slots[i]] = results_[i];
    slots.clear();
    templates.clear();
    jobs_.clear();
    piece_list_.clear();
  };
  jobs_.clear();
  piece_list_.clear();
  std::size_t slot = 0;
  for (const NccBatch& batch : batches)
    for (const NccJob& job : batch.jobs) {
      const std::size_t mine = slot++;
      DeviceJob placed{};
      if (!place(job, *batch.reference, target, kernels, placed)) continue;
      const std::size_t new_pieces =
          static_cast<std::size_t>(divide_up(placed.width, most.width)) *
          static_cast<std::size_t>(divide_up(placed.height, most.height));
      if ((jobs_.size() + 1) * job_bytes + (piece_list_.size() + new_pieces) * piece_bytes >
          options.memory_budget_bytes)
        flush();
      if (templates.empty() || templates.back().reference != batch.reference)
        templates.push_back({batch.reference, jobs_.size(), jobs_.size()});
      add_job(placed);
      templates.back().end = jobs_.size();
      slots.push_back(mine);
    }
  flush();
  return results;
}

NccMatcher::Denominators& NccMatcher::denominators(const Kernels& kernels,
                                                   const DeviceImage& target) {
  const auto found = std::find_if(denominators_.begin(), denominators_.end(), [&](const auto& d) {
    return d.image == target.id && d.kernels == &kernels;
  });
  if (found != denominators_.end()) {
    denominators_.splice(denominators_.begin(), denominators_, found);
    return denominators_.front();
  }
  const int tiles =
      divide_up(target.width_px, box_columns()) * divide_up(target.height_px, kBoxRows);
  // The oldest gives its memory to the new one.
  if (denominators_.size() < kKeptDenominators)
    denominators_.push_front({0, nullptr, Buffer<float>(device_), Buffer<float>(device_), {}});
  else
    denominators_.splice(denominators_.begin(), denominators_, std::prev(denominators_.end()));
  denominators_.front().image = target.id;
  denominators_.front().kernels = &kernels;
  denominators_.front().done.assign(static_cast<std::size_t>(tiles), false);
  std::size_t bytes = 0;
  for (auto d = denominators_.begin(); d != denominators_.end(); ++d) {
    bytes += 2 * sizeof(float) * d->means.capacity();
    if (bytes > kKeptDenominatorBytes && d != denominators_.begin()) {
      denominators_.erase(d, denominators_.end());
      break;
    }
  }
  return denominators_.front();
}

// Completes the kept denominators where the jobs need them.
void NccMatcher::complete_denominators(Kernels& kernels, const DeviceImage& target,
                                       Denominators& kept, Lane lane) {
  const int tile_width = box_columns();
  const int first_x = kernels.width / 2, first_y = kernels.height / 2;
  const int tiles_x = divide_up(target.width_px - 2 * first_x, tile_width);
  std::vector<std::int32_t> missing;
  std::vector<bool> done = kept.done;
  for (const DeviceJob& job : jobs_) {
    const int right = (job.x + job.width - 1 - first_x) / tile_width;
    const int bottom = (job.y + job.height - 1 - first_y) / kBoxRows;
    for (int y = (job.y - first_y) / kBoxRows; y <= bottom; ++y)
      for (int x = (job.x - first_x) / tile_width; x <= right; ++x) {
        const int tile = y * tiles_x + x;
        if (done[static_cast<std::size_t>(tile)]) continue;
        done[static_cast<std::size_t>(tile)] = true;
        missing.push_back(tile);
      }
  }
  if (missing.empty()) return;
  // Whole vectors are read: past the image's last pixel too.
  const std::size_t floats =
      static_cast<std::size_t>(target.width_px) * static_cast<std::size_t>(target.height_px) +
      DeviceImage::kImagePadding;
  kept.means.resize(floats);
  kept.inverses.resize(floats);
  device_tiles_.upload(missing, lane);
  on_device("correlation", [&] {
    set_arguments(kernels.denominators, target.pixels, target.width_px, target.height_px, tiles_x,
                  device_tiles_.cl(), static_cast<cl_int>(missing.size()), kept.means.cl(),
                  kept.inverses.cl());
    launch(kernels.denominators, static_cast<int>(missing.size()), lane);
  });
  kept.done = std::move(done);  // only now: any of the above may have failed
}

// Coefficients of the largest piece: a rim of one candidate and whole blocks; vectors are read from
// one lane before the first.
std::size_t NccMatcher::scratch_floats() const {
  const int block = 2 * lanes_;
  int most = 0;
  for (const Piece& piece : piece_list_)
    most =
        std::max(most, divide_up(piece.width + 2, block) * block * (piece.height + 2) + 2 * block);
  return static_cast<std::size_t>(most);
}

// Tiles or pieces: one per work-group of many on a GPU, one per work-item on a CPU.
void NccMatcher::launch(const cl::Kernel& kernel, int count, Lane lane) const {
  const auto group = static_cast<cl::size_type>(groups_ ? kGroup : 1);
  device_->queue(lane).enqueueNDRangeKernel(kernel, cl::NullRange,
                                            cl::NDRange(static_cast<cl::size_type>(count) * group),
                                            cl::NDRange(group));
}

void NccMatcher::run_batch(Kernels& kernels, std::span<const Templates> templates,
                           const DeviceImage& target, const NccOptions& options, Buffer<float>* map,
                           Lane lane) {
  const int count = static_cast<int>(jobs_.size()), pieces = static_cast<int>(piece_list_.size());
  const auto quality = static_cast<float>(options.peak_quality);
  Denominators* const kept = kernels.fused_box ? nullptr : &denominators(kernels, target);
  if (kept != nullptr) complete_denominators(kernels, target, *kept, lane);
  device_jobs_.upload(jobs_, lane);
  device_pieces_.upload(piece_list_, lane);
  templates_.resize(jobs_.size() * kernels.stored_floats);
  device_maxima_.resize(piece_list_.size());
  device_results_.resize(jobs_.size());
  results_.resize(jobs_.size());
  on_device("correlation", [&] {
    for (const Templates& t : templates) {
      set_arguments(kernels.templates, t.reference->pixels, t.reference->width_px,
                    t.reference->height_px, device_jobs_.cl(), static_cast<cl_int>(t.end),
                    templates_.cl());
      launch_items(*device_, lane, kernels.templates, static_cast<int>(t.end - t.first), t.first);
    }
    const auto arguments = [&](const auto&... scratch) {
      set_arguments(kernels.pieces, target.pixels, target.width_px, device_jobs_.cl(),
                    device_pieces_.cl(), pieces, templates_.cl(),
                    kept != nullptr ? kept->means.cl() : templates_.cl(),
                    kept != nullptr ? kept->inverses.cl() : templates_.cl(), scratch..., quality,
                    map != nullptr ? 1 : 0, map != nullptr ? map->cl() : templates_.cl(),
                    device_maxima_.cl());
    };
    if (groups_)
      arguments();
    else
      arguments(cl::Local(scratch_floats() * sizeof(float)));
    launch(kernels.pieces, pieces, lane);
    if (map != nullptr) {
      device_->queue(lane).finish();
      return;
    }
    set_arguments(kernels.finish, target.pixels, target.width_px, target.height_px,
                  device_jobs_.cl(), count, templates_.cl(), device_maxima_.cl(), quality,
                  options.align_iterations, device_results_.cl());
    launch_items(*device_, lane, kernels.finish, count);
  });
  if (map == nullptr) device_results_.download(results_, 0, lane);
}

}  // namespace corvid
