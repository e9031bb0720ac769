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

constexpr int kPadding = 16;  // PAD of depth.cl
constexpr int kStrip = 160;   // STRIP * VEC of depth.cl
constexpr int kTileX = 32, kTileY = 8;
/// Scores of a launch on a CPU, so that the device is free for tracking every few milliseconds.
constexpr double kSliceScores = 1e6;
constexpr double kNarrowSigma_px = 1;  ///< of the templates that decide at edges
/// Of answers to the plane that is fitted to them [samples], before and after the first pass.
constexpr float kFirstTolerance = 3, kTolerance = 1;
constexpr int kFirstReach = 3;  ///< samples to either side in the first pass around the surface
constexpr int kMaxTemplate_px = 2 * kPadding - 1;

/// The layers of a sweep at half the resolution.
int coarse_samples(int samples) { return std::max(3, (samples + 1) / 2); }

int round_up(int n, int step) { return (n + step - 1) / step * step; }
int row_length(int width_px) { return round_up(width_px, kPadding); }
int pitch_of(int width_px) { return row_length(width_px) + 3 * kPadding; }

std::size_t area(int width, int height) {
  return static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
}

/// A decimal literal that a C compiler reads back as the same float, whatever the locale.
std::string literal(double value) {
  const std::string digits = std::to_string(std::llround(value * 1e9));
  return digits + "e-9f";
}

std::vector<float> gaussian(int side, double sigma) {
  std::vector<float> w;
  double sum = 0;
  const auto at = [&](int i) {
    return std::exp(-0.5 * (i - side / 2) * (i - side / 2) / (sigma * sigma));
  };
  for (int i = 0; i < side; ++i) sum += at(i);
  for (int i = 0; i < side; ++i) w.push_back(static_cast<float>(at(i) / sum));
  return w;
}

/// A (row by row) and b of depth.cl: x' ~ A (x, y, 1)' + b r.
void append_geometry(const Camera& reference, const Camera& neighbour,
                     const Pose& T_neighbour_reference, std::vector<float>& out) {
  const Eigen::Matrix3d K = neighbour.K();
  const Eigen::Matrix3d A = K * T_neighbour_reference.R() * reference.K().inverse();
  const Eigen::Vector3d b = K * T_neighbour_reference.translation();
  for (int i = 0; i < 9; ++i) out.push_back(static_cast<float>(A(i / 3, i % 3)));
  for (int i = 0; i < 3; ++i) out.push_back(static_cast<float>(b(i)));
}

/// One work-item per vector of pixels. Few work-group shapes: PoCL compiles a kernel again for
/// each.
void launch(const Device& device, Lane lane, const cl::Kernel& kernel, int vectors, int rows) {
  const int x = device.info().gpu ? 32 : 8, y = device.info().gpu ? 8 : 1;
  const auto size = [](int n) { return static_cast<cl::size_type>(n); };
  device.queue(lane).enqueueNDRangeKernel(
      kernel, cl::NullRange, cl::NDRange(size(round_up(vectors, x)), size(round_up(rows, y))),
      cl::NDRange(size(x), size(y)));
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
      " -DPAD=" + std::to_string(kPadding) + " -DMIN_SCORE=" + literal(options.min_score) +
      " -DMIN_VIEWS=" + std::to_string(options.min_views) +
      " -DMIN_VARIANCE=" + literal(options.min_variance) + " " + extra_options;
  const auto program = build_program(*device, "depth", build);
  if (!program) return tl::unexpected(program.error());
  return opening_on_device(*device, [&] {
    const auto kernel = [&](const char* name) { return cl::Kernel(*program, name); };
    DepthSweeper sweeper(
        device, options,
        Kernels{kernel("shrink"), kernel("reference_grey"), kernel("reference_sums"),
                kernel("sweep"), kernel("find_peaks"), kernel("fit_planes"), kernel("expand"),
                kernel("pick"), kernel("near_and_far"), kernel("choose_side")});
    sweeper.vector_ = vector;
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
      grey_(device_),
      mean_(device_),
      inverse_deviation_(device_),
      surface_(device_),
      slant_x_(device_),
      slant_y_(device_),
      inverse_(device_),
      score_(device_),
      lead_(device_),
      guess_(device_),
      support_(device_),
      fine_surface_(device_),
      fine_lead_(device_),
      near_(device_),
      far_(device_),
      near_inverse_(device_),
      near_score_(device_),
      far_inverse_(device_),
      far_score_(device_),
      weights_(device_),
      volume_(device_) {}

DepthSweeper::Grid DepthSweeper::grid_of(const SweepImage::Level& level) {
  return {level.width_px, level.height_px, row_length(level.width_px), pitch_of(level.width_px)};
}

std::size_t DepthSweeper::Grid::elements() const {
  // Vectors read past the last row.
  return area(pitch, height) + 4 * kPadding;
}

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

SweepImage::Level DepthSweeper::reduce(const DeviceImage& image, int scale, Lane lane) {
  SweepImage::Level out;
  out.width_px = image.width_px / scale;
  out.height_px = image.height_px / scale;
  const Grid grid = grid_of(out);
  out.quads = cl::Buffer(device_->context(), CL_MEM_READ_WRITE, grid.elements() * sizeof(cl_uint));
  set_arguments(kernels_.shrink, image.pixels, image.width_px, scale, out.quads, grid.width,
                grid.height, grid.pitch);
  launch_rows(*device_, lane, kernels_.shrink, grid.width, grid.height);
  return out;
}

SweepImage DepthSweeper::prepare(const DeviceImage& image, int scale, Lane lane) {
  CORVID_CHECK(scale >= 1 && image.width_px >= scale && image.height_px >= scale,
               "image is smaller than one ray's block");
  return on_device("prepare image for depth", [&] {
    SweepImage out;
    out.full = reduce(image, scale, lane);
    if (image.width_px >= 2 * scale && image.height_px >= 2 * scale) {
      out.half = reduce(image, 2 * scale, lane);
    }
    device_->queue(lane).finish();
    return out;
  });
}

void DepthSweeper::load(const SweepRequest& request, bool half, const Grid& grid, Lane lane) {
  const cl::CommandQueue& queue = device_->queue(lane);
  const auto level = [&](const SweepImage& image) { return half ? image.half : image.full; };
  const int scale = half ? 2 : 1;
  std::vector<float> geometry;
  images_.resize(area(grid.pitch, grid.height) * request.neighbours.size() + 4 * kPadding);
  std::size_t offset = 0;
  for (const SweepNeighbour& n : request.neighbours) {
    append_geometry(scaled(request.camera, scale), scaled(n.camera, scale), n.T_neighbour_reference,
                    geometry);
    const std::size_t bytes = area(grid.pitch, grid.height) * sizeof(cl_uint);
    queue.enqueueCopyBuffer(level(*n.image).quads, images_.cl(), 0, offset, bytes);
    offset += bytes;
  }
  geometry_.upload(geometry, lane);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (Buffer<float>* image : {&grey_, &mean_, &inverse_deviation_}) {
    fill(*image, grid.elements(), nan, lane);
  }
  for (Buffer<float>* image :
       {&surface_, &slant_x_, &slant_y_, &support_, &inverse_, &score_, &guess_}) {
    fill(*image, grid.elements(), 0, lane);
  }
  fill(lead_, grid.elements(), 1, lane);  // rows without whole windows know of no other peak
  set_arguments(kernels_.reference_grey, level(*request.reference).quads, grid.width, grid.height,
                grid.pitch, grey_.cl());
  launch_rows(*device_, lane, kernels_.reference_grey, grid.width, grid.height);
  set_weights(grid, options_.template_px / 6.0, lane);
}

void DepthSweeper::set_weights(const Grid& grid, double sigma_px, Lane lane) {
  weights_.upload(gaussian(options_.template_px, sigma_px), lane);
  set_arguments(kernels_.reference_sums, weights_.cl(), grey_.cl(), grid.width, grid.height,
                grid.pitch, grid.row, mean_.cl(), inverse_deviation_.cl());
  launch(*device_, lane, kernels_.reference_sums, grid.row / vector_, grid.height);
}

void DepthSweeper::mend_edges(const Grid& grid, int neighbours, double step, Lane lane) {
  fit_planes(grid, step, kTolerance, lane);
  for (Buffer<float>* image :
       {&near_, &far_, &near_inverse_, &near_score_, &far_inverse_, &far_score_}) {
    fill(*image, grid.elements(), 0, lane);
  }
  set_arguments(kernels_.near_and_far, grid.height, grid.pitch, grid.row, surface_.cl(),
                slant_x_.cl(), slant_y_.cl(), support_.cl(), near_.cl(), far_.cl());
  launch(*device_, lane, kernels_.near_and_far, grid.row / vector_, grid.height);
  set_weights(grid, kNarrowSigma_px, lane);
  pass(grid, neighbours, 1, 0.5 * step, near_, near_inverse_, near_score_, lane);
  pass(grid, neighbours, 1, 0.5 * step, far_, far_inverse_, far_score_, lane);
  set_arguments(kernels_.choose_side, grid.height, grid.pitch, grid.row, static_cast<float>(step),
                near_.cl(), far_.cl(), near_inverse_.cl(), near_score_.cl(), far_inverse_.cl(),
                far_score_.cl(), inverse_.cl(), score_.cl());
  launch(*device_, lane, kernels_.choose_side, grid.row / vector_, grid.height);
}

void DepthSweeper::sweep(const Grid& grid, int neighbours, Buffer<float>& surface, double inverse_0,
                         double step, int layers, Lane lane) {
  const cl::CommandQueue& queue = device_->queue(lane);
  volume_.resize(area(grid.row, grid.height) * static_cast<std::size_t>(layers * neighbours));
  const double scores = static_cast<double>(area(grid.width, grid.height)) * neighbours;
  scores_ += scores * layers;
  const int slice =
      device_->info().gpu ? layers : std::clamp(static_cast<int>(kSliceScores / scores), 1, layers);
  const auto size = [](int n) { return static_cast<cl::size_type>(n); };
  for (int first = 0; first < layers; first += slice) {
    set_arguments(kernels_.sweep, weights_.cl(), images_.cl(), grey_.cl(), mean_.cl(),
                  inverse_deviation_.cl(), neighbours, grid.width, grid.height, grid.pitch,
                  grid.row, geometry_.cl(), surface.cl(), static_cast<float>(inverse_0),
                  static_cast<float>(step), first, layers, volume_.cl());
    const int planes = std::min(slice, layers - first) * neighbours;
    if (vector_ == 1) {
      queue.enqueueNDRangeKernel(kernels_.sweep, cl::NullRange,
                                 cl::NDRange(size(round_up(grid.row, kTileX)),
                                             size(round_up(grid.height, kTileY)), size(planes)),
                                 cl::NDRange(kTileX, kTileY, 1));
    } else {
      queue.enqueueNDRangeKernel(kernels_.sweep, cl::NullRange,
                                 cl::NDRange(size(divide_up(grid.row, kStrip)), size(planes)),
                                 cl::NDRange(1, 1));
    }
    queue.finish();
  }
}

void DepthSweeper::find_peaks(const Grid& grid, int neighbours, double inverse_far, double step,
                              int samples, Lane lane) {
  set_arguments(kernels_.find_peaks, volume_.cl(), samples, neighbours, grid.height, grid.row,
                grid.pitch, static_cast<float>(inverse_far), static_cast<float>(step),
                inverse_.cl(), score_.cl(), lead_.cl(), guess_.cl());
  launch(*device_, lane, kernels_.find_peaks, grid.row / vector_, grid.height);
}

void DepthSweeper::fit_planes(const Grid& grid, double step, float tolerance, Lane lane) {
  set_arguments(kernels_.fit_planes, grid.height, grid.pitch, grid.row, static_cast<float>(step),
                tolerance, inverse_.cl(), score_.cl(), guess_.cl(), surface_.cl(), slant_x_.cl(),
                slant_y_.cl(), support_.cl());
  launch(*device_, lane, kernels_.fit_planes, grid.row / vector_, grid.height);
}

void DepthSweeper::expand(const Grid& coarse, const Grid& fine, Lane lane) {
  fill(fine_surface_, fine.elements(), 0, lane);
  fill(fine_lead_, fine.elements(), 0, lane);
  set_arguments(kernels_.expand, surface_.cl(), slant_x_.cl(), slant_y_.cl(), lead_.cl(),
                coarse.width, coarse.height, coarse.pitch, fine.width, fine.height, fine.pitch,
                fine_surface_.cl(), fine_lead_.cl());
  launch_rows(*device_, lane, kernels_.expand, fine.width, fine.height);
}

void DepthSweeper::pass(const Grid& grid, int neighbours, int reach, double step,
                        Buffer<float>& surface, Buffer<float>& inverse, Buffer<float>& score,
                        Lane lane) {
  const int layers = 2 * reach + 1;
  sweep(grid, neighbours, surface, -reach * step, step, layers, lane);
  set_arguments(kernels_.pick, volume_.cl(), layers, neighbours, grid.height, grid.row, grid.pitch,
                static_cast<float>(-reach * step), static_cast<float>(step), surface.cl(),
                inverse.cl(), score.cl(), guess_.cl());
  launch(*device_, lane, kernels_.pick, grid.row / vector_, grid.height);
}

double DepthSweeper::scores_at_once(int width_px, int height_px, std::size_t neighbours,
                                    int samples, bool coarse_to_fine) const {
  const auto layer = [&](int width, int height) {
    return static_cast<double>(row_length(width)) * height * static_cast<double>(neighbours);
  };
  const double refining = layer(width_px, height_px) * (2 * kFirstReach + 1);
  const int w = width_px / 2, h = height_px / 2;
  const double sweeping = coarse_to_fine && can_halve(w, h) ? layer(w, h) * coarse_samples(samples)
                                                            : layer(width_px, height_px) * samples;
  return std::max(sweeping, refining);
}

SweepResult DepthSweeper::estimate(const SweepRequest& request, Lane lane) {
  CORVID_CHECK(request.reference, "a reference image is needed");
  const Grid fine = grid_of(request.reference->full), coarse = grid_of(request.reference->half);
  const int m = static_cast<int>(request.neighbours.size());
  CORVID_CHECK(std::min(fine.width, fine.height) >= options_.template_px,
               "image is smaller than the template");
  CORVID_CHECK(request.samples >= 3 && request.samples <= 4096, "3 to 4096 depth samples");
  CORVID_CHECK(request.near > 0 && request.near < request.far && std::isfinite(request.far),
               "0 < near < far");
  const bool in_steps = request.coarse_to_fine && request.refinements > 0;
  CORVID_CHECK(scores_at_once(fine.width, fine.height, request.neighbours.size(), request.samples,
                              in_steps) <= kMostScores,
               "fewer rays, neighbours or samples");
  for (const SweepNeighbour& n : request.neighbours) {
    CORVID_CHECK(
        n.image && n.image->full.width_px == fine.width && n.image->full.height_px == fine.height,
        "neighbours must have the reference's size");
  }
  SweepResult result{FloatImage(fine.width, fine.height), FloatImage(fine.width, fine.height),
                     FloatImage(fine.width, fine.height)};
  if (m < options_.min_views) return result;

  const bool halve = in_steps && can_halve(coarse.width, coarse.height);
  const double inverse_far = 1 / request.far, range = 1 / request.near - inverse_far;
  const double step = range / (request.samples - 1);
  scores_ = 0;
  on_device("depth", [&] {
    if (halve) {
      const int samples = coarse_samples(request.samples);
      const double coarse_step = range / (samples - 1);
      load(request, true, coarse, lane);
      sweep(coarse, m, surface_, inverse_far, coarse_step, samples, lane);
      find_peaks(coarse, m, inverse_far, coarse_step, samples, lane);
      fit_planes(coarse, coarse_step, kFirstTolerance, lane);
      expand(coarse, fine, lane);
      load(request, false, fine, lane);
      std::swap(surface_, fine_surface_);
      std::swap(lead_, fine_lead_);
    } else {
      load(request, false, fine, lane);
      sweep(fine, m, surface_, inverse_far, step, request.samples, lane);
      find_peaks(fine, m, inverse_far, step, request.samples, lane);
    }
    double h = 1;
    for (int i = 0; i < request.refinements; ++i, h *= 0.5) {
      if (i > 0 || !halve) fit_planes(fine, step, i > 0 ? kTolerance : kFirstTolerance, lane);
      pass(fine, m, i == 0 ? kFirstReach : 1, h * step, surface_, inverse_, score_, lane);
    }
    if (request.refinements > 0) {
      mend_edges(fine, m, step, lane);
      fit_planes(fine, step, kTolerance, lane);
    }
  });

  std::vector<float> inverse(fine.elements()), score(inverse.size()), lead(inverse.size());
  result.scores = scores_;
  // Refined: what the plane through the answers around says, where there is an answer.
  (request.refinements > 0 ? surface_ : inverse_).download(inverse, 0, lane);
  score_.download(score, 0, lane);
  lead_.download(lead, 0, lane);
  for (int y = 0; y < fine.height; ++y) {
    for (int x = 0; x < fine.width; ++x) {
      const std::size_t at = area(fine.pitch, y) + static_cast<std::size_t>(kPadding + x);
      if (!(inverse[at] > 0) || !(score[at] > 0)) continue;
      result.depth(x, y) = 1 / inverse[at];
      result.confidence(x, y) = std::min(score[at], 1.0F);
      result.lead(x, y) = lead[at];
    }
  }
  return result;
}

}  // namespace corvid
