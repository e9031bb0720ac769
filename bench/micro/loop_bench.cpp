// A loop closed, and two segments joined, in maps of long flights: what the pose thread does for a
// recognised keyframe, its snapshot included. docs/decisions/places.md.
#include <benchmark/benchmark.h>

#include <memory>

#include "backend/places.h"
#include "backend/window.h"
#include "bench/micro/long_flight.h"

namespace corvid {
namespace {

/// Rounds over known ground, then 400 keyframes over new ground, and back.
std::unique_ptr<LongFlight> flight(int keyframes, int segment_of_excursion) {
  constexpr int kExcursion = 400;
  auto f = std::make_unique<LongFlight>(LongFlightOptions{
      .keyframes = keyframes, .excursion = kExcursion, .found = 0.5, .drift = 5e-4});
  for (int k = keyframes - kExcursion; k < keyframes; ++k)
    f->map.keyframes[static_cast<std::size_t>(k)].segment = segment_of_excursion;
  (void)f->map.snapshot(1);
  return f;
}

/// The last keyframe is found where the rounds ended.
PlacePose found(const LongFlight& f) {
  PlacePose place;
  place.ok = true;
  place.reference = static_cast<int>(f.map.keyframes.size()) - 401;
  const Sim3 T = f.seen_from(place.reference, static_cast<int>(f.map.keyframes.size()) - 1);
  place.T_world_query = {T.rotation(), T.translation()};
  const MapKeyframe& reference = f.map.keyframes[static_cast<std::size_t>(place.reference)];
  for (const TrackId id : reference.tracks) {
    const auto pixel =
        f.map.camera.project(place.T_world_query.inverse() * f.map.tracks.at(id).p_world);
    if (pixel && f.map.camera.in_image(*pixel)) place.inliers.push_back({id, {id, *pixel}});
  }
  return place;
}

void recognise(benchmark::State& state, PlaceOutcome::Kind kind) {
  const auto keyframes = static_cast<int>(state.range(0));
  const BackendOptions options;
  for (auto _ : state) {
    state.PauseTiming();
    auto f = flight(keyframes, kind == PlaceOutcome::Kind::merge ? 1 : 0);
    const PlacePose place = found(*f);
    FusedTracks fused;
    state.ResumeTiming();
    const PlaceOutcome outcome =
        recognise_keyframe(f->map, f->frames, fused, keyframes - 1, place, options, 1);
    adjust_window(f->map, 0, options.window_keyframes, options, 1,
                  {IntrinsicsFreedom::fixed, f->map.camera});
    benchmark::DoNotOptimize(f->map.snapshot(2));
    state.PauseTiming();
    if (outcome.kind != kind) state.SkipWithError(outcome.reason.c_str());
    f.reset();
    state.ResumeTiming();
  }
}

void sizes(benchmark::internal::Benchmark* b) {
  b->Arg(2000)->Arg(8000)->Arg(20000)->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();
}
BENCHMARK_CAPTURE(recognise, loop, PlaceOutcome::Kind::loop)->Apply(sizes);
BENCHMARK_CAPTURE(recognise, merge, PlaceOutcome::Kind::merge)->Apply(sizes);

}  // namespace
}  // namespace corvid

BENCHMARK_MAIN();
