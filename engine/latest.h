#pragma once

#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <stop_token>
#include <utility>

namespace corvid {

/// The newest of a series of immutable values, handed from one thread to others.
template <class T>
class Latest {
 public:
  void publish(std::shared_ptr<const T> value) {
    const std::lock_guard lock(mutex_);
    value_ = std::move(value);
    ++version_;
    changed_.notify_all();
  }

  [[nodiscard]] std::shared_ptr<const T> get() const {
    const std::lock_guard lock(mutex_);
    return value_;
  }

  /// Waits for a version other than `seen`, updates `seen`; null when asked to stop or closed.
  [[nodiscard]] std::shared_ptr<const T> wait(std::uint64_t& seen, const std::stop_token& stop) {
    std::unique_lock lock(mutex_);
    if (!changed_.wait(lock, stop, [&] { return version_ != seen || closed_; })) return nullptr;
    if (version_ == seen) return nullptr;
    seen = version_;
    return value_;
  }

  /// No more values come; waiting threads wake up.
  void close() {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    changed_.notify_all();
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable_any changed_;
  std::shared_ptr<const T> value_;
  std::uint64_t version_ = 0;
  bool closed_ = false;
};

}  // namespace corvid
