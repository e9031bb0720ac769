#include "kernels/cache_file.h"

#include <fmt/core.h>
#include <unistd.h>

#include <atomic>
#include <fstream>
#include <iterator>

namespace corvid {
namespace fs = std::filesystem;

std::uint64_t fnv1a(std::string_view bytes) {
  std::uint64_t hash = 14695981039346656037ULL;
  for (const char c : bytes) {
    hash ^= static_cast<unsigned char>(c);
    hash *= 1099511628211ULL;
  }
  return hash;
}

std::optional<std::string> read_cache_file(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return std::nullopt;
  std::string bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  if (file.bad()) return std::nullopt;
  return bytes;
}

std::error_code write_cache_file(const fs::path& path, std::string_view bytes) {
  static std::atomic<unsigned> counter{0};
  std::error_code error;
  fs::create_directories(path.parent_path(), error);
  const fs::path temporary = fmt::format("{}.{}.{}", path.string(), getpid(), counter++);
  std::ofstream file(temporary, std::ios::binary);
  file << bytes;
  file.close();
  if (!file && !error) error = std::make_error_code(std::errc::io_error);
  if (!error) fs::rename(temporary, path, error);
  if (error) {
    std::error_code ignored;
    fs::remove(temporary, ignored);
  }
  return error;
}

}  // namespace corvid
