#pragma once

namespace corvid {

/// Ceres warns through glog, which writes to stderr until a program sets it up: the solver's
/// troubles come back in its summary, and the library prints nothing. To be called before a solve.
void silence_glog();

}  // namespace corvid
