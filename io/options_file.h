#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <variant>

#include "corvid/error.h"
#include "corvid/options.h"

namespace corvid {

/// Where one option lives inside an Options.
using OptionPointer = std::variant<bool*, int*, double*, std::uint64_t*, std::string*>;

/// One row of the table that reading, writing, --set, help and error messages share.
struct OptionField {
  std::string_view key;  ///< "frontend.max_tracks"
  std::string_view doc;  ///< one sentence, with the unit in brackets
  OptionPointer (*pointer)(Options&);

  [[nodiscard]] std::string_view type() const;  ///< "true or false", "whole number", ...
  /// The value as the options file has it; parse and print round-trip exactly.
  [[nodiscard]] std::string text(const Options& options) const;
};

/// Every option, in the order of the aggregates' members.
[[nodiscard]] std::span<const OptionField> option_fields();

/// Sets one option from text. Unknown keys name the nearest known one.
/// @param where  for the error: "--set" or "file:line".
[[nodiscard]] Expected<void> set_option(Options& options, std::string_view key,
                                        std::string_view text, const std::string& where);

/// Reads YAML: sections of keys (`frontend: {max_tracks: 500}`) or dotted keys
/// (`frontend.max_tracks: 500`). Keys that are absent keep their value in `base`.
/// Errors carry file:line; after the last key the whole is validated.
/// @param where  the name of the text in errors.
[[nodiscard]] Expected<Options> parse_options(const std::string& yaml, const std::string& where,
                                              const Options& base = {});
[[nodiscard]] Expected<Options> read_options_file(const std::filesystem::path& path,
                                                  const Options& base = {});

/// All problems of Options::validate() as one error; ok if there are none.
[[nodiscard]] Expected<void> check_options(const Options& options, const std::string& where);

/// Every option with its documentation as a comment; parse_options() reads it back exactly.
[[nodiscard]] std::string options_to_yaml(const Options& options);
[[nodiscard]] Expected<void> write_options_file(const std::filesystem::path& path,
                                                const Options& options);

}  // namespace corvid
