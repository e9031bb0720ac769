#pragma once

#include <array>
#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "kernels/buffer.h"
#include "kernels/pyramid.h"

namespace corvid {

/// One template of the reference image and where to look for it in the target image.
struct NccJob {
  float template_x_px = 0, template_y_px = 0;  ///< centre in the reference image, sub-pixel
  /// Row-major 2x2 matrix A: the template's sample (u, v) is read, bicubically, at centre + A (u,
  /// v).
  float warp[4] = {1, 0, 0, 1};
  std::int32_t window_x_px = 0, window_y_px = 0;  ///< centre of the search window in the target
  std::int32_t radius_x_px = 0, radius_y_px = 0;  ///< candidates: centre +- radius, any size
};

/// Jobs whose templates are cut from one image.
struct NccBatch {
  const DeviceImage* reference = nullptr;
  std::span<const NccJob> jobs;
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

/// Weights of a template's samples: products of a weight per column and one per row.
enum class NccWeights {
  uniform,
  gaussian,   ///< exp(-r^2/(2 sigma^2)), sigma = side/6 along each axis
  separable,  ///< those of NccOptions::weights_x, weights_y
};

struct NccOptions {
  int template_px = 11;        ///< template width, odd, 3 to 31 (thesis 4.1)
  int template_height_px = 0;  ///< odd, 3 to 31; 0: as the width
  [[nodiscard]] int height_px() const {
    return template_height_px == 0 ? template_px : template_height_px;
  }
  double peak_quality = 0.85;  ///< Q_m: peaks kept, share of the window's best (thesis 3.2)
  NccWeights weights = NccWeights::uniform;
  std::vector<double> weights_x, weights_y;  ///< separable: one per column and row, > 0, any sum
  /// Gauss-Newton steps that move a peak from the quadratic's vertex to the maximum of the
  /// correlation between the template and the interpolated target; 0: the vertex alone
  /// (thesis 3.2), which is biased by up to some 0.3 px where the texture is smooth.
  int align_iterations = 8;
  /// Device memory for a batch of jobs (templates, maxima, results): batches are cut to it. A
  /// single job takes what it needs even beyond it. Denominators that are kept, 8 bytes per pixel
  /// of up to 8 images, some 200 MB at most or one image, come on top. Results do not depend on it.
  std::size_t memory_budget_bytes = std::size_t{64} << 20;
};

/// How the work is done. integer: 16-bit integer taps and 32-bit sums, exact but for the taps'
/// rounding, 8-bit images and uniform weights (x86 CPUs); otherwise as real. real: single
/// precision, a strip per work-item (CPUs). group: single precision, a square per work-group
/// (GPUs). These agree within 2e-5 where the template has texture; within 4e-4 where it is flat but
/// for single pixels. frequency: score() by Fourier transforms on the host, within 1e-4; match() as
/// by_device (CPUs).
enum class NccVariant { by_device, integer, real, group, frequency };

/// Coefficients of one job on the pixel grid, on the device.
struct NccScores {
  explicit NccScores(std::shared_ptr<Device> device) : scores(std::move(device)) {}
  Buffer<float> scores;             ///< row-major, pitch = width_px; -2 where there is none
  int x_px = 0, y_px = 0;           ///< the first candidate's centre in the target
  int width_px = 0, height_px = 0;  ///< candidates; 0 if the job has none
  [[nodiscard]] FloatImage download(Lane lane = Lane::tracking) const;
};

/// Normalized cross-correlation with peaks (algorithms.md 2):
///   C = (s3 - s2 s4) / sqrt((s1 - s2^2)(s5 - s4^2)), sums over the weighted template.
///
/// A candidate whose template leaves the target, or whose footprint has no variance, has no score.
/// Peaks are strict 3x3 maxima whose 8 neighbours all have scores (strict 1-d maxima with a
/// parabola where a radius is 0), with score >= peak_quality times the window's best. A job whose
/// template leaves the reference, has no variance, or whose numbers are not finite or negative
/// gives count 0 and best_raw -2. No variance: in 8-bit images a template below 0.01 grey^2, and
/// with weights a footprint below 0.1 grey^2; in float images below 1e-10 of the squared mean.
/// Scores of NaN pixels are missing.
///
/// s4 and s5 come from exact integer sums beside the numerators (uniform weights, integer
/// arithmetic), or are computed once per image where a window needs them, and kept for the images
/// used last (docs/decisions/correlation.md).
/// One owner. Same results in every run and for every memory budget.
class NccMatcher {
 public:
  /// @param extra_options, variant  for tests: compiler options, another device's way of working.
  [[nodiscard]] static Expected<NccMatcher> create(std::shared_ptr<Device> device,
                                                   std::string extra_options = {},
                                                   NccVariant variant = NccVariant::by_device);

  /// Builds the kernels of a template size ahead of its first match() (which would otherwise do
  /// so). Fails with invalid_argument if the options are out of range.
  [[nodiscard]] Expected<void> prepare(const NccOptions& options,
                                       PixelFormat format = PixelFormat::grey8);

  /// One result per job, in the jobs' order. Both images must be of this matcher's device and of
  /// one format. Throws DeviceFault; std::logic_error if the options are out of range.
  [[nodiscard]] std::vector<NccResult> match(const DeviceImage& reference,
                                             const DeviceImage& target,
                                             std::span<const NccJob> jobs,
                                             const NccOptions& options, Lane lane = Lane::tracking);

  /// Templates of several images in one go, which is faster than one call for each: as many results
  /// as all batches have jobs, in order.
  [[nodiscard]] std::vector<NccResult> match(std::span<const NccBatch> batches,
                                             const DeviceImage& target, const NccOptions& options,
                                             Lane lane = Lane::tracking);

  /// The coefficients themselves. `out` is used again; done on return. Throws as match().
  /// On a CPU a window of 128 x 128 candidates and more is scored in the way that was measured to
  /// be fastest for the template's size, kind of weights and format; the first such job on a device
  /// measures (some 0.3 s and the kernels' compilation), see Tuning. match() never depends on it.
  void score(const DeviceImage& reference, const DeviceImage& target, const NccJob& job,
             const NccOptions& options, NccScores& out, Lane lane = Lane::tracking);

 private:
  /// What a kernel reads of a job; the layouts are those of ncc_common.cl.
  struct DeviceJob {
    std::int32_t reference_x, reference_y;  // pixel left above the template's centre
    float fraction_x, fraction_y;
    float warp[4];
    std::int32_t x, y, width, height;  // candidates in the target, clipped
    std::int32_t flat;                 // bit 0: maxima along x only, bit 1: along y only
    std::int32_t first_piece, pieces;
  };
  // Jobs [first, end) of a run are cut from one image.
  struct Templates {
    const DeviceImage* reference;
    std::size_t first, end;
  };
  struct Piece {
    std::int32_t job, x, y, width, height;
  };
  struct Maxima {
    float best;
    std::int32_t count, place[4];
    float around[4][9];
  };
  struct Kernels {
    int width, height;  // of the template
    bool fused_box;     // denominators are computed with the coefficients
    std::size_t stored_floats;
    cl::Kernel templates, denominators, pieces, finish;
  };
  // Denominators of one image and template size; tiles are computed when they are first needed.
  struct Denominators {
    std::uint64_t image;
    const Kernels* kernels;
    Buffer<float> means, inverses;
    std::vector<bool> done;
  };

  NccMatcher(std::shared_ptr<Device> device, std::string extra_options, NccVariant variant);
  [[nodiscard]] static bool place(const NccJob& job, const DeviceImage& reference,
                                  const DeviceImage& target, const Kernels& kernels,
                                  DeviceJob& out);
  Expected<Kernels*> kernels(const NccOptions& options, PixelFormat format, NccVariant variant);
  Kernels& checked_kernels(const DeviceImage& target, const NccOptions& options,
                           NccVariant variant);
  void add_job(DeviceJob job);
  Denominators& denominators(const Kernels& kernels, const DeviceImage& target);
  void complete_denominators(Kernels& kernels, const DeviceImage& target, Denominators& kept,
                             Lane lane);
  /// Width of a tile of denominators.
  [[nodiscard]] int box_columns() const { return groups_ ? 32 : 2 * lanes_; }
  [[nodiscard]] std::size_t scratch_floats() const;
  void launch(const cl::Kernel& kernel, int count, Lane lane) const;
  void run_batch(Kernels& kernels, std::span<const Templates> templates, const DeviceImage& target,
                 const NccOptions& options, Buffer<float>* map, Lane lane);
  // ncc_dense.cpp
  void score_as(NccVariant variant, const DeviceImage& reference, const DeviceImage& target,
                const DeviceJob& job, const NccOptions& options, NccScores& out, Lane lane);
  void score_frequencies(Kernels& kernels, const DeviceImage& reference, const DeviceImage& target,
                         Buffer<float>& map, Lane lane);
  NccVariant fastest_variant(const NccOptions& options, PixelFormat format, Lane lane);

  /// Sources of the programs; see build_program().
  static constexpr std::string_view kCpuProgram = "ncc_common+ncc_templates+ncc_score+ncc_peaks";
  static constexpr std::string_view kGpuProgram = "ncc_common+ncc_templates+ncc_group+ncc_peaks";
  std::shared_ptr<Device> device_;
  std::string extra_options_;
  NccVariant variant_;
  bool groups_;  // work is done by work-groups
  int lanes_;    // 32-bit numbers per vector
  std::map<std::string, Kernels> kernels_;
  std::map<std::string, NccVariant> fastest_;  // of dense maps, as far as looked up
  std::list<Denominators> denominators_;       // used last first
  std::vector<DeviceJob> jobs_;
  std::vector<Piece> piece_list_;
  std::vector<NccResult> results_;
  Buffer<DeviceJob> device_jobs_;
  Buffer<Piece> device_pieces_;
  Buffer<Maxima> device_maxima_;
  Buffer<float> templates_;
  Buffer<std::int32_t> device_tiles_;
  Buffer<NccResult> device_results_;
};

}  // namespace corvid
