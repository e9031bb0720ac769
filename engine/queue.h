#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <stop_token>
#include <utility>

namespace corvid {

/// What a full queue does with one more item.
enum class QueuePolicy {
  block,        ///< the producer waits: nothing is lost (offline runs)
  drop_oldest,  ///< the oldest item goes and is counted (frames of a live camera)
};

/// A bounded queue between two threads. `close()` lets the consumer take what is left.
template <class T>
class BoundedQueue {
 public:
  BoundedQueue(std::size_t capacity, QueuePolicy policy) : capacity_(capacity), policy_(policy) {}

  /// False if asked to stop, or if the queue was closed, before there was room.
  bool push(T item, const std::stop_token& stop) {
    std::unique_lock lock(mutex_);
    if (policy_ == QueuePolicy::drop_oldest) {
      if (items_.size() >= capacity_) {
        items_.pop_front();
        ++dropped_;
      }
    } else if (!room_.wait(lock, stop, [&] { return items_.size() < capacity_ || closed_; })) {
      return false;
    }
    if (closed_) return false;
    items_.push_back(std::move(item));
    available_.notify_one();
    return true;
  }

  /// The oldest item; nothing when the queue is closed and empty, or when asked to stop.
  std::optional<T> pop(const std::stop_token& stop) {
    std::unique_lock lock(mutex_);
    if (!available_.wait(lock, stop, [&] { return !items_.empty() || closed_; }))
      return std::nullopt;
    if (items_.empty()) return std::nullopt;
    T item = std::move(items_.front());
    items_.pop_front();
    room_.notify_one();
    return item;
  }

  /// No more items come; both sides wake up.
  void close() {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    available_.notify_all();
    room_.notify_all();
  }

  [[nodiscard]] std::uint64_t dropped() const {
    const std::lock_guard lock(mutex_);
    return dropped_;
  }

 private:
  const std::size_t capacity_;
  const QueuePolicy policy_;
  mutable std::mutex mutex_;
  std::condition_variable_any available_, room_;
  std::deque<T> items_;
  bool closed_ = false;
  std::uint64_t dropped_ = 0;
};

}  // namespace corvid
