#include "io/trajectory_file.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <string_view>

#include "io/atomic_file.h"
#include "io/readers/text.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> broken(const std::string& path, const TextLine& line, std::string what) {
  return fail(ErrorCode::corrupt, std::move(what), at_line(path, line.number));
}

// A header without '#', as spreadsheets write it, stands on the first line only.
void drop_header(std::vector<TextLine>& lines) {
  if (lines.empty()) return;
  const auto parts = fields(lines.front().text);
  if (!parts.empty() && std::isalpha(static_cast<unsigned char>(parts[0].front())) != 0 &&
      !to_number(parts[0])) {
    lines.erase(lines.begin());
  }
}

std::optional<TrajectoryFormat> recognise(std::string_view line) {
  const auto parts = fields(line);
  if (parts.size() == 12) return TrajectoryFormat::kitti;
  if (parts.size() < 8) return {};
  if (line.find(',') != std::string_view::npos && to_integer(parts[0])) {
    return TrajectoryFormat::euroc;
  }
  if (parts.size() == 8) return TrajectoryFormat::tum;
  return {};
}

std::optional<Pose> pose_of(double x, double y, double z, double qw, double qx, double qy,
                            double qz) {
  const Eigen::Quaterniond q(qw, qx, qy, qz);
  if (std::abs(q.norm() - 1) > 0.05) return {};
  return Pose(q, {x, y, z});
}

// Rows that start with their own time.
Expected<Trajectory> read_timed(const std::vector<TextLine>& lines, const std::string& path,
                                TrajectoryFormat format) {
  const bool euroc = format == TrajectoryFormat::euroc;
  Trajectory result;
  for (const TextLine& line : lines) {
    const auto parts = fields(line.text);
    if (parts.size() < 8 || (!euroc && parts.size() != 8)) {
      return broken(path, line,
                    fmt::format("{} columns; expected time, position, quaternion", parts.size()));
    }
    const auto time = euroc ? to_integer(parts[0]) : seconds_to_ns(parts[0]);
    if (!time) return broken(path, line, fmt::format("\"{}\" is not a time", parts[0]));
    double v[7];
    for (std::size_t i = 0; i < 7; ++i) {
      const auto number = to_number(parts[i + 1]);
      if (!number) {
        return broken(path, line, fmt::format("\"{}\" is not a finite number", parts[i + 1]));
      }
      v[i] = *number;
    }
    const auto pose = euroc ? pose_of(v[0], v[1], v[2], v[3], v[4], v[5], v[6])
                            : pose_of(v[0], v[1], v[2], v[6], v[3], v[4], v[5]);
    if (!pose) return broken(path, line, "the quaternion does not have unit length");
    if (!result.empty() && *time <= result.back().time_ns) {
      return broken(path, line, "the time does not rise");
    }
    result.push_back({*time, *pose});
  }
  return result;
}

// A folder "poses" keeps its times in "../sequences/NN/times.txt".
std::string find_times(const std::string& path) {
  const fs::path file(path);
  for (const fs::path& candidate :
       {file.parent_path() / "times.txt",
        file.parent_path().parent_path() / "sequences" / file.stem() / "times.txt"}) {
    std::error_code ignored;
    if (fs::is_regular_file(candidate, ignored)) return candidate.string();
  }
  return {};
}

Expected<std::vector<std::int64_t>> read_times(const std::string& path) {
  const auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  std::vector<std::int64_t> times;
  for (const TextLine& line : data_lines(*text)) {
    const auto time = seconds_to_ns(line.text);
    if (!time) return broken(path, line, fmt::format("\"{}\" is not a time", line.text));
    if (!times.empty() && *time <= times.back()) {
      return broken(path, line, "the time does not rise");
    }
    times.push_back(*time);
  }
  return times;
}

Expected<Trajectory> read_kitti(const std::vector<TextLine>& lines, const std::string& path,
                                const TrajectoryReadOptions& options) {
  std::vector<std::int64_t> times;
  const std::string times_path = options.times_path.empty() ? find_times(path) : options.times_path;
  if (!times_path.empty()) {
    auto read = read_times(times_path);
    // A file that happens to lie there must fit; one that was asked for must be right.
    const bool fits = read && read->size() >= lines.size();
    if (!options.times_path.empty() && !fits) {
      if (!read) return tl::unexpected(read.error());
      return fail(ErrorCode::corrupt,
                  fmt::format("{} times for {} poses", read->size(), lines.size()), times_path);
    }
    if (fits) times = std::move(*read);
  }
  if (times.empty() && !(options.rate_hz >= 1e-3 && options.rate_hz <= 1e6)) {
    return fail(ErrorCode::invalid_argument, "the rate of the poses must be 0.001 to 1e6 Hz", path);
  }
  Trajectory result;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const auto v = to_numbers(lines[i].text);
    if (!v || v->size() != 12) {
      return broken(path, lines[i], "expected 12 finite numbers, a 3x4 pose matrix row by row");
    }
    const Eigen::Matrix<double, 3, 4, Eigen::RowMajor> T =
        Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(v->data());
    const Eigen::Matrix3d R = T.leftCols<3>();
    if ((R * R.transpose() - Eigen::Matrix3d::Identity()).norm() > 1e-2 || R.determinant() < 0) {
      return broken(path, lines[i], "the 3x3 part is not a rotation");
    }
    const std::int64_t time = times.empty() ? static_cast<std::int64_t>(std::llround(
                                                  static_cast<double>(i) * 1e9 / options.rate_hz))
                                            : times[i];
    result.push_back({time, Pose(R, T.col(3))});
  }
  return result;
}

}  // namespace

Expected<Trajectory> read_trajectory(const std::string& path,
                                     const TrajectoryReadOptions& options) {
  auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  if (text->starts_with(kAppended)) text->resize(text->rfind('\n') + 1);
  std::vector<TextLine> lines = data_lines(*text);
  drop_header(lines);
  if (lines.empty()) return fail(ErrorCode::corrupt, "the file has no poses", path);
  const auto format = options.format ? options.format : recognise(lines.front().text);
  if (!format) {
    return fail(ErrorCode::corrupt,
                fmt::format("{} columns are no known format", fields(lines.front().text).size()),
                at_line(path, lines.front().number),
                "expected TUM (time tx ty tz qx qy qz qw), KITTI (12 numbers) or EuRoC csv");
  }
  if (*format == TrajectoryFormat::kitti) return read_kitti(lines, path, options);
  return read_timed(lines, path, *format);
}

void append_tum_line(std::string& text, const StampedPose& stamped) {
  // Whole numbers, because a double loses the last digits of today's times.
  const bool negative = stamped.time_ns < 0;
  const std::uint64_t ns = negative ? std::uint64_t{0} - static_cast<std::uint64_t>(stamped.time_ns)
                                    : static_cast<std::uint64_t>(stamped.time_ns);
  const Eigen::Vector3d& t = stamped.T_world_camera.translation();
  const Eigen::Quaterniond& q = stamped.T_world_camera.rotation();
  fmt::format_to(std::back_inserter(text),
                 "{}{}.{:09d} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g}\n",
                 negative ? "-" : "", ns / 1'000'000'000, ns % 1'000'000'000, t.x(), t.y(), t.z(),
                 q.x(), q.y(), q.z(), q.w());
}

Expected<void> write_trajectory(const std::string& path, const Trajectory& trajectory) {
  std::string text = "# timestamp tx ty tz qx qy qz qw\n";
  for (const StampedPose& stamped : trajectory) append_tum_line(text, stamped);
  return write_file_atomically(path, text);
}

}  // namespace corvid
