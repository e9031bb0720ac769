#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "corvid/error.h"
#include "kernels/opencl.h"

namespace corvid {

/// An OpenCL call that failed while work was under way: the device vanished, ran out of memory or
/// refused a launch. Every launcher of this room throws it and nothing else for such faults;
/// whoever runs a stage catches it. Opening and building (open(), create()) return Expected.
class DeviceFault : public std::runtime_error {
 public:
  DeviceFault(std::string_view what, int code);
  [[nodiscard]] int code() const { return code_; }  ///< CL_... error code

 private:
  int code_;
};

class Tuning;

struct DeviceInfo {
  int index = 0;  ///< what `--device N` means
  std::string name, vendor, platform, version;
  bool gpu = false;
  std::uint64_t memory_bytes = 0;
  int compute_units = 0;
};

/// All usable OpenCL devices in the order of the platforms. Fails, with what to install, if there
/// is none.
[[nodiscard]] Expected<std::vector<DeviceInfo>> list_devices();

/// Two in-order queues: what the camera waits for, and what may take its time.
enum class Lane { tracking, mapping };

/// One OpenCL device with its context and queues. Thread-safe: queues may be used from any thread,
/// launchers (which own cl::Kernel objects) each from one thread at a time.
class Device {
 public:
  /// @param choice  auto (a GPU if there is one, else the CPU), cpu, gpu, or an index of
  ///                list_devices().
  /// @param cpu_threads  caps PoCL's worker threads, 0: all cores. PoCL reads the cap once per
  ///                process, so only the first call in a process (of this or of list_devices())
  ///                can set it; a POCL_MAX_PTHREAD_COUNT in the environment takes precedence.
  ///
  /// The first call sets environment variables for the OpenCL loader: make it before other threads
  /// read the environment.
  [[nodiscard]] static Expected<std::shared_ptr<Device>> open(std::string_view choice,
                                                              int cpu_threads = 0);
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  [[nodiscard]] const DeviceInfo& info() const { return info_; }
  [[nodiscard]] const cl::Context& context() const { return context_; }
  [[nodiscard]] const cl::Device& device() const { return device_; }
  [[nodiscard]] const cl::CommandQueue& queue(Lane lane) const {
    return lane == Lane::tracking ? tracking_ : mapping_;
  }
  /// What was measured to be fastest here.
  [[nodiscard]] Tuning& tuning() const { return *tuning_; }

 private:
  friend class ProgramStore;
  Device(DeviceInfo info, const cl::Device& device);

  DeviceInfo info_;
  cl::Device device_;
  cl::Context context_;
  cl::CommandQueue tracking_, mapping_;
  std::shared_ptr<Tuning> tuning_;
  std::mutex programs_mutex_;
  std::map<std::string, cl::Program> programs_;  // by source, options
};

/// Runs f; an OpenCL exception comes out as DeviceFault "what: OpenCL call (code)".
template <class F>
decltype(auto) on_device(std::string_view what, F&& f) {
  try {
    return std::forward<F>(f)();
  } catch (const cl::Error& e) {
    throw DeviceFault(std::string(what) + ": " + e.what(), e.err());
  }
}

/// Runs f, which makes an object; an OpenCL exception or a DeviceFault comes out as Error.
template <class F>
auto opening_on_device(const Device& device, F&& f) -> Expected<decltype(f())> {
  try {
    return std::forward<F>(f)();
  } catch (const cl::Error& e) {
    return fail(ErrorCode::device, DeviceFault(e.what(), e.err()).what(), device.info().name);
  } catch (const DeviceFault& e) {
    return fail(ErrorCode::device, e.what(), device.info().name);
  }
}

}  // namespace corvid
