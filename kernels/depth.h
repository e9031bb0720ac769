#pragma once

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
  cl::Buffer pixels;  ///< float, padded; see depth.cl
  int width_px = 0, height_px = 0;
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
  double near = 0, far = 0;  ///< depth interval [map units], 0 < near < far
  int samples = 96;          ///< planes, uniform in inverse depth
  int refinements = 3;       ///< passes on slanted planes; 0: the sweep alone
};

struct SweepResult {
  FloatImage depth;       ///< z in camera coordinates [map units]; 0 = no answer
  FloatImage confidence;  ///< fused score in [0, 1]; 0 = no answer
  FloatImage lead;        ///< of the best peak's score over the next best one's; 1 = no other
};

/// Depth of a view by multi-view NCC: a sweep of fronto-parallel planes, whose weighted sums are
/// separable, so a sample costs O(template side); then local refinement on slanted planes, which
/// mends the sweep's bias and finds rays that it missed (algorithms.md 7; Collins 1996 for the
/// sweep). No rectification, so it works with the epipole in the image. The geometry is computed
/// in double precision, the rest in single precision, all on the device; work is queued in small
/// slices. One owner, one thread at a time. Throws DeviceFault.
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

  /// @pre images not smaller than the template, at least 3 samples, at least min_views neighbours
  ///      (else every ray is without an answer).
  [[nodiscard]] SweepResult estimate(const SweepRequest& request, Lane lane = Lane::mapping);

 private:
  struct Kernels {
    cl::Kernel shrink, reference_sums, warp_planes, sum_rows, score_planes, find_peaks, refine;
  };
  DepthSweeper(std::shared_ptr<Device> device, const DepthSweepOptions& options, Kernels kernels);
  void fill(Buffer<float>& buffer, std::size_t size, float value, Lane lane);

  std::shared_ptr<Device> device_;
  DepthSweepOptions options_;
  Kernels kernels_;
  int vector_ = 1;  ///< pixels per work-item
  int slice_ = 1;   ///< depth samples per launch
  Buffer<float> images_, geometry_, s1_, s2_, warped_, sums_, inverse_, score_, lead_,
      inverse_next_, score_next_;
  Buffer<std::uint16_t> volume_;
};

}  // namespace corvid
