#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <span>
#include <string>

#include "corvid/camera.h"
#include "corvid/image.h"
#include "corvid/pose.h"
#include "kernels/buffer.h"
#include "kernels/pyramid.h"

namespace corvid {

struct DepthSweepOptions {
  int template_px = 11;     ///< odd; Gaussian weights with sigma = side/6 (thesis 6.2)
  double min_score = 0.6;   ///< tau: a neighbour counts above it (thesis 6.4)
  int min_views = 2;        ///< neighbours that must agree (thesis 6.4)
  double min_variance = 2;  ///< of a window with texture [grey levels^2]
  int vector_px = 0;        ///< pixels per work-item, 1 or 16; 0: what suits the device
};

/// An undistorted image as the sweep reads it, on the device. Made by DepthSweeper::prepare().
struct SweepImage {
  struct Level {
    cl::Buffer quads;  ///< see depth.cl
    int width_px = 0, height_px = 0;
  };
  Level full, half;
};

/// One neighbour of a reference view.
struct SweepNeighbour {
  const SweepImage* image = nullptr;  ///< of the reference's size
  Camera camera;                      ///< pinhole of that image
  Pose T_neighbour_reference;
};

struct SweepRequest {
  const SweepImage* reference = nullptr;
  Camera camera;  ///< pinhole of the reference image
  std::span<const SweepNeighbour> neighbours;
  double near = 0, far = 0;    ///< depth interval [map units], 0 < near < far
  int samples = 96;            ///< depth samples, uniform in inverse depth
  bool coarse_to_fine = true;  ///< false: every sample at full resolution
  int refinements = 3;         ///< passes around the estimated surface; 0: the sweep alone
};

struct SweepResult {
  FloatImage depth;       ///< z in camera coordinates [map units]; 0 = no answer
  FloatImage confidence;  ///< fused score in [0, 1]; 0 = no answer
  FloatImage lead;        ///< of the best peak's score over the next best one's; 1 = no other
  double scores = 0;      ///< coefficients computed: per pixel, neighbour and layer
};

/// Depth of a view by multi-view NCC, in two steps (algorithms.md 7).
///
/// A sweep of planes that face the camera (Collins 1996) over the whole interval, at half the
/// resolution unless the request says otherwise: the weighted sums are separable, so a sample costs
/// O(template side). Then, at full resolution, passes of a few samples around the estimated
/// surface: the neighbours are warped by the surface itself, smoothed by planes, so that a template
/// lies on slanted ground as it does on a wall, and the sums stay separable. No rectification, so
/// it works with the epipole in the image. The geometry is computed in double precision, the rest
/// in single precision, all on the device; work is queued in small slices. One owner, one thread at
/// a time. Throws DeviceFault.
class DepthSweeper {
 public:
  /// Fails if an option is out of its range or if the kernels do not build.
  /// @param extra_options  compiler options, for tests.
  [[nodiscard]] static Expected<DepthSweeper> create(std::shared_ptr<Device> device,
                                                     const DepthSweepOptions& options,
                                                     const std::string& extra_options = {});

  /// Averages `scale` x `scale` pixels: one ray per block of pixels. Done on return.
  [[nodiscard]] SweepImage prepare(const DeviceImage& image, int scale, Lane lane = Lane::mapping);
  /// The camera of an image reduced by prepare().
  [[nodiscard]] static Camera scaled(const Camera& camera, int scale);

  /// Scores that estimate() holds at a time. The kernels count them in 32 bits: no more than
  /// kMostScores of them can be.
  [[nodiscard]] double scores_at_once(int width_px, int height_px, std::size_t neighbours,
                                      int samples, bool coarse_to_fine = true) const;
  static constexpr double kMostScores = 2147483647;

  /// @pre images not smaller than the template, at least 3 samples, no more than kMostScores, at
  ///      least min_views neighbours (else every ray is without an answer).
  [[nodiscard]] SweepResult estimate(const SweepRequest& request, Lane lane = Lane::mapping);

 private:
  struct Kernels {
    cl::Kernel shrink, reference_grey, reference_sums, sweep, find_peaks, fit_planes, expand, pick,
        near_and_far, choose_side;
  };
  /// Sizes of one level's padded images.
  struct Grid {
    int width = 0, height = 0, row = 0, pitch = 0;
    [[nodiscard]] std::size_t elements() const;
  };
  [[nodiscard]] static Grid grid_of(const SweepImage::Level& level);
  /// Whether the sweep can be at half the resolution.
  [[nodiscard]] bool can_halve(int coarse_width, int coarse_height) const {
    return std::min(coarse_width, coarse_height) >= 2 * options_.template_px;
  }
  DepthSweeper(std::shared_ptr<Device> device, const DepthSweepOptions& options, Kernels kernels);
  void fill(Buffer<float>& buffer, std::size_t size, float value, Lane lane);
  [[nodiscard]] SweepImage::Level reduce(const DeviceImage& image, int scale, Lane lane);
  /// Puts reference, neighbours and geometry of a level in place; the surface is zero.
  void load(const SweepRequest& request, bool half, const Grid& grid, Lane lane);
  /// Scores of `layers` layers around a surface, into the volume.
  void sweep(const Grid& grid, int neighbours, Buffer<float>& surface, double inverse_0,
             double step, int layers, Lane lane);
  void find_peaks(const Grid& grid, int neighbours, double inverse_far, double step, int samples,
                  Lane lane);
  /// The surface found at half the resolution, and its lead, at the full one.
  void expand(const Grid& coarse, const Grid& fine, Lane lane);
  void fit_planes(const Grid& grid, double step, float tolerance, Lane lane);
  /// The best of `reach` layers to either side of a surface, into `inverse` and `score`.
  void pass(const Grid& grid, int neighbours, int reach, double step, Buffer<float>& surface,
            Buffer<float>& inverse, Buffer<float>& score, Lane lane);
  /// Templates with Gaussian weights of this deviation from here on.
  void set_weights(const Grid& grid, double sigma_px, Lane lane);
  /// Chooses a side anew, by narrow templates, where templates see two surfaces.
  void mend_edges(const Grid& grid, int neighbours, double step, Lane lane);

  std::shared_ptr<Device> device_;
  DepthSweepOptions options_;
  Kernels kernels_;
  int vector_ = 1;     ///< pixels per vector
  double scores_ = 0;  ///< of the estimate under way
  Buffer<std::uint32_t> images_;
  Buffer<float> geometry_, grey_, mean_, inverse_deviation_;  ///< of the level
  Buffer<float> surface_, slant_x_, slant_y_, inverse_, score_, lead_, guess_, support_,
      fine_surface_, fine_lead_, near_, far_, near_inverse_, near_score_, far_inverse_, far_score_,
      weights_;
  Buffer<std::int16_t> volume_;
};

}  // namespace corvid
