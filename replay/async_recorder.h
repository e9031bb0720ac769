#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "core/source_decorator.h"
#include "corvid/error.h"
#include "corvid/ports.h"
#include "io/recording_writer.h"

namespace corvid {

struct RecorderOptions {
  std::size_t buffer_bytes = std::size_t{1024} << 20;  ///< pictures that wait for the disk
  int threads = 1;                                     ///< that encode; >= 1
};

/// As many encoding threads as cores, at most four.
[[nodiscard]] int recorder_threads();

struct RecorderCounts {
  std::uint64_t written = 0;  ///< frames that are on their way to the disk for good
  std::uint64_t bytes = 0;    ///< of their pictures
  std::uint64_t dropped = 0;  ///< the buffer was full, or the recording had failed
  std::uint64_t refused = 0;  ///< time that does not follow, or another size
  std::int64_t first_dropped_ns = 0, last_dropped_ns = 0;  ///< capture times
  std::size_t waiting = 0, waiting_bytes = 0;              ///< in the buffer now
};

/// Encodes and writes frames on threads of its own, in the order in which they were pushed, behind
/// a buffer bounded in bytes. When the buffer is full push() drops, counts, and says so in the log,
/// at once and when it is over. One thread pushes; counts() and failure() are for any.
class AsyncRecorder {
 public:
  AsyncRecorder(std::unique_ptr<RecordingWriter> writer, const RecorderOptions& options);
  /// Without finish() what waits is thrown away.
  ~AsyncRecorder();
  AsyncRecorder(const AsyncRecorder&) = delete;
  AsyncRecorder& operator=(const AsyncRecorder&) = delete;

  /// Never waits. False if the frame was dropped or refused.
  bool push(FramePtr frame);
  /// Waits for room instead of dropping. False if it was refused, the recording has failed, or
  /// somebody asked to stop while it waited.
  bool push_waiting(FramePtr frame, const std::stop_token& stop);

  /// Writes what waits and completes the recording; nothing may be pushed afterwards.
  /// @param progress  called twice a second while it takes long.
  /// Errors: the first that stopped the recording; what was written before stays readable.
  [[nodiscard]] Expected<void> finish(
      const std::function<void(const RecorderCounts&)>& progress = {});

  [[nodiscard]] RecorderCounts counts() const;
  /// What stopped the recording: a full disk. Nothing while all is well.
  [[nodiscard]] std::optional<Error> failure() const;

 private:
  void work();
  [[nodiscard]] bool has_room(std::size_t bytes) const;
  bool follows(const Frame& frame);
  void refuse(const std::string& why);
  void put(FramePtr frame, std::size_t bytes);
  void drop(const Frame& frame);
  void settle(const Frame& frame, std::size_t bytes, const Expected<void>& done);

  const std::unique_ptr<RecordingWriter> writer_;
  const RecorderOptions options_;
  mutable std::mutex mutex_;
  std::condition_variable_any changed_;
  std::deque<FramePtr> queue_;
  bool closing_ = false, discarding_ = false;
  std::size_t running_ = 0;                ///< workers
  std::uint64_t taken_ = 0, settled_ = 0;  ///< frames; whose turn it is to be appended
  RecorderCounts counts_;
  std::uint64_t dropped_in_a_row_ = 0;
  std::optional<std::int64_t> last_pushed_ns_;
  std::optional<Error> failure_;
  std::vector<std::jthread> threads_;
};

/// Hands every frame of a source (but no blind ones) to a recorder on the way to whoever asks for
/// it. From a source that is paced (a camera) it never waits for the disk; from others, nothing is
/// dropped.
class RecordedSource final : public SourceDecorator {
 public:
  /// @param recorder  outlives it.
  RecordedSource(std::unique_ptr<FrameSource> source, AsyncRecorder& recorder)
      : SourceDecorator(std::move(source)), recorder_(recorder) {}

  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop = {}) override;

 private:
  AsyncRecorder& recorder_;
};

}  // namespace corvid
