#pragma once

#include <cstdint>
#include <string>

#include "io/camera/camera_stream.h"

namespace corvid {

/// Counts what a camera numbered but did not deliver. The driver's numbers have 32 bits: they are
/// carried on beyond.
class FrameCount {
 public:
  /// A picture with the driver's number came. Numbers that do not rise are taken for a count that
  /// began anew, at the next number.
  /// @return the number in 64 bits.
  std::uint64_t came(std::uint32_t number);
  /// That picture was damaged.
  void damaged(std::uint64_t sequence, const std::string& why);
  [[nodiscard]] const StreamCounts& counts() const { return counts_; }

 private:
  bool any_ = false;
  std::uint32_t last_number_ = 0;
  std::uint64_t sequence_ = 0;
  StreamCounts counts_;
};

}  // namespace corvid
