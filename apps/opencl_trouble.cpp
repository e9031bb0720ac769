#include "apps/opencl_trouble.h"

#include <fmt/format.h>
#include <unistd.h>

#include "io/atomic_file.h"
#include "kernels/vendor_files.h"

namespace corvid {

namespace fs = std::filesystem;

std::optional<OpenclTrouble> missing_processors(const fs::path& processors) {
  std::error_code ignored;
  if (fs::exists(processors, ignored)) return std::nullopt;
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
  if (error.code != ErrorCode::device || access("/etc/OpenCL/vendors/pocl.icd", R_OK) != 0) {
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
