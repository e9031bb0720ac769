#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "corvid/error.h"
#include "corvid/frame.h"

struct AVCodecParameters;

namespace corvid {

/// FFV1, every frame on its own, so that several threads can encode at the same time and the
/// packets still make one stream. Grey, or colour as RGB: without any conversion that rounds.
class Ffv1Encoder {
 public:
  /// Errors: unsupported (FFmpeg without FFV1, a size it does not take).
  [[nodiscard]] static Expected<std::unique_ptr<Ffv1Encoder>> create(int width_px, int height_px,
                                                                     bool colour);
  ~Ffv1Encoder();
  Ffv1Encoder(const Ffv1Encoder&) = delete;
  Ffv1Encoder& operator=(const Ffv1Encoder&) = delete;

  /// Thread-safe. The frame has the encoder's size, and colour if it was asked for.
  [[nodiscard]] Expected<std::vector<std::uint8_t>> encode(const Frame& frame);
  /// What the container must say of the stream.
  [[nodiscard]] Expected<void> describe(AVCodecParameters& parameters);

 private:
  struct Context;
  Ffv1Encoder(int width_px, int height_px, bool colour);
  [[nodiscard]] Expected<std::unique_ptr<Context>> make_context() const;

  const int width_px_, height_px_;
  const bool colour_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<Context>> idle_;  ///< one for each thread that ever encoded at once
};

}  // namespace corvid
