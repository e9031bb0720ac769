#pragma once

#include <algorithm>
#include <memory>
#include <span>
#include <type_traits>
#include <utility>

#include "core/check.h"
#include "kernels/device.h"

namespace corvid {

/// A device array of T that is used again and again: it grows when needed and never shrinks.
/// One owner. Faults of the device come as DeviceFault.
template <class T>
class Buffer {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  explicit Buffer(std::shared_ptr<Device> device) : device_(std::move(device)) {}

  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] std::size_t capacity() const { return capacity_; }
  /// For a kernel's argument. Valid until the next resize that grows; never null.
  [[nodiscard]] const cl::Buffer& cl() {
    if (capacity_ == 0) grow(1);
    return buffer_;
  }

  /// Elements are kept while the capacity suffices, lost when it grows.
  void resize(std::size_t size) {
    if (size > capacity_) grow(size);
    size_ = size;
  }

  /// Takes the span's size and elements. The span may go away afterwards.
  void upload(std::span<const T> elements, Lane lane = Lane::tracking) {
    resize(elements.size());
    if (elements.empty()) return;
    on_device("upload", [&] {
      device_->queue(lane).enqueueWriteBuffer(buffer_, CL_TRUE, 0, elements.size_bytes(),
                                              elements.data());
    });
  }

  /// Waits for what was queued before, then copies elements [first, first + out.size()).
  void download(std::span<T> out, std::size_t first = 0, Lane lane = Lane::tracking) const {
    CORVID_CHECK(first <= size_ && out.size() <= size_ - first, "download past the buffer's end");
    if (out.empty()) return;
    on_device("download", [&] {
      device_->queue(lane).enqueueReadBuffer(buffer_, CL_TRUE, first * sizeof(T), out.size_bytes(),
                                             out.data());
    });
  }

 private:
  void grow(std::size_t capacity) {
    on_device("buffer", [&] {
      buffer_ = cl::Buffer();  // first give back, then take
      capacity_ = size_ = 0;
      buffer_ = cl::Buffer(device_->context(), CL_MEM_READ_WRITE, capacity * sizeof(T));
    });
    capacity_ = capacity;
  }

  std::shared_ptr<Device> device_;
  cl::Buffer buffer_;
  std::size_t size_ = 0, capacity_ = 0;
};

}  // namespace corvid
