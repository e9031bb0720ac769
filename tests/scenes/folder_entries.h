#pragma once

#include <cstddef>
#include <filesystem>
#include <iterator>

namespace corvid {

/// How many there are: of /proc/self/fd open files, of /proc/self/task threads.
inline std::size_t entries_of(const std::filesystem::path& folder) {
  namespace fs = std::filesystem;
  return static_cast<std::size_t>(
      std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}

}  // namespace corvid
