#include "io/camera/camera_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <deque>
#include <fstream>
#include <functional>

#include "scenes/temporary_folder.h"

namespace corvid {
namespace {

using testing::HasSubstr;

constexpr std::int64_t kInterval_ns = 50'000'000;
constexpr std::int64_t kStart_ns = 1'000'000'000;

/// A camera that films time: what it does is a plan over the clock's time.
struct FakeCamera {
  ManualClock clock;
  struct Span {
    std::int64_t from_ns, to_ns;
  };
  std::vector<Span> unplugged, stalled;
  int width_px = 8;
  int opened = 0;
  std::optional<std::int64_t> ends_ns;  ///< as a pipe does
  bool pipe = false;                    ///< cannot be opened anew
  bool broken = false;                  ///< every stream fails at once
  std::vector<std::int64_t> attempts_ns;
  std::function<void()> on_attempt = [] {};

  FakeCamera() { clock.advance(kStart_ns); }
  static bool within(const std::vector<Span>& spans, std::int64_t t) {
    for (const Span& s : spans)
      if (t >= s.from_ns && t < s.to_ns) return true;
    return false;
  }

  class Stream final : public CameraStream {
   public:
    explicit Stream(FakeCamera& camera) : camera_(camera) {
      settings_.format = "GREY";
      settings_.width_px = camera.width_px;
      settings_.height_px = 4;
      settings_.rate_hz = 20;
    }
    const StreamSettings& settings() const override { return settings_; }
    Expected<std::optional<Capture>> next(std::chrono::milliseconds timeout,
                                          const std::stop_token&) override {
      const std::int64_t until = camera_.clock.now_ns() + std::chrono::nanoseconds(timeout).count();
      while (true) {
        const std::int64_t now = camera_.clock.now_ns();
        if (camera_.ends_ns && now >= *camera_.ends_ns) {
          if (camera_.broken) return fail(ErrorCode::io, "something else in between", "fake");
          return std::nullopt;
        }
        if (camera_.broken && !camera_.ends_ns) return fail(ErrorCode::io, "breaks off", "fake");
        if (within(camera_.unplugged, now)) return fail(ErrorCode::io, "unplugged", "fake");
        const std::int64_t due = (now / kInterval_ns + 1) * kInterval_ns;
        if (due > until) {
          camera_.clock.sleep_until(until, {});
          return std::nullopt;
        }
        camera_.clock.sleep_until(due, {});
        if (within(camera_.stalled, due) || within(camera_.unplugged, due)) continue;
        Capture capture;
        capture.grey = GreyImage(settings_.width_px, settings_.height_px);
        capture.time_ns = due;
        return capture;
      }
    }
    StreamCounts counts() const override { return {1, 1, {"a damaged picture"}}; }
    bool ended() const override {
      return camera_.ends_ns && camera_.clock.now_ns() >= *camera_.ends_ns;
    }

    bool reopens() const override { return !camera_.pipe; }

   private:
    FakeCamera& camera_;
    StreamSettings settings_;
  };

  CameraSource::Opener opener() {
    return [this]() -> Expected<std::unique_ptr<CameraStream>> {
      attempts_ns.push_back(clock.now_ns());
      on_attempt();
      if (within(unplugged, clock.now_ns()))
        return fail(ErrorCode::not_found, "there is no such camera", "fake");
      ++opened;
      return std::make_unique<Stream>(*this);
    };
  }
  std::unique_ptr<CameraSource> open(const CameraSourceOptions& options = {}) {
    auto source = CameraSource::open("test camera", "fake", opener(), options, clock);
    EXPECT_TRUE(source) << source.error().to_string();
    return source ? std::move(*source) : nullptr;
  }
};

struct Seen {
  std::vector<FramePtr> pictures, blind;
};

/// Takes frames until the clock has come that far; checks what holds for all of them.
Seen watch(CameraSource& source, FakeCamera& camera, std::int64_t until_ns) {
  Seen seen;
  std::int64_t last_ns = 0;
  std::uint32_t last_id = 0;
  while (camera.clock.now_ns() < until_ns) {
    const auto frame = source.next();
    EXPECT_TRUE(frame) << frame.error().to_string();
    if (!frame || !*frame) break;
    if (last_ns > 0) {
      EXPECT_GT((*frame)->time_ns, last_ns);
      EXPECT_EQ((*frame)->id.value, last_id + 1);
    }
    last_ns = (*frame)->time_ns;
    last_id = (*frame)->id.value;
    EXPECT_EQ((*frame)->blind.empty(), !(*frame)->grey.empty());
    EXPECT_NE((*frame)->camera, nullptr);
    ((*frame)->blind.empty() ? seen.pictures : seen.blind).push_back(*frame);
  }
  return seen;
}

TEST(CameraSource, DeliversPicturesWithTheirTimes) {
  FakeCamera camera;
  const auto source = camera.open();
  EXPECT_TRUE(source->info().paced);
  EXPECT_EQ(source->info().rate_hz, 20);
  const Seen seen = watch(*source, camera, kStart_ns + 20 * kInterval_ns);
  ASSERT_EQ(seen.pictures.size(), 20U);
  EXPECT_TRUE(seen.blind.empty());
  for (std::size_t i = 0; i < 20; ++i)
    EXPECT_EQ(seen.pictures[i]->time_ns, kStart_ns + static_cast<std::int64_t>(i + 1) * 50'000'000);
  const SourceCounts counts = source->counts();
  EXPECT_EQ(counts.delivered, 20U);
  EXPECT_EQ(counts.lost, 1U);
  EXPECT_EQ(counts.skipped, 1U);
  EXPECT_EQ(counts.interruptions, 0U);
  EXPECT_THAT(counts.messages, testing::ElementsAre("a damaged picture"));
}

TEST(CameraSource, AnUnpluggedCameraIsBlindUntilItIsBack) {
  FakeCamera camera;
  camera.unplugged = {{2'000'000'000, 32'000'000'000}};
  const auto source = camera.open();
  const Seen seen = watch(*source, camera, 45'000'000'000);
  // One a second, the first of them at once.
  EXPECT_GE(seen.blind.size(), 30U);
  EXPECT_LE(seen.blind.size(), 37U);
  EXPECT_THAT(seen.blind.front()->blind, HasSubstr("unplugged"));
  EXPECT_THAT(seen.blind.back()->blind, HasSubstr("no such camera"));
  EXPECT_EQ(camera.opened, 2);
  // Back-off: from a fifth of a second to five seconds.
  ASSERT_GE(camera.attempts_ns.size(), 8U);
  EXPECT_LE(camera.attempts_ns.size(), 13U);
  EXPECT_LT(camera.attempts_ns[1] - 2'000'000'000, 400'000'000);
  const std::size_t last = camera.attempts_ns.size() - 1;
  EXPECT_LE(camera.attempts_ns[last] - camera.attempts_ns[last - 1], 5'100'000'000);
  EXPECT_LE(camera.attempts_ns[last] - 32'000'000'000, 5'100'000'000);
  // Pictures from then on.
  EXPECT_GT(seen.pictures.back()->time_ns, 44'900'000'000);
  EXPECT_EQ(source->counts().interruptions, 1U);
  EXPECT_EQ(source->counts().lost, 2U) << "counts of both streams";
}

TEST(CameraSource, AStalledCameraIsBlindAndOpenedAnew) {
  FakeCamera camera;
  camera.stalled = {{2'000'000'000, 3'200'000'000}, {10'000'000'000, 20'000'000'000}};
  const auto source = camera.open();
  const Seen first = watch(*source, camera, 9'000'000'000);
  ASSERT_EQ(first.blind.size(), 1U);
  EXPECT_THAT(first.blind.front()->blind, HasSubstr("stands still"));
  EXPECT_EQ(camera.opened, 1) << "it came back by itself";
  const Seen second = watch(*source, camera, 21'000'000'000);
  EXPECT_GE(second.blind.size(), 8U);
  EXPECT_GE(camera.opened, 2);
  EXPECT_LE(camera.opened, 5);
  EXPECT_EQ(second.pictures.back()->time_ns, 21'000'000'000);
  EXPECT_EQ(source->counts().interruptions, 2U);
}

// Its bytes go on where they stopped: a new reader would look for a beginning there.
TEST(CameraSource, APipeThatStandsStillIsNotOpenedAnew) {
  FakeCamera camera;
  camera.pipe = true;
  camera.stalled = {{2'000'000'000, 30'000'000'000}};
  const auto source = camera.open();
  const Seen seen = watch(*source, camera, 31'000'000'000);
  EXPECT_EQ(camera.opened, 1);
  EXPECT_GE(seen.blind.size(), 25U);
  EXPECT_EQ(seen.pictures.back()->time_ns, 31'000'000'000);
  EXPECT_EQ(source->counts().interruptions, 1U);
}

TEST(CameraSource, APipeThatIsBrokenIsAnError) {
  FakeCamera camera;
  camera.pipe = camera.broken = true;
  camera.ends_ns = 2'000'000'000;
  const auto source = camera.open();
  Expected<FramePtr> frame = source->next();
  while (frame && *frame) frame = source->next();
  ASSERT_FALSE(frame);
  EXPECT_THAT(frame.error().what, HasSubstr("something else"));
}

TEST(CameraSource, AStreamThatBreaksOffAgainAndAgainIsOpenedMoreAndMoreRarely) {
  FakeCamera camera;
  const auto source = camera.open();
  (void)watch(*source, camera, 2'000'000'000);
  camera.broken = true;
  (void)watch(*source, camera, 62'000'000'000);
  EXPECT_LE(camera.opened, 20);
  camera.broken = false;
  EXPECT_FALSE(watch(*source, camera, 70'000'000'000).pictures.empty());
  EXPECT_EQ(source->counts().interruptions, 1U);
}

TEST(CameraSource, WhatWasOpenedLongBeforeBeginsAnew) {
  FakeCamera camera;
  CameraSourceOptions options;
  options.duration_s = 5;
  const auto source = camera.open(options);
  camera.clock.advance(60'000'000'000);  // kernels are compiled
  const Seen seen = watch(*source, camera, 80'000'000'000);
  EXPECT_EQ(camera.opened, 2);
  EXPECT_TRUE(seen.blind.empty());
  EXPECT_NEAR(static_cast<double>(seen.pictures.size()), 100, 2) << "5 s of capture";
}

TEST(CameraSource, ASlowCameraDoesNotStall) {
  FakeCamera camera;
  camera.stalled = {{2'000'000'000, 2'400'000'000}};
  const auto source = camera.open();
  EXPECT_TRUE(watch(*source, camera, 4'000'000'000).blind.empty());
  EXPECT_EQ(source->counts().interruptions, 0U);
}

TEST(CameraSource, AnotherSizeAfterwardsIsWaitedOver) {
  FakeCamera camera;
  camera.unplugged = {{2'000'000'000, 3'000'000'000}};
  const auto source = camera.open();
  (void)watch(*source, camera, 2'500'000'000);
  camera.width_px = 16;
  const Seen other = watch(*source, camera, 12'000'000'000);
  EXPECT_TRUE(other.pictures.empty());
  EXPECT_THAT(other.blind.back()->blind, HasSubstr("16 x 4 pixels, not 8 x 4"));
  camera.width_px = 8;
  const Seen back = watch(*source, camera, 20'000'000'000);
  EXPECT_FALSE(back.pictures.empty());
  EXPECT_EQ(source->counts().interruptions, 1U);
}

TEST(CameraSource, AStreamThatEndsIsTheEnd) {
  FakeCamera camera;
  camera.ends_ns = 2'000'000'000;
  const auto source = camera.open();
  const Seen seen = watch(*source, camera, 10'000'000'000);
  EXPECT_EQ(seen.pictures.size(), 20U);
  EXPECT_TRUE(seen.blind.empty());
  EXPECT_LT(camera.clock.now_ns(), 3'000'000'000);
}

TEST(CameraSource, AskedToStopItReturnsNothing) {
  FakeCamera camera;
  camera.unplugged = {{2'000'000'000, 900'000'000'000}};
  const auto source = camera.open();
  (void)watch(*source, camera, 5'000'000'000);
  std::stop_source stop;
  std::size_t attempts = 0;
  camera.on_attempt = [&] {
    stop.request_stop();
    attempts = camera.attempts_ns.size();
  };
  while (attempts == 0) {
    const auto frame = source->next(stop.get_token());
    ASSERT_TRUE(frame);
    EXPECT_EQ(*frame == nullptr, attempts > 0) << "blind until then";
  }
  EXPECT_EQ(camera.attempts_ns.size(), attempts);
}

TEST(CameraSource, WithoutACameraAtTheStartThereIsAnError) {
  FakeCamera camera;
  camera.unplugged = {{0, 900'000'000'000}};
  const auto source = CameraSource::open("test camera", "fake", camera.opener(), {}, camera.clock);
  ASSERT_FALSE(source);
  EXPECT_EQ(source.error().code, ErrorCode::not_found);
}

TEST(CameraSource, TheCalibrationIsOfTheSizeThatTheCameraGives) {
  FakeCamera camera;
  camera.width_px = 8;
  const TemporaryFolder folder;
  const std::string path = (folder.path() / "cam.yaml").string();
  std::ofstream(path)
      << "image_width: 16\nimage_height: 8\ncamera_name: c\n"
         "distortion_model: plumb_bob\n"
         "camera_matrix: {rows: 3, cols: 3, data: [10, 0, 7.5, 0, 10, 3.5, 0, 0, 1]}\n"
         "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n";
  CameraSourceOptions options;
  options.calibration_path = path;
  const auto source = camera.open(options);
  ASSERT_NE(source, nullptr);
  EXPECT_EQ(source->info().camera->width_px, 8);
  EXPECT_EQ(source->info().camera->fx_px, 5);
  camera.width_px = 9;
  const auto misfit =
      CameraSource::open("test camera", "fake", camera.opener(), options, camera.clock);
  EXPECT_FALSE(misfit);
}

}  // namespace
}  // namespace corvid
