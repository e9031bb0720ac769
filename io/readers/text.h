#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace corvid {

/// One line of a text file that says something.
struct TextLine {
  int number = 0;  ///< from 1, as editors count
  std::string_view text;
};

/// The lines without surrounding blanks, CR and byte-order mark; lines that start with '#' and,
/// unless they are wanted, blank lines are left out. Views into `text`.
[[nodiscard]] std::vector<TextLine> data_lines(std::string_view text, bool keep_blank = false);

/// `text` without blanks, tabs and CR at its ends.
[[nodiscard]] std::string_view trim(std::string_view text);

/// The parts between separators; empty parts are left out.
[[nodiscard]] std::vector<std::string_view> fields(std::string_view line,
                                                   std::string_view separators = " \t,;");

/// The whole of `text` as a finite number, in the C locale; nothing if it is anything else.
[[nodiscard]] std::optional<double> to_number(std::string_view text);
[[nodiscard]] std::optional<std::int64_t> to_integer(std::string_view text);
/// Every field as a finite number; nothing if one is not.
[[nodiscard]] std::optional<std::vector<double>> to_numbers(std::string_view line,
                                                            std::string_view separators = " \t,;");
/// Seconds to nanoseconds, exact for plain decimals ("1305031102.175304"); numbers with an exponent
/// go through a double. Nothing beyond +-292 years.
[[nodiscard]] std::optional<std::int64_t> seconds_to_ns(std::string_view text);

/// Order of names in which runs of digits compare as numbers: img_2 before img_10.
[[nodiscard]] bool natural_less(std::string_view a, std::string_view b);
/// A to Z to lower case; other bytes stay.
[[nodiscard]] std::string lower_case(std::string_view text);
/// "path:line".
[[nodiscard]] std::string at_line(const std::string& path, int line);

}  // namespace corvid
