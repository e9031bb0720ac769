#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "kernels/buffer.h"
#include "kernels/pyramid.h"

namespace corvid {

/// One template of the reference image and where to look for it in the target image.
struct NccJob {
  float template_x_px = 0, template_y_px = 0;  ///< centre in the reference image, sub-pixel
  /// Row-major 2x2 matrix A: the template's sample (u, v) is read, bilinearly, at centre + A (u,
  /// v).
  float warp[4] = {1, 0, 0, 1};
  std::int32_t window_x_px = 0, window_y_px = 0;  ///< centre of the search window in the target
  std::int32_t radius_x_px = 0, radius_y_px = 0;  ///< candidates: centre +- radius, any size
};

/// A maximum of the correlation surface, refined to sub-pixel.
struct NccPeak {
  float x_px = 0, y_px = 0;  ///< in the target image
  float score = 0;           ///< normalized cross-correlation there, at most 1
  /// Hessian of the surface at the peak [1/px^2]: negative definite. In a window of one row (or
  /// column) only cxx (or cyy) is negative and the rest is 0.
  float cxx = 0, cxy = 0, cyy = 0;
};

struct NccResult {
  std::int32_t count = 0;          ///< peaks found, at most 4
  std::array<NccPeak, 4> peaks{};  ///< best first
  float best_raw = -2;  ///< largest coefficient on the pixel grid, peak or not; -2: none was scored
};

struct NccOptions {
  int template_px = 11;        ///< template side, odd, 3 to 31 (thesis 4.1)
  double peak_quality = 0.85;  ///< Q_m: peaks kept, share of the window's best (thesis 3.2)
  bool gaussian = false;       ///< weights exp(-r^2/(2 sigma^2)), sigma = side/6; else uniform
  /// Gauss-Newton steps that move a peak from the quadratic's vertex to the maximum of the
  /// correlation between the template and the interpolated target; 0: the vertex alone
  /// (thesis 3.2), which is biased by up to some 0.3 px where the texture is smooth.
  int align_iterations = 8;
  /// Device memory for coefficients and jobs: batches are cut to it. A single job takes what it
  /// needs even beyond it. Results do not depend on it.
  std::size_t memory_budget_bytes = std::size_t{64} << 20;
};

/// How the work is cut. wide: vectors of 16 candidates, a small window's whole job in one work-item
/// (CPUs). fine: vectors of 4, many small tiles (GPUs). Scores agree up to rounding.
enum class NccVariant { by_device, wide, fine };

/// Normalized cross-correlation with peaks (algorithms.md 2):
///   C = (s3 - s2 s4) / sqrt((s1 - s2^2)(s5 - s4^2)), sums over the weighted template.
///
/// A candidate whose template leaves the target, or whose footprint has no variance, has no score.
/// Peaks are strict 3x3 maxima whose 8 neighbours all have scores (strict 1-d maxima with a
/// parabola where a radius is 0), with score >= peak_quality times the window's best. A job whose
/// template leaves the reference, has less variance than 0.01 grey^2, or whose numbers are not
/// finite or negative gives count 0 and best_raw -2. With Gaussian weights footprints of less
/// variance than 0.1 grey^2 count as without variance.
///
/// One owner. Same results in every run and for every memory budget.
class NccMatcher {
 public:
  /// @param extra_options, variant  for tests: compiler options, another device's way of working.
  [[nodiscard]] static Expected<NccMatcher> create(std::shared_ptr<Device> device,
                                                   std::string extra_options = {},
                                                   NccVariant variant = NccVariant::by_device);

  /// Builds the kernels of a template size ahead of its first match() (which would otherwise do
  /// so). Fails with invalid_argument if the options are out of range.
  [[nodiscard]] Expected<void> prepare(const NccOptions& options);

  /// One result per job, in the jobs' order. Both images must be of this matcher's device.
  /// Throws DeviceFault; std::logic_error if the options are out of range.
  [[nodiscard]] std::vector<NccResult> match(const DeviceImage& reference,
                                             const DeviceImage& target,
                                             std::span<const NccJob> jobs,
                                             const NccOptions& options, Lane lane = Lane::tracking);

 private:
  /// What a kernel reads of a job; the layout is that of ncc.cl.
  struct DeviceJob {
    std::int32_t reference_x, reference_y;  // pixel left above the template's centre
    float fraction_x, fraction_y;
    float warp[4];
    std::int32_t x, y, width, height;  // candidates in the target, clipped
    std::int32_t flat;                 // bit 0: maxima along x only, bit 1: along y only
    std::int32_t scores, pitch;        // the job's place in the coefficients
  };
  struct Kernels {
    cl::Kernel small, templates, tiles, peaks;
  };
  struct Tile {
    std::int32_t job, x, y, rows;
  };

  NccMatcher(std::shared_ptr<Device> device, std::string extra_options, bool wide);
  [[nodiscard]] static bool place(const NccJob& job, const DeviceImage& reference,
                                  const DeviceImage& target, int template_px, DeviceJob& out);
  [[nodiscard]] std::size_t template_size(int template_px) const;
  Expected<Kernels*> kernels(const NccOptions& options);
  void run_batch(Kernels& kernels, const DeviceImage& reference, const DeviceImage& target,
                 const NccOptions& options, bool small, Lane lane);

  std::shared_ptr<Device> device_;
  std::string extra_options_;
  bool wide_;
  int lanes_;  // candidates per vector
  std::map<std::pair<int, bool>, Kernels> kernels_;
  std::vector<DeviceJob> jobs_;
  std::vector<Tile> tile_list_;
  std::vector<NccResult> results_;
  Buffer<DeviceJob> device_jobs_;
  Buffer<Tile> device_tiles_;
  Buffer<float> templates_, scores_;
  Buffer<NccResult> device_results_;
};

}  // namespace corvid
