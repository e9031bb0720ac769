#pragma once

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <string>

namespace corvid {

/// For the command line: a number of at least `low`, or, with `above`, of more than `low`.
inline CLI::Validator at_least(double low, bool above = false) {
  const std::string range =
      above ? fmt::format("more than {}", low) : fmt::format("at least {}", low);
  return CLI::Validator(
      [=](std::string& text) {
        double value = 0;
        const bool good = CLI::detail::lexical_cast(text, value) && std::isfinite(value) &&
                          (above ? value > low : value >= low);
        return good ? std::string() : fmt::format("must be {}, not {}", range, text);
      },
      "", "");
}
inline CLI::Validator above(double low) { return at_least(low, true); }

}  // namespace corvid
