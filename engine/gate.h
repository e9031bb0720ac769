#pragma once

#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <utility>

namespace corvid {

/// Stops and starts work that runs elsewhere: on a device's queue.
class Brake {
 public:
  virtual ~Brake() = default;
  virtual void hold() = 0;
  virtual void release() = 0;
};

/// Lets background work (mapping) yield to work with a deadline (tracking).
///
/// The background work is held while something urgent waits or is under way. It is never starved:
/// every release gives whoever waits a slice, however soon the gate is held again, and when
/// kHeldTurns urgent pieces in a row went by without a moment in which nothing was urgent, it runs
/// beside the next one. Counts turns and reads no clock, so that it acts the same anywhere.
/// Thread-safe.
class Gate {
 public:
  static constexpr int kHeldTurns = 3;

  /// @param brake  is held and released with the gate, under its lock; may be null; outlives it.
  explicit Gate(Brake* brake = nullptr) : brake_(brake) {}
  Gate(const Gate&) = delete;
  Gate& operator=(const Gate&) = delete;
  ~Gate() { open(); }

  /// One urgent piece of work, from its arrival to its end. An empty one does nothing.
  class Turn {
   public:
    Turn() = default;
    Turn(Turn&& other) noexcept : gate_(std::exchange(other.gate_, nullptr)) {}
    Turn& operator=(Turn&& other) noexcept {
      std::swap(gate_, other.gate_);
      return *this;
    }
    ~Turn() {
      if (gate_) gate_->leave();
    }

   private:
    friend class Gate;
    explicit Turn(Gate* gate) : gate_(gate) {}
    Gate* gate_ = nullptr;
  };

  [[nodiscard]] Turn enter() {
    const std::lock_guard lock(mutex_);
    if (urgent_ == 0 && !opened_) {
      turns_ = 0;
      set_held(true);
    }
    ++urgent_;
    return Turn(this);
  }

  /// For the background work, between two slices: returns when it may go on.
  void wait() {
    std::unique_lock lock(mutex_);
    const auto seen = releases_;
    ++waiting_;
    released_.wait(lock, [&] { return !held_ || releases_ != seen; });
    --waiting_;
  }

  /// Holds nothing any more, for good: the run is being stopped.
  void open() {
    const std::lock_guard lock(mutex_);
    opened_ = true;
    set_held(false);
  }

  [[nodiscard]] bool held() const {
    const std::lock_guard lock(mutex_);
    return held_;
  }
  /// Callers that wait() holds back right now.
  [[nodiscard]] int waiting() const {
    const std::lock_guard lock(mutex_);
    return waiting_;
  }

 private:
  void leave() {
    const std::lock_guard lock(mutex_);
    --urgent_;
    if (opened_) return;
    ++turns_;
    set_held(urgent_ > 0 && turns_ % (kHeldTurns + 1) != kHeldTurns);
  }

  void set_held(bool held) {
    if (held == held_) return;
    if (brake_ && held) brake_->hold();
    held_ = held;
    if (held) return;
    if (brake_) brake_->release();
    ++releases_;
    released_.notify_all();
  }

  Brake* brake_;
  mutable std::mutex mutex_;
  std::condition_variable released_;
  int urgent_ = 0;  ///< pieces that wait or are under way
  int turns_ = 0;   ///< that ended since nothing was urgent
  int waiting_ = 0;
  std::uint64_t releases_ = 0;
  bool held_ = false, opened_ = false;
};

}  // namespace corvid
