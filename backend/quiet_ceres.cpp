#include "backend/quiet_ceres.h"

#include <glog/logging.h>

namespace corvid {

void silence_glog() {
  static const bool done = [] {
    if (!google::IsGoogleLoggingInitialized()) FLAGS_minloglevel = google::GLOG_FATAL;
    return true;
  }();
  (void)done;
}

}  // namespace corvid
