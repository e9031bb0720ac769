#include "bench/peak_meter.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <string>

#include "bench/timing.h"
#include "kernels/launch.h"

namespace corvid {
namespace {

// Latency times throughput of today's cores is 8 to 10 multiply-adds in flight; 12 vectors and two
// constants fit in 16 registers.
constexpr int kChains = 12, kRepeated = 8;
constexpr int kCopyLanes = 4;

std::string source(int lanes) {
  std::string chains, steps, sum = "0";
  for (int i = 0; i < kChains; ++i) {
    chains += fmt::format("  V a{} = (V)(0.1f * {} + 1e-6f * get_global_id(0));\n", i, i);
    sum += fmt::format(" + a{}", i);
  }
  for (int repeated = 0; repeated < kRepeated; ++repeated) {
    for (int i = 0; i < kChains; ++i) steps += fmt::format("    a{0} = fma(a{0}, m, c);\n", i);
  }
  return fmt::format(
      "typedef float{} V;\n"
      "__kernel void chains(__global V* out, const int rounds, const float scale,\n"
      "                     const float shift) {{\n"
      "  const V m = (V)(scale), c = (V)(shift);\n"
      "{}  for (int i = 0; i < rounds; ++i) {{\n{}  }}\n"
      "  out[get_global_id(0)] = {};\n"
      "}}\n"
      "__kernel void copy(__global const float4* from, __global float4* to) {{\n"
      "  to[get_global_id(0)] = from[get_global_id(0)];\n"
      "}}\n",
      lanes == 1 ? "" : std::to_string(lanes), chains, steps, sum);
}

template <class F>
double timed_ms(F&& f) {
  const auto start = std::chrono::steady_clock::now();
  f();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
      .count();
}

}  // namespace

PeakMeter::PeakMeter(std::shared_ptr<Device> device, const cl::Program& program, int lanes)
    : device_(std::move(device)),
      chains_(program, "chains"),
      copy_(program, "copy"),
      lanes_(lanes),
      group_(device_->info().gpu ? 256 : 1) {
  const auto units = static_cast<std::size_t>(std::max(1, device_->info().compute_units));
  items_ = device_->info().gpu ? units * 256 * 16 : units * 16;
  copied_bytes_ = std::clamp<std::uint64_t>(device_->info().memory_bytes / 16, 1 << 20,
                                            std::uint64_t{256} << 20);
  copied_bytes_ &= ~std::size_t{0xFFFF};  // whole work-groups
  const auto buffer = [&](std::size_t bytes) {
    return cl::Buffer(device_->context(), CL_MEM_READ_WRITE, bytes);
  };
  result_ = buffer(items_ * static_cast<std::size_t>(lanes_) * sizeof(float));
  from_ = buffer(copied_bytes_);
  to_ = buffer(copied_bytes_);
  device_->queue(Lane::tracking).enqueueFillBuffer(from_, cl_uint{1}, 0, copied_bytes_);
}

Expected<PeakMeter> PeakMeter::create(std::shared_ptr<Device> device) {
  return opening_on_device(*device, [&] {
    const auto native =
        static_cast<int>(device->device().getInfo<CL_DEVICE_NATIVE_VECTOR_WIDTH_FLOAT>());
    const int lanes = device->info().gpu ? 1 : native >= 16 ? 16 : native >= 8 ? 8 : 4;
    cl::Program program(device->context(), source(lanes));
    program.build("-cl-std=CL1.2");
    PeakMeter meter(device, program, lanes);
    (void)meter.chains_ms();  // drivers compile at the first launch
    (void)meter.copy_ms();
    while (meter.chains_ms() < 10 && meter.rounds_ < 1 << 28) meter.rounds_ *= 2;
    return meter;
  });
}

double PeakMeter::chains_ms() {
  const cl::CommandQueue& queue = device_->queue(Lane::tracking);
  set_arguments(chains_, result_, cl_int{rounds_}, 0.999F, 0.001F);  // tends to 1: no denormals
  return timed_ms([&] {
    queue.enqueueNDRangeKernel(chains_, cl::NullRange, cl::NDRange(items_), cl::NDRange(group_));
    queue.finish();
  });
}

double PeakMeter::copy_ms() {
  const cl::CommandQueue& queue = device_->queue(Lane::tracking);
  set_arguments(copy_, from_, to_);
  return timed_ms([&] {
    queue.enqueueNDRangeKernel(copy_, cl::NullRange,
                               cl::NDRange(copied_bytes_ / (kCopyLanes * sizeof(float))),
                               cl::NDRange(256));
    queue.finish();
  });
}

void PeakMeter::measure() {
  on_device("measuring the peak", [&] {
    const double flops = 2.0 * kChains * kRepeated * lanes_ * rounds_ * static_cast<double>(items_);
    gflops_.push_back(flops / chains_ms() * 1e-6);
    gbytes_s_.push_back(2 * static_cast<double>(copied_bytes_) / copy_ms() * 1e-6);
  });
}

double PeakMeter::fma_gflops() const { return median(gflops_); }
double PeakMeter::copy_gbytes_s() const { return median(gbytes_s_); }

}  // namespace corvid
