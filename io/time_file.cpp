#include "io/time_file.h"

#include <fmt/format.h>

#include <cerrno>
#include <string_view>
#include <utility>

#include "io/atomic_file.h"
#include "io/io_fault.h"
#include "io/readers/text.h"

namespace corvid {
namespace {

// "frame,time_ns[,sequence[,shown_ms[,bytes]]]"
std::optional<TimeLine> parse(std::string_view text) {
  const std::vector<std::string_view> parts = fields(text, ", \t");
  if (parts.size() < 2 || parts.size() > 5) return {};
  const auto frame = to_integer(parts[0]), time_ns = to_integer(parts[1]);
  const auto sequence = parts.size() > 2 ? to_integer(parts[2]) : frame;
  if (!frame || *frame < 0 || !time_ns || *time_ns < 0 || !sequence || *sequence < 0) return {};
  TimeLine line{*frame, *time_ns, *sequence, {}, {}};
  if (parts.size() > 3) {
    line.shown_ms = to_number(parts[3]);
    if (!line.shown_ms) return {};
  }
  if (parts.size() > 4) {
    line.bytes = to_integer(parts[4]);
    if (!line.bytes) return {};
  }
  return line;
}

}  // namespace

std::filesystem::path time_file_of(const std::filesystem::path& video) {
  return std::filesystem::path(video).replace_extension(".times.csv");
}

Expected<TimeFile> read_time_file(const std::filesystem::path& path) {
  const auto bytes = read_file_bytes(path);
  if (!bytes) return tl::unexpected(bytes.error());
  TimeFile file;
  std::string_view text = *bytes;
  // A number that is cut off is a number still: only a line feed says that the line is whole.
  const std::size_t end = text.rfind('\n');
  text = text.substr(0, end == std::string_view::npos ? 0 : end + 1);
  file.torn = text.size() < bytes->size();
  for (const TextLine& row : data_lines(text)) {
    const auto line = parse(row.text);
    if (!line || (!file.lines.empty() && line->frame <= file.lines.back().frame)) {
      file.skipped.push_back(
          fmt::format("{}: expected \"frame,time_ns,sequence,shown_ms,bytes\" with rising frames",
                      at_line(path.string(), row.number)));
      continue;
    }
    file.lines.push_back(*line);
  }
  return file;
}

Expected<TimeFileWriter> TimeFileWriter::create(const std::filesystem::path& path) {
  TimeFileWriter writer;
  writer.path_ = path;
  errno = 0;
  writer.out_.open(path, std::ios::binary | std::ios::trunc);
  writer.out_ << "#frame,time [ns],sequence,shown [ms],bytes\n" << std::flush;
  if (!writer.out_) return io_fault("cannot be written", path, errno);
  return writer;
}

Expected<void> TimeFileWriter::append(const TimeLine& line) {
  errno = 0;
  out_ << fmt::format("{},{},{}", line.frame, line.time_ns, line.sequence);
  if (line.shown_ms) out_ << fmt::format(",{:.3f}", *line.shown_ms);
  if (line.shown_ms && line.bytes) out_ << fmt::format(",{}", *line.bytes);
  out_ << '\n' << std::flush;
  if (!out_) return io_fault("cannot be written", path_, errno);
  return {};
}

}  // namespace corvid
