#include "corvid/engine.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <thread>

#include "core/alignment.h"
#include "core/clock.h"
#include "replay/player.h"
#include "replay/synthetic_flight.h"

namespace corvid {
namespace {

FlightOptions short_flight(double duration_s = 3) {
  FlightOptions options;
  options.width_px = 400;
  options.height_px = 300;
  options.duration_s = duration_s;
  return options;
}

Options fast_options(int threads) {
  Options options;
  options.threads = threads;
  options.frontend.max_tracks = 400;
  options.mapping.depth_samples = 48;
  options.mapping.depth_scale = 4;
  return options;
}

RunResult run(FrameSource& source, const Options& options, const EngineSinks& sinks = {},
              const std::stop_token& stop = {}) {
  auto engine = Engine::create(options);
  EXPECT_TRUE(engine) << engine.error().to_string();
  auto result = (*engine)->run(source, sinks, stop);
  EXPECT_TRUE(result) << result.error().to_string();
  return std::move(*result);
}

/// Root mean square distance of the camera centres after Sim(3) alignment, as share of the path.
double relative_error(const RunResult& result, const SyntheticFlight& flight) {
  std::vector<Eigen::Vector3d> estimate, truth;
  double path = 0;
  for (const StampedPose& pose : result.trajectory) {
    estimate.push_back(pose.T_world_camera.translation());
    for (std::size_t i = 0; i < flight.frame_count(); ++i)
      if (flight.time_ns(i) == pose.time_ns) truth.push_back(flight.true_pose(i).translation());
    if (truth.size() > 1) path += (truth.back() - truth[truth.size() - 2]).norm();
  }
  const PointAlignment alignment = align_points(estimate, truth, true);
  EXPECT_EQ(alignment.status, AlignmentStatus::ok);
  return alignment.rmse / path;
}

TEST(Engine, FliesTheTownInlineAndRepeatsBitForBit) {
  const Options options = fast_options(1);
  RunResult results[2];
  for (RunResult& result : results) {
    SyntheticFlight flight(short_flight());
    result = run(flight, options);
    EXPECT_EQ(result.events.size(), flight.frame_count());
    EXPECT_EQ(result.trajectory.size(), flight.frame_count());
    const double error = relative_error(result, flight);
    std::printf("error %.4f %% of the path, %zu landmarks, %zu triangles\n", 100 * error,
                result.map->landmarks.size(), result.mesh.triangles.size());
    EXPECT_LT(error, 0.01);
    EXPECT_GT(result.map->landmarks.size(), 200U);
    EXPECT_GT(result.mesh.triangles.size(), 500U);
    EXPECT_FALSE(result.depth_maps.empty());
    EXPECT_FALSE(result.interrupted);
    EXPECT_FALSE(result.stages.empty());
  }
  ASSERT_EQ(results[0].trajectory.size(), results[1].trajectory.size());
  for (std::size_t i = 0; i < results[0].trajectory.size(); ++i) {
    const Pose& a = results[0].trajectory[i].T_world_camera;
    const Pose& b = results[1].trajectory[i].T_world_camera;
    EXPECT_EQ(a.translation(), b.translation());
    EXPECT_EQ(a.rotation().coeffs(), b.rotation().coeffs());
  }
  EXPECT_EQ(results[0].mesh.vertices, results[1].mesh.vertices);
  EXPECT_EQ(results[0].mesh.triangles, results[1].mesh.triangles);
}

struct CountingSinks final : PoseSink, MeshSink {
  std::vector<PoseEvent> poses;
  std::size_t blocks = 0;
  void on_pose(const PoseEvent& event) override { poses.push_back(event); }
  void on_block(const MeshBlock&) override { ++blocks; }
};

TEST(Engine, ThreadsLoseNothingOffline) {
  SyntheticFlight flight(short_flight());
  CountingSinks sinks;
  const RunResult result = run(flight, fast_options(2), {&sinks, &sinks});
  EXPECT_EQ(sinks.poses.size(), flight.frame_count());
  EXPECT_EQ(result.events.size(), flight.frame_count());
  EXPECT_EQ(result.counts.dropped, 0U);
  EXPECT_EQ(result.counts.delivered, flight.frame_count());
  EXPECT_GT(sinks.blocks, 0U);
  EXPECT_LT(relative_error(result, flight), 0.01);
  for (std::size_t i = 1; i < sinks.poses.size(); ++i)
    EXPECT_LT(sinks.poses[i - 1].frame, sinks.poses[i].frame);
}

/// Frames that were rendered beforehand, so that the source is never what is slow.
class Rendered final : public FrameSource {
 public:
  explicit Rendered(std::size_t frames) : flight_(short_flight()) {
    for (std::size_t i = 0; i < frames; ++i) frames_.push_back(flight_.render(i));
  }
  const SourceInfo& info() const override { return flight_.info(); }
  Expected<FramePtr> next(const std::stop_token&) override {
    return given_ < frames_.size() ? frames_[given_++] : nullptr;
  }
  SourceCounts counts() const override { return {given_, 0, 0, {}}; }

 private:
  SyntheticFlight flight_;
  std::vector<FramePtr> frames_;
  std::size_t given_ = 0;
};

TEST(Engine, APacedSourceIsDroppedFromNotWaitedFor) {
  // A thousand times the speed of the capture: no machine keeps up, so frames are dropped.
  SteadyClock clock;
  Player player(std::make_unique<Rendered>(40), clock, 1000.0);
  Options options = fast_options(2);
  options.mapping.enabled = false;
  const RunResult result = run(player, options);
  EXPECT_EQ(result.counts.dropped + result.events.size(), 40U);
  EXPECT_EQ(result.counts.delivered, result.events.size());
  EXPECT_GT(result.counts.dropped, 0U);
}

/// A paced source that always has the next frame ready before the last one's pose is out, so that
/// tracking never rests; it learns of the poses as a sink.
class Restless final : public FrameSource, public PoseSink {
 public:
  explicit Restless(std::size_t frames, std::size_t ahead = 2)
      : frames_(frames), info_(frames_.info()), ahead_(ahead) {
    info_.paced = true;
  }
  const SourceInfo& info() const override { return info_; }
  Expected<FramePtr> next(const std::stop_token& stop) override {
    std::unique_lock lock(mutex_);
    posed_.wait(lock, stop, [&] { return given_ < poses_ + ahead_; });
    ++given_;
    return frames_.next(stop);
  }
  SourceCounts counts() const override { return frames_.counts(); }
  void on_pose(const PoseEvent&) override {
    const std::lock_guard lock(mutex_);
    ++poses_;
    posed_.notify_all();
  }

 private:
  Rendered frames_;
  SourceInfo info_;
  std::size_t ahead_;
  std::mutex mutex_;
  std::condition_variable_any posed_;
  std::size_t given_ = 0, poses_ = 0;
};

TEST(Engine, MappingThatYieldsToTrackingStillMapsEveryKeyframe) {
  Restless source(60);
  const RunResult result = run(source, fast_options(2), {&source, nullptr});
  EXPECT_EQ(result.counts.dropped, 0U);
  EXPECT_EQ(result.events.size(), 60U);
  EXPECT_GT(result.mesh.triangles.size(), 500U);
  const auto note = std::find_if(result.notes.begin(), result.notes.end(),
                                 [](const std::string& n) { return n.starts_with("Mapping: "); });
  ASSERT_NE(note, result.notes.end());
  int depth_maps = 0, share = 0, without = 0, near = 0;
  ASSERT_EQ(std::sscanf(note->c_str(),
                        "Mapping: %d depth maps (%d %% of the rays answered), %d keyframes without "
                        "an answer, %d too near",
                        &depth_maps, &share, &without, &near),
            4)
      << *note;
  EXPECT_GT(depth_maps, 2);
  EXPECT_EQ(static_cast<std::size_t>(depth_maps + without + near), result.map->keyframes.size());
  // It was held back: tracking never rested.
  const auto held_s = [](const RunResult& r) {
    double total = 0;
    for (const StageMetrics& stage : r.stages)
      if (stage.name == "mapping/held") total += stage.total_s;
    return total;
  };
  EXPECT_GT(held_s(result), 0);
  Rendered unpaced(30);
  EXPECT_EQ(held_s(run(unpaced, fast_options(2))), 0);
}

// Frames that nobody will track any more lie in the queues and hold the gate; mapping waits there.
TEST(Engine, AFailureWhileMappingIsHeldEndsTheRun) {
  Restless source(60, 6);
  struct Broken final : PoseSink {
    Restless& source;
    int left = 35;
    explicit Broken(Restless& s) : source(s) {}
    void on_pose(const PoseEvent& event) override {
      if (--left == 0) throw std::logic_error("a bug in the sink");
      source.on_pose(event);
    }
  } sink(source);
  auto engine = Engine::create(fast_options(2));
  ASSERT_TRUE(engine);
  EXPECT_THROW((void)(*engine)->run(source, {&sink, nullptr}), std::logic_error);
}

TEST(Engine, AStopKeepsWhatThereIs) {
  for (const int threads : {1, 2}) {
    SyntheticFlight flight(short_flight(30));
    std::stop_source stop;
    struct Stopper final : PoseSink {
      std::stop_source& stop;
      int left = 25;
      explicit Stopper(std::stop_source& s) : stop(s) {}
      void on_pose(const PoseEvent&) override {
        if (--left == 0) stop.request_stop();
      }
    } stopper(stop);
    const RunResult result =
        run(flight, fast_options(threads), {&stopper, nullptr}, stop.get_token());
    EXPECT_TRUE(result.interrupted);
    EXPECT_GE(result.trajectory.size(), 20U);
    EXPECT_LE(result.events.size(), 30U);
  }
}

TEST(Engine, AStopIsHeardWhileMappingIsHeld) {
  Restless source(60);
  std::stop_source stop;
  struct Stopper final : PoseSink {
    Restless& source;
    std::stop_source& stop;
    int left = 35;
    Stopper(Restless& f, std::stop_source& s) : source(f), stop(s) {}
    void on_pose(const PoseEvent& event) override {
      if (--left == 0) stop.request_stop();
      source.on_pose(event);
    }
  } stopper(source, stop);
  const RunResult result = run(source, fast_options(2), {&stopper, nullptr}, stop.get_token());
  EXPECT_TRUE(result.interrupted);
  EXPECT_LE(result.events.size(), 40U);
}

/// Gives some frames of a flight, then fails or throws.
class BreakingSource final : public FrameSource {
 public:
  BreakingSource(std::size_t good, bool throws)
      : flight_(short_flight()), good_(good), throws_(throws) {}
  const SourceInfo& info() const override { return flight_.info(); }
  Expected<FramePtr> next(const std::stop_token&) override {
    if (given_ < good_) return flight_.render(given_++);
    if (throws_) throw std::logic_error("a bug in the source");
    return fail(ErrorCode::io, "the cable came out", "camera 0");
  }
  SourceCounts counts() const override { return {given_, 0, 0, {}}; }

 private:
  SyntheticFlight flight_;
  std::size_t good_, given_ = 0;
  bool throws_;
};

TEST(Engine, ASourceThatFailsAtOnceIsAnErrorAndLaterAPartialResult) {
  for (const int threads : {1, 2}) {
    auto engine = Engine::create(fast_options(threads));
    ASSERT_TRUE(engine);
    BreakingSource at_once(0, false), later(25, false);
    const auto nothing = (*engine)->run(at_once);
    ASSERT_FALSE(nothing);
    EXPECT_EQ(nothing.error().what, "the cable came out");
    const auto partial = (*engine)->run(later);
    ASSERT_TRUE(partial);
    EXPECT_TRUE(partial->interrupted);
    EXPECT_GE(partial->trajectory.size(), 15U);
    ASSERT_FALSE(partial->notes.empty());
    EXPECT_NE(partial->notes.back().find("the cable came out"), std::string::npos);
  }
}

TEST(Engine, AnExceptionInAStageStopsThePipelineAndComesOut) {
  for (const int threads : {1, 2}) {
    auto engine = Engine::create(fast_options(threads));
    ASSERT_TRUE(engine);
    BreakingSource source(3, true);
    EXPECT_THROW((void)(*engine)->run(source), std::logic_error);
  }
}

TEST(Engine, WrongOptionsAndDevicesAreRefusedByName) {
  Options options;
  options.frontend.template_px = 4;
  options.backend.window_keyframes = 0;
  const auto wrong = Engine::create(options);
  ASSERT_FALSE(wrong);
  EXPECT_EQ(wrong.error().code, ErrorCode::invalid_argument);
  EXPECT_NE(wrong.error().what.find("frontend.template_px"), std::string::npos);
  EXPECT_NE(wrong.error().what.find("backend.window_keyframes"), std::string::npos);
  Options device;
  device.device = "99";
  const auto absent = Engine::create(device);
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().code, ErrorCode::device);
}

}  // namespace
}  // namespace corvid
