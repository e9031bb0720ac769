#include "engine/queue_brake.h"

#include <vector>

#include "core/log.h"

namespace corvid {

void QueueBrake::hold() {
  if (go_) return;
  try {
    go_.emplace(device_->context());
    const std::vector<cl::Event> wait{*go_};
    device_->queue(lane_).enqueueBarrierWithWaitList(&wait);
    device_->queue(lane_).flush();
  } catch (const cl::Error& e) {
    log().debug("a queue cannot be held: {} ({})", e.what(), e.err());
    release();
  }
}

void QueueBrake::release() {
  if (!go_) return;
  try {
    go_->setStatus(CL_COMPLETE);
  } catch (const cl::Error& e) {
    log().debug("a queue cannot be released: {} ({})", e.what(), e.err());
  }
  go_.reset();
}

}  // namespace corvid
