#include "bench/machine.h"

#include <fmt/format.h>

#include <cstdlib>
#include <fstream>
#include <opencv2/core.hpp>
#include <ostream>
#include <string>
#include <thread>

namespace corvid {
namespace {

std::string processor_name() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    const auto colon = line.find(": ");
    if (line.starts_with("model name") && colon != std::string::npos) return line.substr(colon + 2);
  }
  return "unknown processor";
}

BenchMachine describe(const Device& device) {
  BenchMachine machine;
  machine.processor = processor_name();
  machine.cores = static_cast<int>(std::thread::hardware_concurrency());
  if (getloadavg(&machine.load_average, 1) != 1) machine.load_average = -1;
  const DeviceInfo& info = device.info();
  machine.device = fmt::format("{} ({})", info.name, info.platform);
  machine.driver = device.device().getInfo<CL_DRIVER_VERSION>();
  machine.gpu = info.gpu;
  machine.compute_units = info.compute_units;
  machine.opencv = CV_VERSION;
  machine.compiler = CORVID_COMPILER;
  machine.opencv_threads = cv::getNumThreads();
  return machine;
}

}  // namespace

Expected<BenchMachine> bench_machine(const Device& device) {
  cv::setNumThreads(-1);
  return opening_on_device(device, [&] { return describe(device); });
}

void print_machine(const BenchMachine& m, std::ostream& out) {
  out << fmt::format("machine   {}, {} cores", m.processor, m.cores);
  if (m.load_average >= 0) out << fmt::format(", load average {:.1f} at the start", m.load_average);
  out << fmt::format("\ndevice    {}, {}, {} units, driver {}\n", m.device, m.gpu ? "GPU" : "CPU",
                     m.compute_units, m.driver);
  out << fmt::format("software  OpenCV {} ({} threads), {}\n", m.opencv, m.opencv_threads,
                     m.compiler);
}

}  // namespace corvid
