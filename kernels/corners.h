#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "corvid/image.h"
#include "kernels/buffer.h"
#include "kernels/pyramid.h"

namespace corvid {

/// Both scores of one pixel.
struct CornerScore {
  float lambda_min = 0;  ///< smaller eigenvalue of the structure tensor [grey^2/px^2], Shi-Tomasi
  float harris = 0;      ///< det - kappa trace^2 [grey^4/px^4], Harris-Stephens
};

struct Corner {
  float x_px = 0, y_px = 0;  ///< sub-pixel, by quadratic fit of lambda_min
  float lambda_min = 0, harris = 0;
};

struct CornerOptions {
  double quality = 0.01;  ///< Q_c: share of the image's largest lambda_min (thesis 4.2)
  double kappa = 0.04;    ///< Harris-Stephens sensitivity (thesis 4.2)
  int border_px = 0;      ///< no corner nearer to the image's border; at least kCornerMargin_px
  int cell_px = 32;       ///< side of the buckets that spread the corners
  int max_per_cell = 4;   ///< corners per bucket, those of `occupied` included
  int max_count = 1000;   ///< corners returned at most
  double min_distance_px = 4;                   ///< between two returned corners, and to `occupied`
  std::span<const Eigen::Vector2f> occupied{};  ///< where corners are not wanted any more [px]
};

/// Structure tensor reach (gradient 1, window 3) plus the neighbour of the 3x3 maximum.
inline constexpr int kCornerMargin_px = 5;

/// The score images; zero within 4 px of the border.
struct CornerScoreImages {
  FloatImage lambda_min, harris;
};

/// Interest points (algorithms.md 1): the structure tensor is summed from products of central
/// differences with a 7x7 Gaussian window (sigma 1.5 px); corners are strict 3x3 maxima of
/// lambda_min above quality * max whose Harris-Stephens score is positive. Images are grey8.
/// One owner. Methods throw DeviceFault. Results are the same in every run.
class CornerDetector {
 public:
  /// @param extra_options  compiler options, for tests.
  [[nodiscard]] static Expected<CornerDetector> create(std::shared_ptr<Device> device,
                                                       const std::string& extra_options = {},
                                                       KernelKind kind = KernelKind::suited);

  /// The best corners spread over the image: cells give their best one first, then their second
  /// best, until max_count; in that order. Empty if the image is too small or has no texture.
  [[nodiscard]] std::vector<Corner> detect(const DeviceImage& image, const CornerOptions& options,
                                           Lane lane = Lane::tracking);

  /// Every corner of the image, before the selection, strongest first.
  [[nodiscard]] std::vector<Corner> detect_all(const DeviceImage& image, double quality,
                                               double kappa, int border_px = 0,
                                               Lane lane = Lane::tracking);

  [[nodiscard]] CornerScoreImages scores(const DeviceImage& image, double kappa,
                                         Lane lane = Lane::tracking);

  /// Scores at the pixels nearest to the points, without the rest of the image; zero for points
  /// within 4 px of the border, outside, or not finite.
  [[nodiscard]] std::vector<CornerScore> score_at(const DeviceImage& image,
                                                  std::span<const Eigen::Vector2f> points,
                                                  double kappa, Lane lane = Lane::tracking);

 private:
  CornerDetector(std::shared_ptr<Device> device, bool gpu, const cl::Program& program);
  [[nodiscard]] int rows_each(const DeviceImage& image) const;
  void run_scores(const DeviceImage& image, double kappa, Lane lane);

  std::shared_ptr<Device> device_;
  bool gpu_;
  cl::Kernel columns_, scores_, maxima_, points_;  // columns_ and products_: of GPUs only
  Buffer<float> products_, lambda_min_, harris_;
  Buffer<int> state_;  // 0: bits of the largest lambda_min, 1: corners found
  Buffer<Corner> found_;
  Buffer<float> asked_;  // x, y in turn
  Buffer<CornerScore> answered_;
};

/// The even selection of detect(), on its own: `corners` strongest first.
[[nodiscard]] std::vector<Corner> select_evenly(std::span<const Corner> corners,
                                                const CornerOptions& options);

}  // namespace corvid
