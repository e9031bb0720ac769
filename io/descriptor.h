#pragma once

#include <cstddef>
#include <string_view>
#include <utility>

namespace corvid {

/// A file descriptor that is closed with its owner; -1 is none.
class Descriptor {
 public:
  explicit Descriptor(int number = -1) : number_(number) {}
  Descriptor(Descriptor&& other) noexcept : number_(other.release()) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  Descriptor& operator=(Descriptor&&) = delete;
  ~Descriptor() { reset(-1); }
  /// Closes it and takes another.
  void reset(int number);
  [[nodiscard]] int release() { return std::exchange(number_, -1); }
  [[nodiscard]] int get() const { return number_; }

 private:
  int number_;
};

/// Writes all the bytes, on after signals.
/// @return how many were written: fewer only after an error, which errno has.
[[nodiscard]] std::size_t write_all(int fd, std::string_view bytes);

}  // namespace corvid
