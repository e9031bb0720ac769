#pragma once

#include "corvid/image.h"

namespace corvid {

/// Texture as in natural images: detail at every scale, amplitude falling with the frequency, and a
/// camera's noise, so that no 3x3 patch is constant. The same sides give the same image.
[[nodiscard]] GreyImage bench_image(int width_px, int height_px);

}  // namespace corvid
