#include "apps/opencl_trouble.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cstdlib>

#include "io/atomic_file.h"
#include "kernels/device.h"
#include "kernels/vendor_files.h"

namespace corvid {

namespace fs = std::filesystem;

namespace {

bool names_pocl(const fs::path& vendors) {
  const auto file_names_it = [](const fs::path& file) {
    const auto bytes = read_file_bytes(file);
    return bytes && bytes->find("pocl") != std::string::npos;
  };
  std::error_code ec;
  if (!fs::is_directory(vendors, ec)) return file_names_it(vendors);
  for (fs::directory_iterator it(vendors, ec), end; !ec && it != end; it.increment(ec)) {
    if (it->path().extension() == ".icd" && file_names_it(it->path())) return true;
  }
  return false;
}

}  // namespace

fs::path vendor_files() {
  for (const char* name : {"OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"}) {
    if (const char* chosen = std::getenv(name)) return chosen;
  }
  return "/etc/OpenCL/vendors";
}

std::optional<OpenclTrouble> missing_processors(const fs::path& processors,
                                                const fs::path& vendors) {
  std::error_code ignored;
  if (fs::exists(processors, ignored) || !names_pocl(vendors)) return std::nullopt;
  return OpenclTrouble{"/sys is not mounted: PoCL ends the process without it",
                       "mount -t sysfs sysfs /sys"};
}

std::optional<OpenclTrouble> unusable_cache() {
  const fs::path folder = cache_folder();
  if (folder.empty()) {
    return OpenclTrouble{"neither XDG_CACHE_HOME nor HOME is set",
                         "export XDG_CACHE_HOME=/var/tmp/cache"};
  }
  const fs::path probe = folder / fmt::format("probe-{}", getpid());
  if (auto written = write_file_atomically(probe, "x"); !written) {
    return OpenclTrouble{
        fmt::format("{}: {}", folder.string(), written.error().what),
        fmt::format("export XDG_CACHE_HOME=/var/tmp/cache  # or, if it is yours: sudo chown -R "
                    "\"$(id -u)\" '{}'",
                    folder.string())};
  }
  std::error_code ignored;
  fs::remove(probe, ignored);
  return std::nullopt;
}

Error explained(Error error) {
  // Where devices are listed the error names them, and PoCL has its cache.
  if (error.code != ErrorCode::device || !names_pocl(vendor_files()) || list_devices()) {
    return error;
  }
  if (const auto cache = unusable_cache()) {
    error.what +=
        fmt::format("; PoCL is installed and needs a cache that can be written ({})", cache->what);
    error.hint = cache->remedy;
  }
  return error;
}

}  // namespace corvid
