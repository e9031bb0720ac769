#include "bench/matching/matching_bench.h"

#include <fmt/format.h>

#include <algorithm>
#include <opencv2/core.hpp>
#include <optional>
#include <utility>

#include "bench/matching/corvid_side.h"
#include "bench/matching/epipolar_truth.h"
#include "bench/matching/reconstruction.h"
#include "bench/matching/sift_side.h"
#include "bench/matching/tally.h"
#include "core/associate.h"
#include "core/log.h"
#include "frontend/pair_matcher.h"

namespace corvid {
namespace {

constexpr std::size_t kRunOfVideo = 3, kPairsOfRun = 3;

std::size_t pairs_of(std::size_t images) { return 2 * images - 3; }

// The frames of the runs, in order; fewer where the source ends early or skips images.
Expected<std::vector<std::vector<FramePtr>>> read_runs(FrameSource& source, int pairs,
                                                       const std::stop_token& stop) {
  const SourceInfo& info = source.info();
  std::vector<std::vector<FramePtr>> images;
  std::size_t position = 0;
  for (const auto& [first, count] : choose_runs(info.frames, info.stills, pairs)) {
    auto& run = images.emplace_back();
    while (position < first + count) {
      if (stop.stop_requested()) return images;
      auto frame = source.next(stop);
      if (!frame) return tl::unexpected(frame.error());
      if (!*frame) break;
      if (position >= first) run.push_back(std::move(*frame));
      ++position;
    }
  }
  std::erase_if(images, [](const auto& run) { return run.size() < 2; });
  return images;
}

struct Side {
  PairSide& matcher;
  Tally tally{};
  std::vector<MatchedPair> pairs{};  // of the current run
};

class MatchingBench {
 public:
  MatchingBench(PairMatcher& matcher, const MatchingBenchOptions& options, std::stop_token stop,
                MatchingReport& report)
      : sift_(options.runs),
        corvid_(matcher, options.runs),
        options_(options),
        stop_(std::move(stop)),
        report_(report) {}

  Expected<void> run(const MatchingSet& set) {
    log().info("{}: reading images", set.name);
    auto runs = read_runs(*set.source, options_.pairs, stop_);
    if (!runs) return tl::unexpected(runs.error());
    if (stop_.stop_requested()) return {};
    if (runs->empty()) {
      return fail(ErrorCode::invalid_argument, "fewer than two images", set.name,
                  "matching takes pairs of images");
    }
    warm_up(set.name, runs->front());
    Side sift{sift_}, corvid{corvid_};
    std::size_t wanted = 0, done = 0, images = 0;
    for (const auto& run : *runs) wanted += pairs_of(run.size());
    const Trajectory truth = set.source->truth();
    const IntrinsicsOrigin origin = set.source->info().intrinsics;
    for (const auto& run : *runs) {
      std::vector<std::int64_t> times_ns;
      for (const FramePtr& image : run) times_ns.push_back(image->time_ns);
      const auto T_world_camera = true_poses(times_ns, truth);
      const std::size_t before = done;
      match_run(set.name, run, T_world_camera, wanted, sift, corvid, done);
      if (done == before) break;
      images += run.size();
      log().info("{}: bundle adjustment of {} images", set.name, run.size());
      for (Side* side : {&sift, &corvid})
        side->tally.add(reconstruct(run, T_world_camera, side->pairs, origin));
    }
    if (done == 0) return {};
    const Camera& camera = *runs->front().front()->camera;
    report_.rows.push_back({set.name, camera.width_px, camera.height_px, static_cast<int>(images),
                            sift.tally.figures(), corvid.tally.figures()});
    return {};
  }

 private:
  // First use builds kernels for the images' size, and starts threads.
  void warm_up(const std::string& name, const std::vector<FramePtr>& images) {
    log().info("{}: preparing for {}x{} images", name, images[0]->grey.width(),
               images[0]->grey.height());
    for (PairSide* side : {static_cast<PairSide*>(&sift_), static_cast<PairSide*>(&corvid_)}) {
      if (stop_.stop_requested()) return;
      side->start(images);
      (void)side->match(0, 1);
    }
  }

  void match_run(const std::string& name, const std::vector<FramePtr>& images,
                 const std::vector<std::optional<Pose>>& T_world_camera, std::size_t wanted,
                 Side& sift, Side& corvid, std::size_t& done) {
    const Camera& camera = *images[0]->camera;
    for (Side* side : {&sift, &corvid}) {
      side->matcher.start(images);
      side->pairs.clear();
    }
    const int count = static_cast<int>(images.size());
    for (int r = 0; r + 1 < count; ++r) {
      for (int t = r + 1; t < std::min(r + 3, count); ++t) {
        if (stop_.stop_requested()) return;
        const auto &T_r = T_world_camera[static_cast<std::size_t>(r)],
                   &T_t = T_world_camera[static_cast<std::size_t>(t)];
        const auto F = T_r && T_t ? true_fundamental(camera, *T_r, *T_t) : std::nullopt;
        for (Side* side : {&sift, &corvid}) {
          side->pairs.push_back(side->matcher.match(r, t));
          side->tally.add(camera, side->pairs.back(), F);
        }
        const MatchedPair &s = sift.pairs.back(), &c = corvid.pairs.back();
        log().info("{}: pair {} of {}: SIFT {} matches, {:.0f} ms; Corvid {}, {:.0f} ms", name,
                   ++done, wanted, s.matches.size(), s.ms, c.matches.size(), c.ms);
      }
    }
  }

  SiftSide sift_;
  CorvidSide corvid_;
  const MatchingBenchOptions& options_;
  std::stop_token stop_;
  MatchingReport& report_;
};

}  // namespace

std::vector<std::pair<std::size_t, std::size_t>> choose_runs(std::optional<std::size_t> frames,
                                                             bool stills, int pairs) {
  const auto most = static_cast<std::size_t>(std::max(pairs, 3));
  std::vector<std::pair<std::size_t, std::size_t>> chosen;
  if (frames && *frames < 2) return chosen;
  if (stills || (frames && *frames < kRunOfVideo)) {
    const std::size_t count = (most + 3) / 2;  // pairs_of(count) <= most
    return {{0, frames ? std::min(*frames, count) : count}};
  }
  std::size_t runs = most / kPairsOfRun;
  if (frames) runs = std::min(runs, *frames / kRunOfVideo);
  for (std::size_t k = 0; k < runs; ++k) {
    const std::size_t first = !frames    ? k * kRunOfVideo
                              : runs > 1 ? k * (*frames - kRunOfVideo) / (runs - 1)
                                         : 0;
    chosen.emplace_back(first, kRunOfVideo);
  }
  return chosen;
}

Expected<void> run_matching_bench(const std::shared_ptr<Device>& device,
                                  std::span<const MatchingSet> sets,
                                  const MatchingBenchOptions& options, const std::stop_token& stop,
                                  MatchingReport& report) {
  report = {};
  report.runs = options.runs;
  if (options.pairs < 3 || options.runs < 1) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("{} pairs, {} runs of each work", options.pairs, options.runs),
                "matching bench", "at least 3 pairs and 1 run");
  }
  auto machine = bench_machine(*device);
  if (!machine) return tl::unexpected(machine.error());
  report.machine = std::move(*machine);
  Expected<void> done;
  try {
    auto matcher = PairMatcher::create(device, options.matching);
    if (!matcher) return tl::unexpected(matcher.error());
    MatchingBench bench(**matcher, options, stop, report);
    for (const MatchingSet& set : sets) {
      if (!done || stop.stop_requested()) break;
      done = bench.run(set);
    }
  } catch (const DeviceFault& fault) {
    done = fail(ErrorCode::device, fault.what(), device->info().name);
  }
  report.interrupted = stop.stop_requested();
  return done;
}

}  // namespace corvid
