#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include "corvid/error.h"

namespace corvid {

/// One line of the time file beside a video (docs/formats.md).
struct TimeLine {
  std::int64_t frame = 0;     ///< number of the frame in the video, from 0
  std::int64_t time_ns = 0;   ///< capture time
  std::int64_t sequence = 0;  ///< the number that the source gave it
  /// When a player shows the frame, by the container: finds the frame where others before it are
  /// damaged. Nothing: the frame's number has to do.
  std::optional<double> shown_ms;
  /// How long the video was when the frame was whole in it: a shorter one does not have it.
  std::optional<std::int64_t> bytes;
};

struct TimeFile {
  std::vector<TimeLine> lines;       ///< frame numbers rise
  std::vector<std::string> skipped;  ///< one message per line that says nothing
  bool torn = false;                 ///< a last line without its end was left out
};

/// "flight.mkv" to "flight.times.csv".
[[nodiscard]] std::filesystem::path time_file_of(const std::filesystem::path& video);

/// Reads one. Errors: not_found, io.
[[nodiscard]] Expected<TimeFile> read_time_file(const std::filesystem::path& path);

/// Writes one, line by line; each is on its way to the disk when append() returns.
class TimeFileWriter {
 public:
  /// Errors: io.
  [[nodiscard]] static Expected<TimeFileWriter> create(const std::filesystem::path& path);
  [[nodiscard]] Expected<void> append(const TimeLine& line);

 private:
  std::filesystem::path path_;
  std::ofstream out_;
};

}  // namespace corvid
