#include "kernels/vendor_files.h"

#include <dlfcn.h>

#include <cstdlib>
#include <fstream>
#include <string>
#include <system_error>

#include "core/log.h"

namespace corvid {
namespace fs = std::filesystem;

fs::path cache_folder() {
  if (const char* xdg = std::getenv("XDG_CACHE_HOME"); xdg != nullptr && *xdg != '\0')
    return fs::path(xdg) / "corvid";
  if (const char* home = std::getenv("HOME"); home != nullptr && *home != '\0')
    return fs::path(home) / ".cache" / "corvid";
  return {};
}

void add_missing_vendor_file() {
  constexpr const char* kLibrary = "libnvidia-opencl.so.1";
  const fs::path system = "/etc/OpenCL/vendors";
  if (std::getenv("OCL_ICD_VENDORS") != nullptr || std::getenv("OPENCL_VENDOR_PATH") != nullptr)
    return;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(system, error)) {
    std::ifstream file(entry.path());
    std::string library;
    if (std::getline(file, library) && library.find("nvidia") != std::string::npos) return;
  }
  void* handle = dlopen(kLibrary, RTLD_LAZY | RTLD_LOCAL);
  if (handle == nullptr) return;
  dlclose(handle);
  const fs::path folder = cache_folder() / "opencl_vendors";
  if (!folder.is_absolute()) return;
  fs::create_directories(folder, error);
  for (const auto& entry : fs::directory_iterator(system, error))
    fs::copy_file(entry.path(), folder / entry.path().filename(),
                  fs::copy_options::overwrite_existing, error);
  std::ofstream file(folder / "corvid_nvidia.icd");
  file << kLibrary << '\n';
  file.close();
  if (!file) {
    log().warn("{}: cannot be written, so NVIDIA's OpenCL driver stays unseen", folder.string());
    return;
  }
  setenv("OCL_ICD_VENDORS", folder.c_str(), 0);
  log().info("OpenCL vendor files are read from {}", folder.string());
}

}  // namespace corvid
