#include "io/positions_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string_view>

#include "io/atomic_file.h"
#include "io/nearest_name.h"
#include "io/readers/text.h"

namespace corvid {
namespace {

constexpr std::array<std::string_view, 8> kColumns = {"time_ns",
                                                      "time_s",
                                                      "name",
                                                      "latitude_deg",
                                                      "longitude_deg",
                                                      "altitude_m",
                                                      "sigma_horizontal_m",
                                                      "sigma_vertical_m"};
enum Column : std::size_t {
  time_ns,
  time_s,
  name,
  latitude,
  longitude,
  altitude,
  horizontal,
  vertical
};

/// Where each known column stands in a row.
using Places = std::array<std::optional<std::size_t>, kColumns.size()>;

/// The cells of a row, empty ones included, without blanks and quotes around them.
std::vector<std::string_view> cells(std::string_view line) {
  std::vector<std::string_view> out;
  while (true) {
    const std::size_t comma = line.find(',');
    std::string_view cell = trim(line.substr(0, comma));
    if (cell.size() >= 2 && cell.front() == '"' && cell.back() == '"')
      cell = cell.substr(1, cell.size() - 2);
    out.push_back(cell);
    if (comma == std::string_view::npos) return out;
    line.remove_prefix(comma + 1);
  }
}

tl::unexpected<Error> broken(const std::string& path, int line, std::string what,
                             std::string hint = {}) {
  return fail(ErrorCode::corrupt, std::move(what), at_line(path, line), std::move(hint));
}

Expected<Places> read_header(const std::string& path, const TextLine& line) {
  Places places;
  const auto names = cells(line.text);
  for (std::size_t i = 0; i < names.size(); ++i) {
    const auto known = std::find(kColumns.begin(), kColumns.end(), names[i]);
    if (known == kColumns.end()) continue;
    auto& place = places[static_cast<std::size_t>(known - kColumns.begin())];
    if (place) return broken(path, line.number, fmt::format("two columns `{}`", names[i]));
    place = i;
  }
  const auto hint = [&](std::string_view wanted) {
    for (const std::string_view given : names) {
      const std::array<std::string, 1> candidate = {std::string(wanted)};
      if (!nearest_name(given, candidate).empty())
        return fmt::format("is `{}` meant to be it?", given);
    }
    return fmt::format("the first line must name the columns, out of {}",
                       fmt::join(kColumns, ", "));
  };
  for (const Column c : {latitude, longitude, altitude}) {
    if (!places[c])
      return broken(path, line.number, fmt::format("there is no column `{}`", kColumns[c]),
                    hint(kColumns[c]));
  }
  const auto keys = std::count_if(places.begin(), places.begin() + 3,
                                  [](const auto& place) { return place.has_value(); });
  if (keys != 1)
    return broken(path, line.number, "one of the columns `time_ns`, `time_s` and `name` is needed",
                  hint("time_ns"));
  return places;
}

bool says_nothing(std::string_view cell) { return cell.empty() || lower_case(cell) == "nan"; }

/// Key of the row: when or in which frame.
Expected<PositionFix> read_key(const std::string& path, int line, const Places& places,
                               const std::vector<std::string_view>& row) {
  PositionFix fix;
  if (places[name]) {
    fix.frame_name = row[*places[name]];
    if (fix.frame_name.empty()) return broken(path, line, "the name of the frame is empty");
    return fix;
  }
  const std::string_view text = row[places[time_ns] ? *places[time_ns] : *places[time_s]];
  const auto time = places[time_ns] ? to_integer(text) : seconds_to_ns(text);
  if (!time) {
    return broken(path, line,
                  fmt::format("\"{}\" is not a time in {}", text,
                              places[time_ns] ? "nanoseconds" : "seconds"));
  }
  fix.time_ns = *time;
  return fix;
}

/// Nothing for a row that says that the receiver had no position.
Expected<std::optional<PositionFix>> read_row(const std::string& path, const TextLine& line,
                                              const Places& places, std::size_t columns) {
  const auto row = cells(line.text);
  if (row.size() != columns) {
    return broken(path, line.number,
                  fmt::format("{} columns, the header has {}", row.size(), columns));
  }
  auto fix = read_key(path, line.number, places, row);
  if (!fix) return tl::unexpected(fix.error());
  if (says_nothing(row[*places[latitude]]) && says_nothing(row[*places[longitude]])) {
    return std::optional<PositionFix>();
  }
  std::array<double, kColumns.size()> value{};
  value[horizontal] = std::sqrt(fix->covariance_m2(0, 0));
  value[vertical] = std::sqrt(fix->covariance_m2(2, 2));
  for (const Column c : {latitude, longitude, altitude, horizontal, vertical}) {
    if (!places[c]) continue;
    const auto number = to_number(row[*places[c]]);
    if (!number) {
      return broken(path, line.number,
                    fmt::format("{}: \"{}\" is not a number", kColumns[c], row[*places[c]]));
    }
    value[c] = *number;
  }
  fix->position = {value[latitude], value[longitude], value[altitude]};
  fix->covariance_m2 = Eigen::Vector3d(value[horizontal], value[horizontal], value[vertical])
                           .cwiseAbs2()
                           .asDiagonal();
  if (std::string problem = fix->problem(); !problem.empty()) {
    return broken(path, line.number, std::move(problem));
  }
  return std::optional(*std::move(fix));
}

}  // namespace

Expected<PositionsFile> read_positions(const std::string& path) {
  const auto text = read_file_bytes(path);
  if (!text) return tl::unexpected(text.error());
  const std::vector<TextLine> lines = data_lines(*text);
  if (lines.empty()) return fail(ErrorCode::corrupt, "the file says nothing", path);
  const auto places = read_header(path, lines.front());
  if (!places) return tl::unexpected(places.error());
  const std::size_t columns = cells(lines.front().text).size();
  PositionsFile out;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    auto fix = read_row(path, lines[i], *places, columns);
    if (!fix) return tl::unexpected(fix.error());
    if (*fix) {
      out.fixes.push_back(**std::move(fix));
    } else {
      ++out.without_fix;
    }
  }
  if (out.fixes.empty()) return fail(ErrorCode::corrupt, "not one row has a position", path);
  return out;
}

}  // namespace corvid
