#include "frontend/place_finder.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>

#include "frontend/motion_field.h"

namespace corvid {
namespace {

constexpr int kMatchedPoints = 1200;      // of a keyframe: its landmarks, and corners beside them
constexpr std::size_t kConnected = 30;    // landmarks in common: nothing new can come of a match
constexpr std::size_t kReach = 10;        // keyframes before and after a connected one: just left
constexpr std::size_t kMostRefusals = 2;  // of the most similar: then the others are not either
constexpr int kMostResting = 7;           // keyframes
constexpr int kRestingWhenFound = 3;      // keyframes: they are connected through the one that was
constexpr double kBorderPx = 12;          // templates fit into the image
constexpr std::size_t kSpacing = 2;       // between the keyframes that are tried

std::size_t common(const std::vector<TrackObservation>& tracks,
                   const std::vector<Observation>& landmarks) {
  std::size_t count = 0;
  auto track = tracks.begin();
  for (const Observation& o : landmarks) {
    while (track != tracks.end() && track->track.value < o.landmark.value) ++track;
    if (track == tracks.end()) break;
    count += track->track.value == o.landmark.value ? 1 : 0;
  }
  return count;
}

/// Matches of the first points per such point whose place in the target, as their neighbours tell
/// it, lies in the image.
double share_in_view(const Camera& target, std::span<const Eigen::Vector2d> points,
                     const PairMatches& matches) {
  std::vector<Eigen::Vector2d> from, to;
  std::size_t found = 0;
  for (const PairMatch& match : matches.matches) {
    from.push_back(match.x_r);
    to.push_back(match.x_t);
    found += match.point < points.size() ? 1 : 0;
  }
  if (found == 0) return 0;
  const MotionField field(from, to, Eigen::Matrix2d::Identity());
  std::size_t in_view = 0;
  for (const LocalMotion& motion : field.at(points))
    in_view += motion.x_t.allFinite() && target.in_image(motion.x_t, kBorderPx) ? 1 : 0;
  return std::min(1.0, static_cast<double>(found) / static_cast<double>(std::max(in_view, found)));
}

}  // namespace

Expected<std::unique_ptr<PlaceFinder>> PlaceFinder::create(std::shared_ptr<Device> device,
                                                           const PlaceOptions& options,
                                                           const MatchingOptions& matching,
                                                           std::function<void()> yield) {
  MatchingOptions small = matching;
  small.max_points = std::min(matching.max_points, kMatchedPoints);
  auto pairs = PairMatcher::create(std::move(device), small, Lane::mapping);
  if (!pairs) return tl::unexpected(pairs.error());
  if (!yield) yield = [] {};
  return std::unique_ptr<PlaceFinder>(
      new PlaceFinder(options, std::move(*pairs), std::move(yield)));
}

PlaceFinder::PlaceFinder(const PlaceOptions& options, std::unique_ptr<PairMatcher> pairs,
                         std::function<void()> yield)
    : options_(options), pairs_(std::move(pairs)), yield_(std::move(yield)) {}

std::vector<std::uint8_t> PlaceFinder::unconnected(const FrameTracks& query,
                                                   const MapSnapshot& map) {
  std::vector<std::uint8_t> usable(map.keyframes.size(), 1);
  for (std::size_t k = 0; k < map.keyframes.size(); ++k) {
    const Keyframe& keyframe = *map.keyframes[k];
    if (keyframe.observations.empty()) usable[k] = 0;  // it rests: another one shows the same
    const bool same = keyframe.frame->id == query.frame->id;
    if (!same && common(query.observations, keyframe.observations) < kConnected) continue;
    const std::size_t first = k > kReach ? k - kReach : 0;
    const std::size_t last = std::min(usable.size(), k + kReach + 1);
    std::fill(usable.begin() + static_cast<std::ptrdiff_t>(first),
              usable.begin() + static_cast<std::ptrdiff_t>(last), std::uint8_t{0});
  }
  return usable;
}

PlaceSearch PlaceFinder::find(const FrameTracks& query, const MapSnapshot& map) {
  timings_.clear();
  Stopwatch watch;
  PlaceSearch search;
  search.match.query = query.frame->id;
  while (index_.size() < map.keyframes.size()) {
    index_.add(describe_place(map.keyframes[index_.size()]->frame->load()->grey));
    yield_();
  }
  const bool known = std::any_of(map.keyframes.begin(), map.keyframes.end(),
                                 [&](const auto& k) { return k->frame->id == query.frame->id; });
  if (known && resting_ > 0) {
    --resting_;
    return search;
  }
  std::vector<std::uint8_t> usable = unconnected(query, map);
  usable.resize(index_.size(), 0);  // an older state of the map
  if (std::find(usable.begin(), usable.end(), 1) == usable.end()) return search;
  const auto ranked = index_.rank(describe_place(query.frame->grey), usable,
                                  static_cast<std::size_t>(options_.candidates), kSpacing, yield_);
  timings_.emplace_back("place/rank", watch.lap_ms());

  std::optional<MatchView> target;
  for (const RankedPlace& place : ranked) {
    const bool vain = search.match.references.empty() && search.refusals.size() >= kMostRefusals;
    if (place.similarity < options_.min_similarity || vain) break;
    yield_();
    if (!target) target = pairs_->prepare(query.frame->grey, *query.frame->camera);
    const Keyframe& keyframe = *map.keyframes[place.position];
    std::string refusal;
    PlaceReference reference = verify(keyframe, *target, refusal);
    reference.similarity = place.similarity;
    if (refusal.empty()) {
      search.match.references.push_back(std::move(reference));
    } else {
      search.refusals.push_back(fmt::format("frame {}, similarity {:.2f}: {}",
                                            keyframe.frame->id.value, place.similarity, refusal));
    }
  }
  if (target) timings_.emplace_back("place/verify", watch.lap_ms());
  if (target && known) {
    vain_ = search.match.references.empty() ? std::min(2 * vain_ + 1, kMostResting) : 0;
    resting_ = search.match.references.empty() ? vain_ : kRestingWhenFound;
  }
  return search;
}

PlaceReference PlaceFinder::verify(const Keyframe& keyframe, const MatchView& target,
                                   std::string& refusal) {
  const auto least = static_cast<std::size_t>(options_.min_landmarks);
  PlaceReference reference;
  reference.keyframe = keyframe.frame->id;
  std::vector<Eigen::Vector2d> pixels, found;
  for (const Observation& o : keyframe.observations) pixels.push_back(o.pixel);
  if (pixels.size() < least) {
    refusal = fmt::format("it has only {} landmarks", pixels.size());
    return reference;
  }
  const FramePtr frame = keyframe.frame->load();
  if (frame->grey.empty()) {
    refusal = "its picture cannot be read back";
    return reference;
  }
  const MatchView view = pairs_->prepare(frame->grey, *frame->camera, pixels);
  yield_();
  const PairMatches matches = pairs_->match(view, target, {.upright = true});
  for (const PairMatch& match : matches.matches) {
    if (match.point >= pixels.size()) break;  // a corner
    found.push_back(match.x_t);
    reference.views.push_back({TrackId(keyframe.observations[match.point].landmark.value),
                               match.x_t, match.covariance_px2});
  }
  reference.share = share_in_view(target.camera, pixels, matches);
  if (!matches.refusal.empty()) {
    refusal = matches.refusal;
  } else if (reference.views.size() < least) {
    refusal = fmt::format("only {} of its {} landmarks were found", reference.views.size(),
                          pixels.size());
  } else if (reference.share < options_.min_share) {
    refusal = fmt::format("only {:.0f} % of the landmarks that should be in view were found",
                          100 * reference.share);
  } else if (const int parts = parts_seen(target.camera, found); parts < kMinPartsSeen) {
    refusal = fmt::format("what it has in common lies in {} of 16 parts of the image", parts);
  }
  return reference;
}

}  // namespace corvid
