#include <fcntl.h>
#include <fmt/format.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <sys/sysinfo.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <locale>
#include <memory>
#include <nlohmann/json.hpp>
#include <ostream>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "apps/command_list.h"
#include "apps/opencl_trouble.h"
#include "apps/progress.h"
#include "kernels/device.h"
#include "kernels/vendor_files.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;

enum class Verdict { ok, note, warning, failure };
constexpr std::string_view kVerdicts[] = {"ok", "note", "warning", "FAILURE"};

struct Finding {
  std::string_view topic;
  Verdict verdict = Verdict::ok;
  std::string text;
  std::string remedy;  ///< the command that mends it; empty where nothing is wrong
};
using Findings = std::vector<Finding>;

// Compiles and runs one kernel and looks at what it computed; empty if the device works.
std::string try_device(int index) {
  static constexpr const char* kSource =
      "__kernel void probe(__global int* x) { x[get_global_id(0)] = 3 * get_global_id(0) + 1; }";
  auto device = Device::open(std::to_string(index));
  if (!device) return device.error().to_string();
  cl::Program program;
  try {
    constexpr std::size_t kCount = 64;
    program = cl::Program((*device)->context(), kSource);
    program.build("-cl-std=CL1.2");
    cl::Kernel kernel(program, "probe");
    const cl::Buffer buffer((*device)->context(), CL_MEM_WRITE_ONLY, kCount * sizeof(cl_int));
    kernel.setArg(0, buffer);
    const cl::CommandQueue& queue = (*device)->queue(Lane::tracking);
    queue.enqueueNDRangeKernel(kernel, cl::NullRange, cl::NDRange(kCount));
    std::vector<cl_int> result(kCount);
    queue.enqueueReadBuffer(buffer, CL_TRUE, 0, kCount * sizeof(cl_int), result.data());
    for (std::size_t i = 0; i < kCount; ++i) {
      if (result[i] != static_cast<cl_int>(3 * i + 1)) return "a kernel gave a wrong result";
    }
  } catch (const cl::Error& error) {
    return fmt::format("{} failed ({})", error.what(), error.err());
  }
  return {};
}

void examine_opencl(Findings& findings) {
  constexpr const char* kInstall = "sudo apt-get install pocl-opencl-icd";
  if (const auto trouble = missing_processors()) {
    findings.push_back({"opencl", Verdict::failure, trouble->what, trouble->remedy});
    return;
  }
  auto devices = list_devices();
  if (!devices) {
    const Error known = explained(devices.error());
    const bool by_cache = known.what != devices.error().what;
    findings.push_back({"opencl", Verdict::failure, known.what, by_cache ? known.hint : kInstall});
    return;
  }
  bool any = false;
  for (const DeviceInfo& device : *devices) {
    const std::string name =
        fmt::format("device {}: {} ({}, {} units, {:.1f} GB, {})", device.index, device.name,
                    device.gpu ? "GPU" : "CPU", device.compute_units,
                    static_cast<double>(device.memory_bytes) / 1e9, device.platform);
    const std::string problem = try_device(device.index);
    any = any || problem.empty();
    if (problem.empty()) {
      findings.push_back({"opencl", Verdict::ok, name + " builds and runs a kernel", ""});
    } else {
      findings.push_back({"opencl", Verdict::warning, name + ": " + problem,
                          device.gpu ? "corvid replay --device cpu ..." : kInstall});
    }
  }
  if (!any) {
    findings.push_back({"opencl", Verdict::failure, "no OpenCL device can run a kernel", kInstall});
  }
}

Finding examine_cache() {
  if (const auto trouble = unusable_cache()) {
    return {"cache", Verdict::warning, trouble->what + "; kernels are compiled at every start",
            trouble->remedy};
  }
  return {"cache", Verdict::ok, cache_folder().string() + " can be written", ""};
}

void examine_camera(const fs::path& node, Findings& findings) {
  const int fd = open(node.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) {
    const int error = errno;
    findings.push_back(
        {"camera", Verdict::warning, fmt::format("{}: {}", node.string(), std::strerror(error)),
         error == EACCES  ? "sudo usermod -aG video \"$USER\"  # then log in again"
         : error == EBUSY ? fmt::format("fuser -v {}  # who holds it", node.string())
                          : fmt::format("v4l2-ctl --device {} --all", node.string())});
    return;
  }
  v4l2_capability capability{};
  const bool known = ioctl(fd, VIDIOC_QUERYCAP, &capability) == 0;
  close(fd);
  if (!known) {
    findings.push_back({"camera", Verdict::note, node.string() + " is not a V4L2 device", ""});
    return;
  }
  const auto caps = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? capability.device_caps
                                                                          : capability.capabilities;
  const bool capture = (caps & (V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_VIDEO_CAPTURE_MPLANE)) != 0;
  findings.push_back(
      {"camera", capture ? Verdict::ok : Verdict::note,
       fmt::format("{}: {}{}", node.string(), reinterpret_cast<const char*>(capability.card),
                   capture ? "" : " (gives no pictures)"),
       ""});
}

void examine_cameras(Findings& findings) {
  std::vector<fs::path> nodes;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator("/dev", error)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with("video") && name.find_first_not_of("0123456789", 5) == std::string::npos) {
      nodes.push_back(entry.path());
    }
  }
  std::sort(nodes.begin(), nodes.end());
  for (const fs::path& node : nodes) examine_camera(node, findings);
  if (nodes.empty()) {
    findings.push_back({"camera", Verdict::note, "no V4L2 camera; recordings need none", ""});
  }
  bool libcamera = false;
  for (const char* folder : {"/usr/lib", "/usr/local/lib", "/usr/lib/x86_64-linux-gnu",
                             "/usr/lib/aarch64-linux-gnu", "/usr/lib/arm-linux-gnueabihf"}) {
    for (const auto& entry : fs::directory_iterator(folder, error)) {
      libcamera = libcamera || entry.path().filename().string().starts_with("libcamera.so");
    }
  }
  findings.push_back({"libcamera", Verdict::note,
                      libcamera ? "installed" : "not installed; only cameras on CSI ports need it",
                      ""});
}

void examine_resources(Findings& findings) {
  constexpr double kEnoughGb = 2;
  double available_gb = 0;
  std::ifstream meminfo("/proc/meminfo");
  for (std::string line; std::getline(meminfo, line);) {
    constexpr std::string_view kName = "MemAvailable:";
    if (line.starts_with(kName)) available_gb = std::stod(line.substr(kName.size())) / 1e6;
  }
  const bool memory = available_gb >= kEnoughGb;
  findings.push_back({"memory", memory ? Verdict::ok : Verdict::warning,
                      fmt::format("{:.1f} GB available, {} threads", available_gb,
                                  std::thread::hardware_concurrency()),
                      memory ? "" : "corvid replay --set mapping.memory_mb=64 ..."});
  std::error_code error;
  const fs::path here = fs::current_path(error);
  const fs::space_info space = fs::space(error ? fs::path("/") : here, error);
  const double free_gb = error ? 0 : static_cast<double>(space.available) / 1e9;
  const bool disk = free_gb >= kEnoughGb;
  findings.push_back({"disk", disk ? Verdict::ok : Verdict::warning,
                      fmt::format("{:.1f} GB free in {}", free_gb, here.string()),
                      disk ? "" : "df -h  # then write to another disk with --out"});
}

void examine_locale(Findings& findings) {
  try {
    const std::locale user("");
    findings.push_back({"locale", Verdict::ok, user.name(), ""});
  } catch (const std::runtime_error&) {
    findings.push_back({"locale", Verdict::warning,
                        "the locale that LANG or LC_* name is not installed; numbers are written "
                        "with a point all the same",
                        "export LC_ALL=C.UTF-8"});
  }
}

Expected<ExitCode> run(bool json, Context& context) {
  Findings findings;
  examine_opencl(findings);
  findings.push_back(examine_cache());
  examine_cameras(findings);
  examine_resources(findings);
  examine_locale(findings);
  const bool runs = std::none_of(findings.begin(), findings.end(),
                                 [](const Finding& f) { return f.verdict == Verdict::failure; });
  if (json) {
    nlohmann::ordered_json list = nlohmann::ordered_json::array();
    for (const Finding& f : findings) {
      list.push_back({{"topic", f.topic},
                      {"verdict", kVerdicts[static_cast<std::size_t>(f.verdict)]},
                      {"text", f.text},
                      {"remedy", f.remedy}});
    }
    write_json_line(context.out, {{"version", CORVID_VERSION}, {"runs", runs}, {"findings", list}});
  } else {
    context.out << "corvid " CORVID_VERSION "\n";
    for (const Finding& f : findings) {
      context.out << fmt::format("{:<8} {:<10} {}\n",
                                 kVerdicts[static_cast<std::size_t>(f.verdict)], f.topic, f.text);
      if (!f.remedy.empty()) context.out << fmt::format("{:>20}mend it: {}\n", "", f.remedy);
    }
    context.out << (runs ? "The engine can run here.\n" : "The engine cannot run here.\n");
  }
  return runs ? ExitCode::ok : ExitCode::device;
}

}  // namespace

Action add_doctor_command(CLI::App& app) {
  auto json = std::make_shared<bool>(false);
  CLI::App* command =
      app.add_subcommand("doctor", "Examine this machine; every fault with what mends it");
  command->add_flag("--json", *json, "One JSON object on the standard output");
  command->footer("\nExit code 5 if the engine cannot run, else 0.\n");
  return [json](Context& context) { return run(*json, context); };
}

}  // namespace corvid
