#include "kernels/cache_file.h"

#include <fmt/core.h>
#include <unistd.h>

#include <atomic>
#include <fstream>
#include <sstream>

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
  // An iterator over the buffer would throw for a folder.
  std::ostringstream bytes;
  if (file.peek() == std::ifstream::traits_type::eof())
    return file.bad() ? std::nullopt : std::optional<std::string>("");
  bytes << file.rdbuf();
  if (file.bad() || !bytes) return std::nullopt;
  return std::move(bytes).str();
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
