#include "replay/async_recorder.h"

#include <fmt/format.h>

#include <chrono>
#include <utility>

#include "core/check.h"
#include "core/log.h"

namespace corvid {

int recorder_threads() {
  return static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1U, 4U));
}
namespace {

std::size_t bytes_of(const Frame& frame) {
  return frame.grey.size() + sizeof(Rgb8) * frame.colour.size();
}
double seconds(std::int64_t time_ns) { return static_cast<double>(time_ns) * 1e-9; }

}  // namespace

AsyncRecorder::AsyncRecorder(std::unique_ptr<RecordingWriter> writer,
                             const RecorderOptions& options)
    : writer_(std::move(writer)), options_(options) {
  CORVID_CHECK(writer_ != nullptr && options_.threads >= 1,
               "a recorder needs a writer and a thread");
  running_ = static_cast<std::size_t>(options_.threads);
  for (int i = 0; i < options_.threads; ++i) threads_.emplace_back([this] { work(); });
}

AsyncRecorder::~AsyncRecorder() {
  {
    const std::scoped_lock lock(mutex_);
    closing_ = discarding_ = true;
  }
  changed_.notify_all();
}

bool AsyncRecorder::has_room(std::size_t bytes) const {
  // A single frame fits always: else a small buffer would take none.
  return counts_.waiting == 0 || counts_.waiting_bytes + bytes <= options_.buffer_bytes;
}

bool AsyncRecorder::follows(const Frame& frame) {
  if (frame.time_ns >= 0 && (!last_pushed_ns_ || frame.time_ns > *last_pushed_ns_)) return true;
  refuse(fmt::format("frame {}: its time {} ns does not follow {} ns", frame.id.value,
                     frame.time_ns, last_pushed_ns_.value_or(-1)));
  return false;
}

// Only the first is said: a camera whose clock stands still has one after the other.
void AsyncRecorder::refuse(const std::string& why) {
  if (counts_.refused++ == 0) log().warn("recording: a frame is left out: {}", why);
}

void AsyncRecorder::put(FramePtr frame, std::size_t bytes) {
  if (dropped_in_a_row_ > 0) {
    log().warn("recording: {} frames were dropped; it goes on at {:.3f} s", dropped_in_a_row_,
               seconds(frame->time_ns));
    dropped_in_a_row_ = 0;
  }
  last_pushed_ns_ = frame->time_ns;
  ++counts_.waiting;
  counts_.waiting_bytes += bytes;
  queue_.push_back(std::move(frame));
  changed_.notify_all();
}

void AsyncRecorder::drop(const Frame& frame) {
  if (counts_.dropped++ == 0) counts_.first_dropped_ns = frame.time_ns;
  counts_.last_dropped_ns = frame.time_ns;
}

bool AsyncRecorder::push(FramePtr frame) {
  const std::scoped_lock lock(mutex_);
  const std::size_t bytes = bytes_of(*frame);
  if (!follows(*frame)) return false;
  // Once full, it goes on when an eighth is free again: not with a hole after every frame.
  const std::size_t margin = dropped_in_a_row_ > 0 ? options_.buffer_bytes / 8 : 0;
  if (failure_ || !has_room(bytes + margin)) {
    drop(*frame);
    if (dropped_in_a_row_++ == 0 && !failure_) {
      log().warn("recording: the buffer of {} MB is full: frames are dropped from {:.3f} s on",
                 options_.buffer_bytes >> 20, seconds(frame->time_ns));
    }
    return false;
  }
  put(std::move(frame), bytes);
  return true;
}

bool AsyncRecorder::push_waiting(FramePtr frame, const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  const std::size_t bytes = bytes_of(*frame);
  if (!follows(*frame)) return false;
  const bool room =
      changed_.wait(lock, stop, [&] { return failure_.has_value() || has_room(bytes); });
  if (!room || failure_) return false;
  put(std::move(frame), bytes);
  return true;
}

// Encoding goes on side by side; a frame is appended when all before it are settled.
void AsyncRecorder::work() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [&] { return closing_ || !queue_.empty(); });
    if (queue_.empty()) break;
    const FramePtr frame = std::move(queue_.front());
    queue_.pop_front();
    const std::uint64_t turn = taken_++;
    Expected<std::vector<std::uint8_t>> picture;
    if (!discarding_ && !failure_) {
      lock.unlock();
      picture = writer_->encode(*frame);
      lock.lock();
    }
    changed_.wait(lock, [&] { return settled_ == turn; });
    Expected<void> done;
    const bool wanted = !discarding_ && !failure_;
    if (wanted) {
      lock.unlock();  // nobody else has the turn
      done = picture ? writer_->append(*frame, *picture) : tl::unexpected(picture.error());
      lock.lock();
    }
    const std::size_t bytes = bytes_of(*frame);
    --counts_.waiting;
    counts_.waiting_bytes -= bytes;
    if (!wanted) {
      drop(*frame);
    } else {
      settle(*frame, picture ? picture->size() : 0, done);
    }
    ++settled_;
    changed_.notify_all();
  }
  --running_;
  changed_.notify_all();
}

void AsyncRecorder::settle(const Frame& frame, std::size_t bytes, const Expected<void>& done) {
  if (done) {
    ++counts_.written;
    counts_.bytes += bytes;
  } else if (done.error().code == ErrorCode::invalid_argument) {
    refuse(done.error().to_string());
  } else {
    failure_ = done.error();
    drop(frame);
    log().error("recording stopped after {} frames: {}", counts_.written, done.error().to_string());
  }
}

Expected<void> AsyncRecorder::finish(const std::function<void(const RecorderCounts&)>& progress) {
  std::unique_lock lock(mutex_);
  closing_ = true;
  changed_.notify_all();
  while (!changed_.wait_for(lock, std::chrono::milliseconds(500), [&] { return running_ == 0; })) {
    if (!progress) continue;
    const RecorderCounts now = counts_;
    lock.unlock();
    progress(now);
    lock.lock();
  }
  if (counts_.dropped > 0) {
    log().warn("recording: {} frames from {:.3f} to {:.3f} s were dropped{}", counts_.dropped,
               seconds(counts_.first_dropped_ns), seconds(counts_.last_dropped_ns),
               failure_
                   ? ""
                   : ": the disk or the encoder was too slow. A larger buffer, MJPEG, a faster "
                     "disk, or more threads help");
  }
  lock.unlock();
  const auto finished = writer_->finish();  // of what was written before a failure, too
  lock.lock();
  if (!finished && !failure_) failure_ = finished.error();
  if (failure_) return tl::unexpected(*failure_);
  return {};
}

RecorderCounts AsyncRecorder::counts() const {
  const std::scoped_lock lock(mutex_);
  return counts_;
}

std::optional<Error> AsyncRecorder::failure() const {
  const std::scoped_lock lock(mutex_);
  return failure_;
}

Expected<FramePtr> RecordedSource::next(const std::stop_token& stop) {
  auto frame = SourceDecorator::next(stop);
  if (!frame || !*frame || !(*frame)->blind.empty()) return frame;
  if (info().paced) {
    recorder_.push(*frame);
  } else {
    recorder_.push_waiting(*frame, stop);
  }
  return frame;
}

}  // namespace corvid
