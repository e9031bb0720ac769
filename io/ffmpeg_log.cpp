#include "io/ffmpeg_log.h"

#include <array>
#include <cstdarg>
#include <mutex>
#include <string>

extern "C" {
#include <libavutil/log.h>
}

#include "core/log.h"

namespace corvid {
namespace {

void to_log(void* context, int level, const char* format, va_list arguments) {
  if (level > AV_LOG_ERROR) return;
  std::array<char, 512> line{};
  int prefix = 1;
  av_log_format_line2(context, level, format, arguments, line.data(), line.size(), &prefix);
  std::string text(line.data());
  while (!text.empty() && text.back() == '\n') text.pop_back();
  log().debug("FFmpeg: {}", text);
}

}  // namespace

void catch_ffmpeg_log() {
  static std::once_flag once;
  std::call_once(once, [] { av_log_set_callback(to_log); });
}

}  // namespace corvid
