#pragma once

#include <vector>

#include "kernels/pyramid.h"

namespace corvid {

/// One dense correlation job, in the host's memory. Images are row-major.
struct FrequencyJob {
  const void* target = nullptr;  ///< pixels
  PixelFormat format = PixelFormat::grey8;
  int target_width_px = 0;
  /// Of the footprints centred on the target's pixels: mean, and 1 / standard deviation or 0 where
  /// there is no score. Pitch: the target's width. Needed at the candidates only.
  const float *means = nullptr, *inverses = nullptr;
  /// The weighted template t' of ncc_common.cl, finite.
  const float* taps = nullptr;
  int taps_pitch = 0, template_width_px = 0, template_height_px = 0;
  int x_px = 0, y_px = 0;  ///< the first candidate's centre; all footprints lie in the target
  int width_px = 0, height_px = 0;  ///< candidates
  int threads = 1;                  ///< at most
};

/// Candidates, counted from the job's first.
struct CandidateBox {
  int x_px = 0, y_px = 0, width_px = 0, height_px = 0;
};

/// Coefficients of a job by the correlation theorem: sum_{u,v} t'(u,v) S(x+u, y+v) is the inverse
/// Fourier transform of F(S) conj(F(t')), block by block (overlap-save). Work per candidate hardly
/// depends on the template's size. Uses OpenCV's transform.
/// @param scores  width x height, -2 where there is no score.
/// @return boxes, each at most 256 x 16, whose scores were not written: blocks with a pixel that is
/// not finite, and candidates whose footprint varies so little, beside the block's, that the
/// transform's rounding could change their score by 8e-5. Same results for any number of threads.
/// Throws DeviceFault if there is no memory.
[[nodiscard]] std::vector<CandidateBox> score_by_frequency(const FrequencyJob& job, float* scores);

}  // namespace corvid
