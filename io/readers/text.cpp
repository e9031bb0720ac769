#include "io/readers/text.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <limits>

namespace corvid {
namespace {
constexpr std::string_view kBlanks = " \t\r\v\f";
bool is_digit(char c) { return c >= '0' && c <= '9'; }
}  // namespace

std::string_view trim(std::string_view text) {
  const std::size_t begin = text.find_first_not_of(kBlanks);
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(kBlanks) - begin + 1);
}

std::vector<TextLine> data_lines(std::string_view text, bool keep_blank) {
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  std::vector<TextLine> lines;
  int number = 0;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    const std::string_view line = trim(text.substr(0, end));
    ++number;
    if (line.empty() ? keep_blank : line.front() != '#') lines.push_back({number, line});
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return lines;
}

std::vector<std::string_view> fields(std::string_view line, std::string_view separators) {
  std::vector<std::string_view> parts;
  for (;;) {
    const std::size_t begin = line.find_first_not_of(separators);
    if (begin == std::string_view::npos) return parts;
    line.remove_prefix(begin);
    const std::size_t end = std::min(line.find_first_of(separators), line.size());
    parts.push_back(line.substr(0, end));
    line.remove_prefix(end);
  }
}

std::optional<double> to_number(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (end != text.data() + text.size()) return {};
  // Too small for a double (1e-400) is zero, not a fault.
  if (error == std::errc::result_out_of_range && text.find_first_of("eE") != text.npos &&
      text[text.find_first_of("eE") + 1] == '-') {
    return 0;
  }
  if (error != std::errc{} || !std::isfinite(value)) return {};
  return value;
}

std::optional<std::int64_t> to_integer(std::string_view text) {
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size()) return {};
  return value;
}

std::optional<std::vector<double>> to_numbers(std::string_view line, std::string_view separators) {
  std::vector<double> numbers;
  for (const std::string_view field : fields(line, separators)) {
    const std::optional<double> number = to_number(field);
    if (!number) return {};
    numbers.push_back(*number);
  }
  return numbers;
}

std::optional<std::int64_t> seconds_to_ns(std::string_view text) {
  constexpr double kMaxSeconds = 9.2e9;
  const std::optional<double> rough = to_number(text);
  if (!rough || std::abs(*rough) > kMaxSeconds) return {};
  if (text.starts_with('+')) text.remove_prefix(1);
  const bool negative = text.starts_with('-');
  if (negative) text.remove_prefix(1);
  const std::size_t point = std::min(text.find('.'), text.size());
  const std::string_view whole = text.substr(0, point);
  const std::string_view part = text.substr(std::min(point + 1, text.size()));
  if (!std::all_of(whole.begin(), whole.end(), is_digit) ||
      !std::all_of(part.begin(), part.end(), is_digit)) {
    return static_cast<std::int64_t>(std::llround(*rough * 1e9));
  }
  std::int64_t ns = 0;
  for (const char c : whole) ns = ns * 10 + (c - '0');
  for (std::size_t i = 0; i < 9; ++i) ns = ns * 10 + (i < part.size() ? part[i] - '0' : 0);
  if (part.size() > 9 && part[9] >= '5') ++ns;
  return negative ? -ns : ns;
}

bool natural_less(std::string_view a, std::string_view b) {
  std::size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    if (!is_digit(a[i]) || !is_digit(b[j])) {
      if (a[i] != b[j]) return static_cast<unsigned char>(a[i]) < static_cast<unsigned char>(b[j]);
      ++i, ++j;
      continue;
    }
    const auto run = [](std::string_view text, std::size_t& at) {
      while (at < text.size() && text[at] == '0') ++at;
      const std::size_t begin = at;
      while (at < text.size() && is_digit(text[at])) ++at;
      return text.substr(begin, at - begin);
    };
    const std::string_view x = run(a, i), y = run(b, j);
    if (x.size() != y.size()) return x.size() < y.size();
    if (x != y) return x < y;
  }
  if (i < a.size() || j < b.size()) return i >= a.size();
  return a < b;  // equal but for leading zeros
}

std::string lower_case(std::string_view text) {
  std::string result(text);
  for (char& c : result) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return result;
}

std::string at_line(const std::string& path, int line) { return path + ":" + std::to_string(line); }

}  // namespace corvid
