#pragma once

#include <memory>
#include <vector>

#include "kernels/device.h"

namespace corvid {

/// What the device can do at most, measured: single precision fused multiply-adds from registers,
/// and copying a buffer that fits in no cache. measure() is called many times during a bench, since
/// other work on the machine takes its share of the peak as well.
class PeakMeter {
 public:
  [[nodiscard]] static Expected<PeakMeter> create(std::shared_ptr<Device> device);

  /// One run of each, some 30 ms. Throws DeviceFault.
  void measure();
  [[nodiscard]] int measurements() const { return static_cast<int>(gflops_.size()); }
  [[nodiscard]] double fma_gflops() const;     ///< median; a multiply-add counts 2
  [[nodiscard]] double copy_gbytes_s() const;  ///< median; bytes read and bytes written

 private:
  PeakMeter(std::shared_ptr<Device> device, const cl::Program& program, int lanes);
  double chains_ms();  // one launch of rounds_
  double copy_ms();

  std::shared_ptr<Device> device_;
  cl::Kernel chains_, copy_;
  int lanes_, rounds_ = 1000;
  std::size_t items_, group_, copied_bytes_;
  cl::Buffer result_, from_, to_;
  std::vector<double> gflops_, gbytes_s_;
};

}  // namespace corvid
