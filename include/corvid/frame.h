#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "corvid/camera.h"
#include "corvid/ids.h"
#include "corvid/image.h"

namespace corvid {

/// One picture of the camera. Immutable once it is made: it crosses threads as FramePtr.
struct Frame {
  FrameId id;                ///< position in the source, from 0
  std::int64_t time_ns = 0;  ///< capture time
  GreyImage grey;
  ColourImage colour;  ///< empty if the camera is grey
  std::shared_ptr<const Camera> camera;
  std::string name;  ///< file name where there is one; used in messages and exports
};
using FramePtr = std::shared_ptr<const Frame>;

}  // namespace corvid
