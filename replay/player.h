#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "core/clock.h"
#include "core/source_decorator.h"
#include "corvid/ports.h"

namespace corvid {

/// Plays another source at the pace of its capture times, as a live camera would.
///
/// The first frame is given at once and is the anchor: a frame captured dt later is due dt/rate
/// later on the clock. A consumer that is late gets the frames that are overdue without waiting;
/// it is the engine that drops them and counts it, because info().paced is true. A frame whose
/// time goes back is given at once. Without a rate nothing is paced and nothing dropped.
class Player final : public SourceDecorator {
 public:
  /// @param source  taken over.
  /// @param clock   outlives the player.
  /// @param rate    1 is the speed of the capture, 2 twice as fast; > 0 and finite. Nothing: as
  ///                fast as the consumer takes them.
  Player(std::unique_ptr<FrameSource> source, Clock& clock, std::optional<double> rate);

  [[nodiscard]] const SourceInfo& info() const override { return info_; }
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop = {}) override;

 private:
  struct Anchor {
    std::int64_t clock_ns, capture_ns;
  };
  Clock& clock_;
  std::optional<double> rate_;
  SourceInfo info_;
  std::optional<Anchor> anchor_;
};

}  // namespace corvid
