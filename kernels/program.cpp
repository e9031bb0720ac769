#include "kernels/program.h"

#include <fmt/core.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <vector>

#include "core/log.h"
#include "kernels/cache_file.h"
#include "kernels/vendor_files.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

constexpr std::string_view kMagic = "corvid program 1";

struct Source {
  std::string text, id;  // id: identifies the text
};

Expected<Source> find_file(std::string_view name) {
  if (const char* folder = std::getenv("CORVID_KERNEL_DIR"); folder != nullptr && *folder != 0) {
    const fs::path path = fs::path(folder) / (std::string(name) + ".cl");
    auto text = read_cache_file(path);
    if (!text)
      return fail(ErrorCode::not_found, "kernel source cannot be read", path.string(),
                  "unset CORVID_KERNEL_DIR to use the built-in kernels");
    std::string id = fmt::format("{:016x}-{}", fnv1a(*text), text->size());
    return Source{std::move(*text), std::move(id)};
  }
  for (const EmbeddedKernel& kernel : embedded_kernels())
    if (kernel.name == name) return Source{std::string(kernel.source), std::string(kernel.sha256)};
  return fail(ErrorCode::not_found, "no such kernel", std::string(name));
}

// One file, or several joined by '+'.
Expected<Source> find_source(std::string_view names) {
  Source all;
  while (true) {
    const std::size_t end = names.find('+');
    auto part = find_file(names.substr(0, end));
    if (!part || (end == std::string_view::npos && all.id.empty())) return part;
    all.text += part->text;
    all.id += (all.id.empty() ? "" : "+") + part->id;
    if (end == std::string_view::npos) return all;
    names.remove_prefix(end + 1);
  }
}

// File: magic, key, size and checksum on a line each, then the device's binary.
std::string file_header(std::string_view key, std::string_view binary) {
  return fmt::format("{}\n{}\n{} {:016x}\n", kMagic, key, binary.size(), fnv1a(binary));
}

std::optional<std::vector<unsigned char>> load_binary(const fs::path& path,
                                                      const std::string& key) {
  const auto bytes = read_cache_file(path);
  if (!bytes) return std::nullopt;
  // The header is rebuilt from the rest of the file: any damage makes the two differ.
  std::size_t start = 0;
  for (int line = 0; line < 3 && start != std::string::npos; ++line) {
    start = bytes->find('\n', start);
    if (start != std::string::npos) ++start;
  }
  const std::string_view all = *bytes;
  if (start == std::string::npos || all.substr(0, start) != file_header(key, all.substr(start))) {
    log().warn("{}: not a program for this device and source, ignored", path.string());
    return std::nullopt;
  }
  return std::vector<unsigned char>(bytes->begin() + static_cast<std::ptrdiff_t>(start),
                                    bytes->end());
}

void store_binary(const fs::path& path, const std::string& key, const cl::Program& program) {
  const auto binaries = program.getInfo<CL_PROGRAM_BINARIES>();
  if (binaries.empty() || binaries[0].empty()) return;
  const std::string binary(binaries[0].begin(), binaries[0].end());
  if (const auto error = write_cache_file(path, file_header(key, binary) + binary))
    log().warn("{}: the program cache cannot be written ({})", path.string(), error.message());
}

std::string build_log(const cl::Program& program, const cl::Device& device) {
  try {
    return program.getBuildInfo<CL_PROGRAM_BUILD_LOG>(device);
  } catch (const cl::Error&) {
    return "no build log";
  }
}

}  // namespace

Expected<std::string> program_id(std::string_view name) {
  auto source = find_source(name);
  if (!source) return tl::unexpected(source.error());
  return std::move(source->id);
}

// Has access to the device's memory of programs.
class ProgramStore {
 public:
  static Expected<cl::Program> build(Device& device, std::string_view name,
                                     const std::string& options) {
    auto source = find_source(name);
    if (!source) return tl::unexpected(source.error());
    const std::string all_options = options.empty() ? "-cl-std=CL1.2" : "-cl-std=CL1.2 " + options;
    std::string key =
        fmt::format("{} {} | {} | {} | {} | {}", name, source->id, all_options,
                    device.info().platform, device.info().name, device.info().version);
    std::replace(key.begin(), key.end(), '\n', ' ');

    const std::lock_guard lock(device.programs_mutex_);
    if (const auto found = device.programs_.find(key); found != device.programs_.end())
      return found->second;

    const fs::path cache = cache_folder();
    const fs::path path = cache / "programs" / fmt::format("{}-{:016x}.bin", name, fnv1a(key));
    if (!cache.empty()) {
      if (const auto binary = load_binary(path, key)) {
        try {
          cl::Program program(device.context(), {device.device()}, {*binary});
          program.build(all_options.c_str());
          return device.programs_[key] = program;
        } catch (const cl::Error& e) {
          log().warn("{}: refused by the driver ({}), built anew", path.string(), e.err());
        }
      }
    }

    cl::Program program;
    try {
      program = cl::Program(device.context(), source->text);
      program.build(all_options.c_str());
    } catch (const cl::Error& e) {
      return fail(ErrorCode::device,
                  fmt::format("kernel does not build (OpenCL error {}): {}", e.err(),
                              build_log(program, device.device())),
                  fmt::format("{}.cl [{}] on {}", name, all_options, device.info().name));
    }
    if (!cache.empty()) {
      try {
        store_binary(path, key, program);
      } catch (const cl::Error& e) {
        log().warn("{}: the driver gives no binary to cache ({})", path.string(), e.err());
      }
    }
    return device.programs_[key] = program;
  }
};

Expected<cl::Program> build_program(Device& device, std::string_view name,
                                    const std::string& options) {
  return ProgramStore::build(device, name, options);
}

}  // namespace corvid
