// Places recognised by appearance and NCC, on rendered flights.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>
#include <vector>

#include "frontend/place_finder.h"
#include "frontend/place_index.h"
#include "tests/frontend/frontend_scenes.h"
#include "tests/scenes/memory_archive.h"

namespace corvid {
namespace {

GreyImage noise(std::uint64_t seed, int amplitude) {
  std::mt19937_64 random(seed);
  GreyImage image(320, 240, 100);
  for (std::size_t i = 0; i < image.size(); ++i)
    image.data()[i] = static_cast<std::uint8_t>(
        100 + static_cast<int>(random() % static_cast<std::uint64_t>(amplitude + 1)));
  return image;
}

TEST(PlaceIndex, LightDoesNotMatterTheSceneDoes) {
  const SyntheticFlight flight(test::small_flight());
  const GreyImage a = flight.render(0)->grey;
  GreyImage dim = a;
  for (std::size_t i = 0; i < dim.size(); ++i)
    dim.data()[i] = static_cast<std::uint8_t>(20 + 0.7 * dim.data()[i]);
  const PlaceDescriptor d = describe_place(a);
  EXPECT_NEAR(similarity(d, d), 1, 1e-5);
  EXPECT_GT(similarity(d, describe_place(dim)), 0.9);
  GreyImage mirrored = a;
  for (int y = 0; y < a.height(); ++y)
    for (int x = 0; x < a.width(); ++x) mirrored(x, y) = a(a.width() - 1 - x, y);
  EXPECT_LT(similarity(d, describe_place(mirrored)), 0.6);
}

TEST(PlaceIndex, EveryImageHasAnAnswer) {
  const PlaceDescriptor none = describe_place(GreyImage()), flat = describe_place({64, 48, 7}),
                        dot = describe_place({1, 1, 200}), rough = describe_place(noise(1, 255));
  for (const PlaceDescriptor* d : {&none, &flat, &dot}) {
    EXPECT_EQ(similarity(*d, *d), 0);
    EXPECT_EQ(similarity(*d, rough), 0);
  }
  EXPECT_LT(similarity(rough, describe_place(noise(2, 255))), 0.3);
  PlaceIndex index;
  EXPECT_TRUE(index.rank(none, {}, 5, 1).empty());
  EXPECT_THROW(static_cast<void>(index.rank(none, {1}, 5, 1)), std::logic_error);
}

TEST(PlaceIndex, RanksAndKeepsApart) {
  const SyntheticFlight flight(test::small_flight());
  PlaceIndex index;
  for (std::size_t i = 0; i < 10; ++i) index.add(describe_place(flight.render(8 * i)->grey));
  const PlaceDescriptor query = describe_place(flight.render(33)->grey);
  std::vector<std::uint8_t> usable(10, 1);
  auto best = index.rank(query, usable, 3, 1);
  ASSERT_EQ(best.size(), 3U);
  EXPECT_EQ(best[0].position, 4U);
  for (std::size_t i = 1; i < best.size(); ++i) {
    EXPECT_GE(best[i - 1].similarity, best[i].similarity);
    EXPECT_GT(std::abs(static_cast<double>(best[i].position) - 4.0), 1);
  }
  usable[4] = 0;
  EXPECT_NE(index.rank(query, usable, 1, 1).at(0).position, 4U);
}

TEST(PlaceIndex, RankingALongFlightLetsOthersGoBefore) {
  PlaceIndex index;
  const PlaceDescriptor place = describe_place(noise(1, 255));
  int yields = 0;
  for (std::size_t i = 0; i < 1000; ++i) index.add(place);
  EXPECT_EQ(index.rank(place, std::vector<std::uint8_t>(1000, 1), 1, 0, [&] { ++yields; }).size(),
            1U);
  EXPECT_EQ(yields, 3);
}

SyntheticFlight flight_of(double duration_s) {
  FlightOptions options = test::small_flight();
  options.duration_s = duration_s;
  return SyntheticFlight(options);
}

/// Keyframes of a flight with points of a grid as landmarks.
struct TrueMap {
  MapSnapshot map;
  std::vector<Pose> poses;

  TrueMap(const SyntheticFlight& flight, std::size_t keyframes, std::size_t step = 12) {
    for (std::size_t i = 0; i < keyframes; ++i) add(flight, step * i);
  }
  void add(const SyntheticFlight& flight, std::size_t frame) {
    auto keyframe = std::make_shared<Keyframe>();
    keyframe->id = KeyframeId(static_cast<std::uint32_t>(map.keyframes.size()));
    auto image = std::make_shared<Frame>(*flight.render(frame));
    image->id = FrameId(static_cast<std::uint32_t>(frame));
    keyframe->frame = std::make_shared<const StoredFrame>(image);
    keyframe->T_world_camera = flight.true_pose(frame);
    for (int y = 20; y < image->grey.height() - 20; y += 14)
      for (int x = 20; x < image->grey.width() - 20; x += 14)
        keyframe->observations.push_back({LandmarkId(next_++), Eigen::Vector2d(x, y)});
    poses.push_back(keyframe->T_world_camera);
    map.keyframes.push_back(std::move(keyframe));
  }

 private:
  std::uint32_t next_ = 0;
};

std::unique_ptr<PlaceFinder> finder() {
  auto made = PlaceFinder::create(test::device(), PlaceOptions(), MatchingOptions());
  if (!made) throw std::runtime_error(made.error().to_string());
  return std::move(*made);
}

FrameTracks query_of(FramePtr frame) {
  auto image = std::make_shared<Frame>(*frame);
  image->id = FrameId(900'000);
  FrameTracks tracks;
  tracks.frame = std::move(image);
  tracks.keyframe = true;
  return tracks;
}

/// Share of a reference's views that lie within a pixel of the truth, of those that have one.
double right_share(const SyntheticFlight& flight, const TrueMap& map,
                   const PlaceReference& reference, const Pose& T_world_query) {
  std::size_t right = 0, known = 0;
  for (std::size_t k = 0; k < map.map.keyframes.size(); ++k) {
    const Keyframe& keyframe = *map.map.keyframes[k];
    if (keyframe.frame->id != reference.keyframe) continue;
    const FloatImage depth = flight.render_depth(map.poses[k]);
    std::size_t at = 0;
    for (const PlaceView& v : reference.views) {
      while (keyframe.observations[at].landmark.value != v.landmark.value) ++at;
      const auto truth = test::true_place(flight, map.poses[k], depth,
                                          keyframe.observations[at].pixel, T_world_query);
      if (!truth) continue;
      ++known;
      right += (*truth - v.pixel).norm() < 1 ? 1 : 0;
    }
  }
  return known > 0 ? static_cast<double>(right) / static_cast<double>(known) : 0;
}

TEST(PlaceFinder, APlaceSeenFromBesideIsFoundExactly) {
  const SyntheticFlight flight = flight_of(20);
  const TrueMap map(flight, 8);
  // 3 m to the side, turned by 9 degrees and tilted.
  const Pose T =
      flight.true_pose(50) * Pose(so3_exp({0.04, -0.05, 0.16}), Eigen::Vector3d(3, 0.5, -1));
  auto places = finder();
  const PlaceSearch search = places->find(query_of(flight.render(T, 50)), map.map);
  ASSERT_FALSE(search.match.references.empty())
      << (search.refusals.empty() ? "nothing was tried" : search.refusals[0]);
  for (const PlaceReference& reference : search.match.references) {
    const double right = right_share(flight, map, reference, T);
    std::printf("frame %u: %zu landmarks, %.2f found, %.1f %% right\n", reference.keyframe.value,
                reference.views.size(), reference.share, 100 * right);
    EXPECT_GT(right, 0.95);
  }
}

TEST(PlaceFinder, KeyframesThatRestAreNotTriedInTheOthersStead) {
  const SyntheticFlight flight = flight_of(20);
  TrueMap map(flight, 8);
  for (std::size_t i = 0; i < 11; ++i) {  // they look most like the query, and see nothing
    map.add(flight, 49 + i);
    auto resting = std::make_shared<Keyframe>(*map.map.keyframes.back());
    resting->observations.clear();
    map.map.keyframes.back() = resting;
  }
  const PlaceSearch search = finder()->find(query_of(flight.render(54)), map.map);
  ASSERT_FALSE(search.match.references.empty())
      << (search.refusals.empty() ? "nothing was tried" : search.refusals[0]);
}

TEST(PlaceFinder, AnotherPlaceIsNotFound) {
  const SyntheticFlight flight = flight_of(60);
  const TrueMap map(flight, 6);
  auto places = finder();
  for (const std::size_t frame : {400U, 700U, 1000U}) {
    const PlaceSearch search = places->find(query_of(flight.render(frame)), map.map);
    EXPECT_TRUE(search.match.references.empty()) << frame;
  }
  EXPECT_TRUE(places
                  ->find(query_of(std::make_shared<Frame>(Frame{FrameId(1),
                                                                0,
                                                                GreyImage(480, 320, 9),
                                                                {},
                                                                map.map.keyframes[0]->frame->camera,
                                                                "",
                                                                ""})),
                         map.map)
                  .match.references.empty());
  EXPECT_TRUE(finder()->find(query_of(flight.render(0)), MapSnapshot()).match.references.empty());
}

TEST(PlaceFinder, WindowsThatAreAllAlikeAreNotTakenForEachOther) {
  FlightOptions options = test::small_flight();
  options.path = FlightPath::facade;
  options.duration_s = 40;
  const SyntheticFlight flight(options);
  const TrueMap map(flight, 6, 20);
  auto places = finder();
  int found = 0;
  for (const std::size_t frame : {30U, 90U, 300U, 420U, 560U, 700U}) {
    const PlaceSearch search = places->find(query_of(flight.render(frame)), map.map);
    for (const PlaceReference& reference : search.match.references) {
      const double right = right_share(flight, map, reference, flight.true_pose(frame));
      std::printf("frame %zu in frame %u: %zu landmarks, %.2f found, %.1f %% right\n", frame,
                  reference.keyframe.value, reference.views.size(), reference.share, 100 * right);
      EXPECT_GT(right, 0.8);
      ++found;
    }
  }
  EXPECT_GE(found, 2) << "where it is, it is found";
}

TEST(PlaceFinder, LetsOthersGoBeforeEachKeyframeThatItMeetsFirst) {
  const SyntheticFlight flight(test::small_flight());
  const TrueMap map(flight, 3);
  int yields = 0;
  auto places =
      PlaceFinder::create(test::device(), PlaceOptions(), MatchingOptions(), [&] { ++yields; });
  ASSERT_TRUE(places.has_value());
  FrameTracks known = query_of(flight.render(20));  // its tracks tell all: nothing is matched
  for (std::uint32_t i = 0; i < 40; ++i) known.observations.push_back({TrackId(i)});
  (void)(*places)->find(known, map.map);
  EXPECT_EQ(yields, 3);
  (void)(*places)->find(known, map.map);
  EXPECT_EQ(yields, 3);
}

TEST(PlaceFinder, WhatTheTracksKnowIsNoNews) {
  const SyntheticFlight flight(test::small_flight());
  const TrueMap map(flight, 3);
  FrameTracks query = query_of(flight.render(20));
  for (std::uint32_t i = 0; i < 40; ++i) query.observations.push_back({TrackId(i)});
  EXPECT_TRUE(finder()->find(query, map.map).match.references.empty());
  query.observations.resize(10);
  EXPECT_FALSE(finder()->find(query, map.map).match.references.empty());
}

TEST(PlaceFinder, KeyframesAfterOneThatWasFoundRest) {
  const SyntheticFlight flight = flight_of(20);
  TrueMap map(flight, 17);
  std::vector<std::size_t> again;  // the beginning, flown a second time
  for (std::size_t i = 0; i < 5; ++i) map.add(flight, again.emplace_back(12 * i + 2));
  auto places = finder();
  std::vector<bool> found;
  for (const std::size_t frame : again) {
    FrameTracks query = query_of(flight.render(frame));
    const auto known = std::find_if(
        map.map.keyframes.begin(), map.map.keyframes.end(),
        [&](const auto& k) { return k->frame->id == FrameId(static_cast<std::uint32_t>(frame)); });
    ASSERT_NE(known, map.map.keyframes.end());
    query.frame = (*known)->frame->load();
    found.push_back(!places->find(query, map.map).match.references.empty());
  }
  EXPECT_EQ(found, (std::vector<bool>{true, false, false, false, true}));
}

TEST(PlaceFinder, APictureThatCannotBeReadBackIsRefusedWithWords) {
  const SyntheticFlight flight(test::small_flight());
  const TrueMap map(flight, 3);
  const FrameTracks query = query_of(flight.render(20));
  auto places = finder();
  ASSERT_FALSE(places->find(query, map.map).match.references.empty());  // all are indexed
  const auto archive = std::make_shared<testing::MemoryArchive>();
  for (const auto& keyframe : map.map.keyframes)
    ASSERT_TRUE(keyframe->frame->put_away(archive).has_value());
  archive->broken = true;
  const PlaceSearch search = places->find(query, map.map);
  EXPECT_TRUE(search.match.references.empty());
  ASSERT_FALSE(search.refusals.empty());
  EXPECT_NE(search.refusals[0].find("cannot be read back"), std::string::npos);
  archive->broken = false;
  EXPECT_FALSE(places->find(query, map.map).match.references.empty());
}

}  // namespace
}  // namespace corvid
