#include "replay/async_recorder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spdlog/sinks/ostream_sink.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <sstream>
#include <thread>
#include <vector>

#include "core/log.h"

namespace corvid {
namespace {

using namespace std::chrono_literals;

FramePtr frame_of(int number) {
  auto frame = std::make_shared<Frame>();
  frame->id = FrameId(static_cast<std::uint32_t>(number));
  frame->time_ns = 1'000'000 * number;
  frame->grey = GreyImage(100, 10);  // 1000 bytes
  return frame;
}

/// What the disk has, and the disk's moods.
struct Disk {
  std::mutex mutex;
  std::condition_variable changed;
  std::vector<std::int64_t> times_ns;
  bool stuck = false, finished = false;
  std::size_t full_after = 1000;
  void set_stuck(bool value) {
    const std::scoped_lock lock(mutex);
    stuck = value;
    changed.notify_all();
  }
};

class DiskWriter final : public RecordingWriter {
 public:
  explicit DiskWriter(Disk& disk) : disk_(disk) {}
  Expected<std::vector<std::uint8_t>> encode(const Frame& frame) override {
    if (frame.grey.empty()) return fail(ErrorCode::invalid_argument, "no picture");
    if (frame.id.value % 3 == 0) std::this_thread::sleep_for(1ms);  // later ones are done earlier
    return std::vector<std::uint8_t>(10);
  }
  Expected<void> append(const Frame& frame, std::span<const std::uint8_t> picture) override {
    EXPECT_EQ(picture.size(), 10u);
    EXPECT_FALSE(inside_.exchange(true)) << "two at a time";
    std::unique_lock lock(disk_.mutex);
    disk_.changed.wait(lock, [&] { return !disk_.stuck; });
    inside_ = false;
    if (disk_.times_ns.size() >= disk_.full_after) return fail(ErrorCode::io, "disk full");
    disk_.times_ns.push_back(frame.time_ns);
    return {};
  }
  Expected<bool> write_truth(const Trajectory&) override { return false; }
  Expected<void> finish() override {
    disk_.finished = true;
    return {};
  }

 private:
  Disk& disk_;
  std::atomic<bool> inside_ = false;
};

std::vector<std::int64_t> times_to(int count) {
  std::vector<std::int64_t> times;
  for (int i = 0; i < count; ++i) times.push_back(1'000'000 * i);
  return times;
}

TEST(AsyncRecorder, SeveralEncodersKeepTheOrder) {
  Disk disk;
  AsyncRecorder recorder(std::make_unique<DiskWriter>(disk),
                         {.buffer_bytes = 20'000, .threads = 4});
  for (int i = 0; i < 200; ++i) EXPECT_TRUE(recorder.push_waiting(frame_of(i), {}));
  ASSERT_TRUE(recorder.finish().has_value());
  EXPECT_EQ(disk.times_ns, times_to(200));
  EXPECT_TRUE(disk.finished);
  const RecorderCounts counts = recorder.counts();
  EXPECT_EQ(counts.written, 200u);
  EXPECT_EQ(counts.bytes, 2000u);
  EXPECT_EQ(counts.waiting, 0u);
  EXPECT_EQ(counts.waiting_bytes, 0u);
}

TEST(AsyncRecorder, AStuckDiskCostsFramesOnlyWhenTheBufferIsFull) {
  Disk disk;
  disk.stuck = true;
  AsyncRecorder recorder(std::make_unique<DiskWriter>(disk), {.buffer_bytes = 8000, .threads = 2});
  for (int i = 0; i < 12; ++i) EXPECT_EQ(recorder.push(frame_of(i)), i < 8) << i;
  RecorderCounts counts = recorder.counts();
  EXPECT_EQ(counts.dropped, 4u);
  EXPECT_EQ(counts.waiting_bytes, 8000u);
  EXPECT_EQ(counts.first_dropped_ns, 8'000'000);
  EXPECT_EQ(counts.last_dropped_ns, 11'000'000);
  disk.set_stuck(false);
  while (recorder.counts().waiting > 0) std::this_thread::sleep_for(1ms);
  EXPECT_TRUE(recorder.push(frame_of(12)));
  ASSERT_TRUE(recorder.finish().has_value());
  std::vector<std::int64_t> expected = times_to(8);
  expected.push_back(12'000'000);
  EXPECT_EQ(disk.times_ns, expected);
  EXPECT_EQ(recorder.counts().written, 9u);
}

TEST(AsyncRecorder, AFullDiskStopsItAndKeepsWhatWasWritten) {
  Disk disk;
  disk.full_after = 5;
  AsyncRecorder recorder(std::make_unique<DiskWriter>(disk), {.threads = 3});
  for (int i = 0; i < 50; ++i) recorder.push_waiting(frame_of(i), {});
  const auto finished = recorder.finish();
  ASSERT_FALSE(finished.has_value());
  EXPECT_EQ(finished.error().what, "disk full");
  EXPECT_EQ(recorder.failure()->what, "disk full");
  EXPECT_EQ(disk.times_ns, times_to(5));
  EXPECT_EQ(recorder.counts().written, 5u);
  EXPECT_TRUE(disk.finished) << "what was written has its index";
  EXPECT_FALSE(recorder.push(frame_of(60)));
}

TEST(AsyncRecorder, FramesThatCannotBeAreLeftOut) {
  Disk disk;
  AsyncRecorder recorder(std::make_unique<DiskWriter>(disk), {});
  EXPECT_TRUE(recorder.push(frame_of(3)));
  EXPECT_FALSE(recorder.push(frame_of(3)));
  EXPECT_FALSE(recorder.push(frame_of(1)));
  auto empty = std::make_shared<Frame>();
  empty->time_ns = 4'000'000;
  EXPECT_TRUE(recorder.push(empty));
  EXPECT_TRUE(recorder.push(frame_of(5)));
  ASSERT_TRUE(recorder.finish().has_value());
  EXPECT_EQ(recorder.counts().refused, 3u);
  EXPECT_EQ(disk.times_ns, (std::vector<std::int64_t>{3'000'000, 5'000'000}));
}

TEST(AsyncRecorder, AFrameLargerThanTheBufferIsTakenAlone) {
  Disk disk;
  AsyncRecorder recorder(std::make_unique<DiskWriter>(disk), {.buffer_bytes = 10});
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(recorder.push_waiting(frame_of(i), {}));
  ASSERT_TRUE(recorder.finish().has_value());
  EXPECT_EQ(disk.times_ns, times_to(3));
}

TEST(AsyncRecorder, WaitingForRoomEndsWhenAskedToStop) {
  Disk disk;
  disk.stuck = true;
  AsyncRecorder recorder(std::make_unique<DiskWriter>(disk), {.buffer_bytes = 1000});
  EXPECT_TRUE(recorder.push_waiting(frame_of(0), {}));
  std::stop_source stop;
  std::jthread asker([&] {
    std::this_thread::sleep_for(20ms);
    stop.request_stop();
  });
  EXPECT_FALSE(recorder.push_waiting(frame_of(1), stop.get_token()));
  disk.set_stuck(false);
  ASSERT_TRUE(recorder.finish().has_value());
  EXPECT_EQ(disk.times_ns, times_to(1));
}

TEST(AsyncRecorder, LongWorkAtTheEndTellsHowFarItIs) {
  Disk disk;
  disk.stuck = true;
  AsyncRecorder recorder(std::make_unique<DiskWriter>(disk), {});
  for (int i = 0; i < 3; ++i) recorder.push(frame_of(i));
  int told = 0;
  const auto finished = recorder.finish([&](const RecorderCounts& counts) {
    EXPECT_EQ(counts.waiting, 3u);
    if (++told == 1) disk.set_stuck(false);
  });
  ASSERT_TRUE(finished.has_value());
  EXPECT_EQ(told, 1);
  EXPECT_EQ(disk.times_ns, times_to(3));
}

TEST(AsyncRecorder, WithoutAnEndWhatWaitsIsThrownAway) {
  // The disk comes back after a while, in which the destructor has begun; on a busy machine it may
  // have to be a longer one.
  std::size_t written = 5;
  for (auto after = 20ms; written > 1 && after <= 2s; after *= 10) {
    Disk disk;
    disk.stuck = true;
    std::jthread mender;
    {
      AsyncRecorder recorder(std::make_unique<DiskWriter>(disk), {.threads = 2});
      for (int i = 0; i < 5; ++i) EXPECT_TRUE(recorder.push(frame_of(i)));
      mender = std::jthread([&disk, after] {
        std::this_thread::sleep_for(after);
        disk.set_stuck(false);
      });
    }
    mender.join();
    written = disk.times_ns.size();
    EXPECT_FALSE(disk.finished);
  }
  EXPECT_LE(written, 1u) << "more than what was being written";
}

TEST(AsyncRecorder, OnlyTheFirstFrameThatIsLeftOutIsSaid) {
  std::ostringstream text;
  const auto silent = std::make_shared<spdlog::logger>("corvid");
  set_logger(std::make_shared<spdlog::logger>(
      "corvid", std::make_shared<spdlog::sinks::ostream_sink_mt>(text)));
  Disk disk;
  {
    AsyncRecorder recorder(std::make_unique<DiskWriter>(disk), {});
    recorder.push(frame_of(7));
    for (int i = 0; i < 5; ++i) EXPECT_FALSE(recorder.push(frame_of(7)));
    EXPECT_TRUE(recorder.finish().has_value());
    EXPECT_EQ(recorder.counts().refused, 5u);
  }
  set_logger(silent);
  EXPECT_NE(text.str().find("frame 7: its time 7000000 ns does not follow"), std::string::npos);
  EXPECT_EQ(std::ranges::count(text.str(), '\n'), 1) << text.str();
}

class TenFrames final : public FrameSource {
 public:
  explicit TenFrames(bool paced) { info_.paced = paced; }
  const SourceInfo& info() const override { return info_; }
  Expected<FramePtr> next(const std::stop_token&) override {
    return given_ == 10 ? nullptr : frame_of(given_++);
  }
  SourceCounts counts() const override { return {}; }

 private:
  SourceInfo info_;
  int given_ = 0;
};

TEST(RecordedSource, ACameraIsNeverHeldUpAndAFileLosesNothing) {
  for (const bool paced : {true, false}) {
    Disk disk;
    disk.stuck = paced;
    AsyncRecorder recorder(std::make_unique<DiskWriter>(disk), {.buffer_bytes = 3000});
    RecordedSource source(std::make_unique<TenFrames>(paced), recorder);
    int given = 0;
    while (const FramePtr frame = source.next().value())
      EXPECT_EQ(frame->time_ns, 1'000'000 * given++);
    EXPECT_EQ(given, 10);  // whoever asked has all of them
    disk.set_stuck(false);
    ASSERT_TRUE(recorder.finish().has_value());
    EXPECT_EQ(disk.times_ns, times_to(paced ? 3 : 10));
    EXPECT_EQ(recorder.counts().dropped, paced ? 7u : 0u);
  }
}

}  // namespace
}  // namespace corvid
