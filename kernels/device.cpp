#include "kernels/device.h"

#include <fmt/core.h>

#include <algorithm>
#include <charconv>
#include <cstdlib>

#include "core/log.h"
#include "kernels/tuning.h"
#include "kernels/vendor_files.h"

namespace corvid {
namespace {

constexpr int kNoPlatform = -1001;  // CL_PLATFORM_NOT_FOUND_KHR
constexpr std::string_view kInstallHint =
    "install an OpenCL driver; for the CPU: apt install pocl-opencl-icd";

std::string_view code_name(int code) {
  switch (code) {
    case CL_DEVICE_NOT_AVAILABLE:
      return "device not available";
    case CL_MEM_OBJECT_ALLOCATION_FAILURE:
      return "device memory exhausted";
    case CL_OUT_OF_RESOURCES:
      return "out of resources";
    case CL_OUT_OF_HOST_MEMORY:
      return "host memory exhausted";
    case CL_INVALID_BUFFER_SIZE:
      return "invalid buffer size";
    case CL_BUILD_PROGRAM_FAILURE:
      return "program does not build";
    case kNoPlatform:
      return "no platform";
    default:
      return "OpenCL error";
  }
}

// What must be in the environment before the loader reads it, which it does once per process.
void prepare_environment(int cpu_threads) {
  static std::once_flag once;
  std::call_once(once, [&] {
    if (cpu_threads > 0) setenv("POCL_MAX_PTHREAD_COUNT", std::to_string(cpu_threads).c_str(), 0);
    add_missing_vendor_file();
  });
}

DeviceInfo describe(const cl::Device& device, const std::string& platform, int index) {
  DeviceInfo info;
  info.index = index;
  info.name = device.getInfo<CL_DEVICE_NAME>();
  info.vendor = device.getInfo<CL_DEVICE_VENDOR>();
  info.platform = platform;
  info.version =
      device.getInfo<CL_DEVICE_VERSION>() + ", driver " + device.getInfo<CL_DRIVER_VERSION>();
  info.gpu = (device.getInfo<CL_DEVICE_TYPE>() & CL_DEVICE_TYPE_GPU) != 0;
  info.memory_bytes = device.getInfo<CL_DEVICE_GLOBAL_MEM_SIZE>();
  info.compute_units = static_cast<int>(device.getInfo<CL_DEVICE_MAX_COMPUTE_UNITS>());
  return info;
}

using Found = std::vector<std::pair<DeviceInfo, cl::Device>>;

Expected<Found> find_devices() {
  Found found;
  try {
    std::vector<cl::Platform> platforms;
    cl::Platform::get(&platforms);
    for (const cl::Platform& platform : platforms) {
      std::vector<cl::Device> devices;
      std::string name;
      try {
        platform.getDevices(CL_DEVICE_TYPE_ALL, &devices);
        name = platform.getInfo<CL_PLATFORM_NAME>();
      } catch (const cl::Error& e) {
        // A driver without its hardware must not hide the other platforms.
        log().debug("OpenCL platform without devices: {} ({})", e.what(), e.err());
        continue;
      }
      for (const cl::Device& device : devices) {
        try {
          if (device.getInfo<CL_DEVICE_AVAILABLE>() == CL_FALSE ||
              device.getInfo<CL_DEVICE_COMPILER_AVAILABLE>() == CL_FALSE)
            continue;
          found.emplace_back(describe(device, name, static_cast<int>(found.size())), device);
        } catch (const cl::Error& e) {  // nor one broken device the others
          log().debug("OpenCL device that does not say what it is: {} ({})", e.what(), e.err());
        }
      }
    }
  } catch (const cl::Error& e) {
    if (e.err() != kNoPlatform)
      return fail(ErrorCode::device, DeviceFault(e.what(), e.err()).what(), "OpenCL",
                  std::string(kInstallHint));
  }
  if (found.empty())
    return fail(ErrorCode::device, "no usable OpenCL device", "OpenCL", std::string(kInstallHint));
  return found;
}

std::string listing(const Found& found) {
  std::string text;
  for (const auto& [info, device] : found)
    text += fmt::format("{}{}: {} ({})", text.empty() ? "" : "; ", info.index, info.name,
                        info.gpu ? "gpu" : "cpu");
  return text;
}

}  // namespace

DeviceFault::DeviceFault(std::string_view what, int code)
    : std::runtime_error(fmt::format("{}: {} ({})", what, code_name(code), code)), code_(code) {}

Expected<std::vector<DeviceInfo>> list_devices() {
  prepare_environment(0);
  auto found = find_devices();
  if (!found) return tl::unexpected(found.error());
  std::vector<DeviceInfo> infos;
  for (auto& [info, device] : *found) infos.push_back(std::move(info));
  return infos;
}

Device::Device(DeviceInfo info, const cl::Device& device)
    : info_(std::move(info)),
      device_(device),
      context_(device),
      tracking_(context_, device),
      mapping_(context_, device),
      tuning_(std::make_shared<Tuning>(info_)) {}

Expected<std::shared_ptr<Device>> Device::open(std::string_view choice, int cpu_threads) {
  prepare_environment(cpu_threads);
  auto found = find_devices();
  if (!found) return tl::unexpected(found.error());
  const auto first = [&](bool gpu) {
    return std::find_if(found->begin(), found->end(),
                        [gpu](const auto& entry) { return entry.first.gpu == gpu; });
  };
  auto pick = found->end();
  if (choice == "auto" || choice == "gpu") {
    pick = first(true);
    if (pick == found->end() && choice == "auto") pick = first(false);
  } else if (choice == "cpu") {
    pick = first(false);
  } else {
    int index = -1;
    const auto [end, error] = std::from_chars(choice.data(), choice.data() + choice.size(), index);
    if (error != std::errc{} || end != choice.data() + choice.size())
      return fail(ErrorCode::invalid_argument, "not a device: auto, cpu, gpu or an index is wanted",
                  fmt::format("device '{}'", choice), "devices are " + listing(*found));
    if (index >= 0 && index < static_cast<int>(found->size())) pick = found->begin() + index;
  }
  if (pick == found->end())
    return fail(ErrorCode::device, "no such OpenCL device", fmt::format("device '{}'", choice),
                "devices are " + listing(*found) +
                    (choice == "cpu" ? "; for the CPU: apt install pocl-opencl-icd" : ""));
  try {
    return std::shared_ptr<Device>(new Device(pick->first, pick->second));
  } catch (const cl::Error& e) {
    return fail(ErrorCode::device, DeviceFault(e.what(), e.err()).what(), pick->first.name);
  }
}

}  // namespace corvid
