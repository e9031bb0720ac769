#pragma once

#include <filesystem>

namespace corvid {

/// Where the engine keeps what it can make again: $XDG_CACHE_HOME/corvid, else ~/.cache/corvid,
/// else empty (then nothing is cached). The folder need not exist.
[[nodiscard]] std::filesystem::path cache_folder();

/// Some machines have NVIDIA's OpenCL driver but no file in /etc/OpenCL/vendors that names it. Then
/// this points the loader (OCL_ICD_VENDORS) to a folder in the cache that holds the system's vendor
/// files and the missing one. Does nothing if the environment already chooses vendors. Failures are
/// only logged.
void add_missing_vendor_file();

}  // namespace corvid
