#pragma once

namespace corvid {

/// FFmpeg's messages go to the library's log (debug) instead of the standard error. Thread-safe;
/// all calls but the first do nothing.
void catch_ffmpeg_log();

}  // namespace corvid
