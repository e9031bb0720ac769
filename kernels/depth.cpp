#include "kernels/depth.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "kernels/launch.h"
#include "kernels/program.h"

namespace corvid {
namespace {

constexpr int kPadding = 16;   // PAD of depth.cl
constexpr int kBandRows = 16;  ///< of a refinement launch on a CPU
constexpr int kMaxTemplate_px = 2 * kPadding - 1;

int round_up(int n, int step) { return (n + step - 1) / step * step; }
int row_length(int width_px) { return round_up(width_px, kPadding); }
int pitch_of(int width_px) { return row_length(width_px) + 2 * kPadding; }

std::size_t area(int width, int height) {
  return static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
}

/// A decimal literal that a C compiler reads back as the same float, whatever the locale.
std::string literal(double value) {
  const std::string digits = std::to_string(std::llround(value * 1e9));
  return digits + "e-9f";
}

std::string weight_list(int side) {
  const double sigma = side / 6.0;
  std::vector<double> w;
  double sum = 0;
  for (int i = 0; i < side; ++i) {
    const double d = (i - side / 2) / sigma;
    w.push_back(std::exp(-0.5 * d * d));
    sum += w.back();
  }
  std::string out;
  for (int i = 0; i < side; ++i) {
    out += (i ? "," : "") + literal(w[static_cast<std::size_t>(i)] / sum);
  }
  return out;
}

/// A (row by row) and b of depth.cl: x' ~ A (x, y, 1)' + b r.
void append_geometry(const Camera& reference, const SweepNeighbour& neighbour,
                     std::vector<float>& out) {
  const Eigen::Matrix3d K = neighbour.camera.K();
  const Eigen::Matrix3d A = K * neighbour.T_neighbour_reference.R() * reference.K().inverse();
  const Eigen::Vector3d b = K * neighbour.T_neighbour_reference.translation();
  for (int i = 0; i < 9; ++i) out.push_back(static_cast<float>(A(i / 3, i % 3)));
  for (int i = 0; i < 3; ++i) out.push_back(static_cast<float>(b(i)));
}

/// One work-item per group of pixels. Few work-group shapes: PoCL compiles a kernel again for each.
void launch(const Device& device, Lane lane, const cl::Kernel& kernel, int groups, int rows,
            int planes = 1, int first_row = 0) {
  const int x = device.info().gpu ? 32 : 8, y = device.info().gpu ? 8 : 1;
  const auto size = [](int n) { return static_cast<cl::size_type>(n); };
  device.queue(lane).enqueueNDRangeKernel(
      kernel, cl::NDRange(0, size(first_row), 0),
      cl::NDRange(size(round_up(groups, x)), size(round_up(rows, y)), size(planes)),
      cl::NDRange(size(x), size(y), 1));
}

}  // namespace

Expected<DepthSweeper> DepthSweeper::create(std::shared_ptr<Device> device,
                                            const DepthSweepOptions& options,
                                            const std::string& extra_options) {
  if (options.template_px < 3 || options.template_px > kMaxTemplate_px ||
      options.template_px % 2 == 0 || options.min_views < 1 || !(options.min_score > 0) ||
      !(options.min_score < 1) || !(options.min_variance > 0) ||
      (options.vector_px != 0 && options.vector_px != 1 && options.vector_px != kPadding)) {
    return fail(ErrorCode::invalid_argument, "depth options are out of range", "mapping",
                "template_px odd from 3 to 31, min_score between 0 and 1, min_views at least 1, "
                "vector_px 0, 1 or 16");
  }
  const int vector = options.vector_px > 0 ? options.vector_px : device->info().gpu ? 1 : kPadding;
  const std::string build =
      "-DVEC=" + std::to_string(vector) + " -DRADIUS=" + std::to_string(options.template_px / 2) +
      " -DPAD=" + std::to_string(kPadding) + " -DWEIGHTS=" + weight_list(options.template_px) +
      " -DMIN_SCORE=" + literal(options.min_score) +
      " -DMIN_VIEWS=" + std::to_string(options.min_views) +
      " -DMIN_VARIANCE=" + literal(options.min_variance) + " " + extra_options;
  const auto program = build_program(*device, "depth", build);
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device, [&] {
    const auto kernel = [&](const char* name) { return cl::Kernel(*program, name); };
    DepthSweeper sweeper(device, options,
                         Kernels{kernel("shrink"), kernel("reference_sums"), kernel("warp_planes"),
                                 kernel("sum_rows"), kernel("score_planes"), kernel("find_peaks"),
                                 kernel("refine")});
    sweeper.vector_ = vector;
    // A CPU's caches hold one sample of all neighbours; a GPU wants many work-items per launch.
    sweeper.slice_ = device->info().gpu ? 8 : 1;
    return sweeper;
  });
}

DepthSweeper::DepthSweeper(std::shared_ptr<Device> device, const DepthSweepOptions& options,
                           Kernels kernels)
    : device_(std::move(device)),
      options_(options),
      kernels_(std::move(kernels)),
      images_(device_),
      geometry_(device_),
      s1_(device_),
      s2_(device_),
      warped_(device_),
      sums_(device_),
      inverse_(device_),
      score_(device_),
      lead_(device_),
      inverse_next_(device_),
      score_next_(device_),
      volume_(device_) {}

void DepthSweeper::fill(Buffer<float>& buffer, std::size_t size, float value, Lane lane) {
  buffer.resize(size);
  device_->queue(lane).enqueueFillBuffer(buffer.cl(), value, 0, size * sizeof(float));
}

Camera DepthSweeper::scaled(const Camera& camera, int scale) {
  Camera out = camera;
  out.width_px = camera.width_px / scale;
  out.height_px = camera.height_px / scale;
  out.fx_px = camera.fx_px / scale;
  out.fy_px = camera.fy_px / scale;
  out.cx_px = (camera.cx_px + 0.5) / scale - 0.5;
  out.cy_px = (camera.cy_px + 0.5) / scale - 0.5;
  return out;
}

SweepImage DepthSweeper::prepare(const DeviceImage& image, int scale, Lane lane) {
  CORVID_CHECK(scale >= 1 && image.width_px >= scale && image.height_px >= scale,
               "image is smaller than one ray's block");
  return on_device("prepare image for depth", [&] {
    SweepImage out;
    out.width_px = image.width_px / scale;
    out.height_px = image.height_px / scale;
    const int pitch = pitch_of(out.width_px);
    const std::size_t bytes = area(pitch, out.height_px) * sizeof(float);
    out.pixels = cl::Buffer(device_->context(), CL_MEM_READ_WRITE, bytes);
    const cl::CommandQueue& queue = device_->queue(lane);
    queue.enqueueFillBuffer(out.pixels, 0.0F, 0, bytes);
    set_arguments(kernels_.shrink, image.pixels, image.width_px, scale, out.pixels, out.width_px,
                  out.height_px, pitch);
    launch_rows(*device_, lane, kernels_.shrink, out.width_px, out.height_px);
    queue.finish();
    return out;
  });
}

SweepResult DepthSweeper::estimate(const SweepRequest& request, Lane lane) {
  CORVID_CHECK(request.reference, "a reference image is needed");
  const int width = request.reference->width_px, height = request.reference->height_px;
  const int m = static_cast<int>(request.neighbours.size());
  CORVID_CHECK(width >= options_.template_px && height >= options_.template_px,
               "image is smaller than the template");
  CORVID_CHECK(request.samples >= 3 && request.samples <= 4096, "3 to 4096 depth samples");
  CORVID_CHECK(request.near > 0 && request.near < request.far && std::isfinite(request.far),
               "0 < near < far");
  SweepResult result{FloatImage(width, height), FloatImage(width, height),
                     FloatImage(width, height)};
  if (m < options_.min_views) return result;

  const int pitch = pitch_of(width), row = row_length(width);
  const std::size_t image_size = area(pitch, height);
  const std::size_t sums_size = area(row, height + options_.template_px - 1);
  const double inverse_far = 1 / request.far;
  const double inverse_step = (1 / request.near - inverse_far) / (request.samples - 1);
  const auto far = static_cast<float>(inverse_far), step = static_cast<float>(inverse_step);
  std::vector<float> geometry;
  for (const SweepNeighbour& n : request.neighbours) {
    CORVID_CHECK(n.image && n.image->width_px == width && n.image->height_px == height,
                 "neighbours must have the reference's size");
    append_geometry(request.camera, n, geometry);
  }

  on_device("depth", [&] {
    const cl::CommandQueue& queue = device_->queue(lane);
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const auto planes = static_cast<std::size_t>(slice_ * m);
    geometry_.upload(geometry, lane);
    images_.resize(image_size * static_cast<std::size_t>(m));
    for (std::size_t i = 0; i < static_cast<std::size_t>(m); ++i) {
      queue.enqueueCopyBuffer(request.neighbours[i].image->pixels, images_.cl(), 0,
                              i * image_size * sizeof(float), image_size * sizeof(float));
    }
    fill(s1_, area(row, height), nan, lane);
    fill(s2_, area(row, height), nan, lane);
    fill(warped_, image_size * planes, nan, lane);
    fill(sums_, 3 * sums_size * planes, nan, lane);
    for (Buffer<float>* out : {&inverse_, &score_, &lead_, &inverse_next_, &score_next_}) {
      fill(*out, image_size, 0, lane);
    }
    volume_.resize(area(row, height) * static_cast<std::size_t>(request.samples));

    const int groups = row / vector_;
    const cl::Buffer& reference = request.reference->pixels;
    set_arguments(kernels_.reference_sums, reference, width, height, pitch, row, s1_.cl(),
                  s2_.cl());
    launch_rows(*device_, lane, kernels_.reference_sums, width, height);
    for (int first = 0; first < request.samples; first += slice_) {
      const int n = std::min(slice_, request.samples - first);
      set_arguments(kernels_.warp_planes, images_.cl(), m, width, height, pitch, row,
                    geometry_.cl(), far, step, first, warped_.cl());
      launch(*device_, lane, kernels_.warp_planes, groups, height, n * m);
      set_arguments(kernels_.sum_rows, reference, warped_.cl(), height, pitch, row, sums_.cl());
      launch(*device_, lane, kernels_.sum_rows, groups, height, n * m);
      set_arguments(kernels_.score_planes, sums_.cl(), s1_.cl(), s2_.cl(), m, height, row, first,
                    volume_.cl());
      launch(*device_, lane, kernels_.score_planes, groups, height, n);
      // One slice at a time: the device is free for tracking in between.
      queue.finish();
    }
    set_arguments(kernels_.find_peaks, volume_.cl(), request.samples, height, row, pitch, far, step,
                  inverse_.cl(), score_.cl(), lead_.cl());
    launch(*device_, lane, kernels_.find_peaks, groups, height);
    float h = 1;
    for (int pass = 0; pass < request.refinements; ++pass, h *= 0.5F) {
      set_arguments(kernels_.refine, reference, images_.cl(), m, width, height, pitch, row,
                    geometry_.cl(), step, h, inverse_.cl(), score_.cl(), inverse_next_.cl(),
                    score_next_.cl());
      // On a CPU in bands of rows, so that no launch holds the device for long.
      const int band = device_->info().gpu ? height : kBandRows;
      for (int row_0 = 0; row_0 < height; row_0 += band) {
        launch(*device_, lane, kernels_.refine, groups, std::min(band, height - row_0), 1, row_0);
        queue.finish();
      }
      std::swap(inverse_, inverse_next_);
      std::swap(score_, score_next_);
    }
  });

  std::vector<float> inverse(image_size), score(image_size), lead(image_size);
  inverse_.download(inverse, 0, lane);
  score_.download(score, 0, lane);
  lead_.download(lead, 0, lane);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const std::size_t at = area(pitch, y) + static_cast<std::size_t>(kPadding + x);
      if (!(inverse[at] > 0) || !(score[at] > 0)) continue;
      result.depth(x, y) = 1 / inverse[at];
      result.confidence(x, y) = std::min(score[at], 1.0F);
      result.lead(x, y) = lead[at];
    }
  }
  return result;
}

}  // namespace corvid
