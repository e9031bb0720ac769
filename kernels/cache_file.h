#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>

// Files in cache_folder(): what can be made again, written by several processes at a time.
namespace corvid {

/// FNV-1a, 64 bits: names files and detects damage; it does not resist an adversary.
[[nodiscard]] std::uint64_t fnv1a(std::string_view bytes);

/// The whole file; nothing if it cannot be read.
[[nodiscard]] std::optional<std::string> read_cache_file(const std::filesystem::path& path);

/// Makes the folder and writes the file under another name first: a reader sees the old file or the
/// new one, whole. Nothing is left behind on failure.
[[nodiscard]] std::error_code write_cache_file(const std::filesystem::path& path,
                                               std::string_view bytes);

}  // namespace corvid
