#pragma once

#include <memory>
#include <optional>

#include "engine/gate.h"
#include "kernels/device.h"

namespace corvid {

/// Holds what is put into one queue of a device from now on, by a barrier that waits for an event
/// of ours. What was in the queue before runs to its end, so the work must come in small launches.
/// Not thread-safe; a failing device is logged, and then nothing is held.
class QueueBrake final : public Brake {
 public:
  QueueBrake(std::shared_ptr<Device> device, Lane lane) : device_(std::move(device)), lane_(lane) {}
  QueueBrake(const QueueBrake&) = delete;
  QueueBrake& operator=(const QueueBrake&) = delete;
  ~QueueBrake() override { release(); }

  void hold() override;
  void release() override;

 private:
  std::shared_ptr<Device> device_;
  Lane lane_;
  std::optional<cl::UserEvent> go_;
};

}  // namespace corvid
