#include "frontend/window_matcher.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <unordered_set>

#include "core/check.h"
#include "frontend/epipolar.h"
#include "frontend/merge.h"

namespace corvid {
namespace {

constexpr double kSamePlacePx = 1.5;  // tracks closer than this follow the same feature
constexpr double kChainedPx = 0.3;    // Sampson distance of places that a chain of matches gave
constexpr double kAgreeSigmas = 4;    // places of one track that differ by more do not agree
// What the covariances do not know of: templates are flat, the scene is not.
constexpr double kModelSigmaPx = 0.15;

}  // namespace

std::vector<FramePair> window_pairs(int frames, int first_new) {
  std::vector<FramePair> pairs;
  for (int baseline = 1; baseline < frames; ++baseline)
    for (int reference = 0; reference + baseline < frames; ++reference)
      if (reference + baseline >= first_new) pairs.emplace_back(reference, reference + baseline);
  return pairs;
}

std::optional<TrackPlace> agreed_place(std::span<const TrackPlace> places) {
  CORVID_CHECK(!places.empty(), "a track that was found has a place");
  const auto best =
      std::min_element(places.begin(), places.end(), [](const auto& a, const auto& b) {
        return a.covariance_px2.trace() < b.covariance_px2.trace();
      });
  for (const TrackPlace& other : places) {
    const Eigen::Vector2d apart = other.pixel - best->pixel;
    const Eigen::Matrix2d covariance = best->covariance_px2 + other.covariance_px2 +
                                       kModelSigmaPx * kModelSigmaPx * Eigen::Matrix2d::Identity();
    if (!(apart.dot(covariance.inverse() * apart) <= kAgreeSigmas * kAgreeSigmas))
      return std::nullopt;
  }
  return *best;
}

Expected<std::unique_ptr<WindowMatcher>> WindowMatcher::create(std::shared_ptr<Device> device,
                                                               const MatchingOptions& options) {
  auto matcher = PairMatcher::create(std::move(device), options);
  if (!matcher) return tl::unexpected(matcher.error());
  return std::unique_ptr<WindowMatcher>(new WindowMatcher(std::move(*matcher), options));
}

std::optional<Eigen::Matrix3d> WindowMatcher::chained_fundamental(int reference, int target) const {
  const auto view = [&](int i) -> const View& { return views_[static_cast<std::size_t>(i)]; };
  std::unordered_map<TrackId, Eigen::Vector2d> in_target;
  for (int between = reference + 1; between < target; ++between) {
    const PairMatches& pair =
        view(between).to_newer[static_cast<std::size_t>(target - between - 1)];
    for (const PairMatch& match : pair.matches)
      if (const auto track = view(between).tracks[match.point])
        in_target.try_emplace(*track, match.x_t);
  }
  std::vector<Eigen::Vector2d> x_r, x_t;
  for (std::size_t i = 0; i < view(reference).tracks.size(); ++i) {
    const auto track = view(reference).tracks[i];
    const auto found = track ? in_target.find(*track) : in_target.end();
    if (found == in_target.end()) continue;
    const auto a = undistort_pixel(view(reference).view.camera, view(reference).view.points[i]);
    const auto b = undistort_pixel(view(target).view.camera, found->second);
    if (!a || !b) continue;
    x_r.push_back(*a);
    x_t.push_back(*b);
  }
  const auto geometry = estimate_fundamental(x_r, x_t, kChainedPx, options_.disambiguation.seed);
  if (!geometry || geometry->inliers < 2 * options_.disambiguation.min_matches) return std::nullopt;
  return geometry->F;
}

PairMatches WindowMatcher::match(int reference, int target) {
  const auto view = [&](int i) -> View& { return views_[static_cast<std::size_t>(i)]; };
  std::vector<AuxiliaryMatches> thirds;
  for (int between = reference + 1; between < target; ++between) {
    const PairMatches& first =
        view(reference).to_newer[static_cast<std::size_t>(between - reference - 1)];
    const PairMatches& second =
        view(between).to_newer[static_cast<std::size_t>(target - between - 1)];
    if (!first.F) continue;
    thirds.push_back(auxiliary_matches(view(reference).view, view(between).view, first));
    if (second.F) thirds.back().F_auxiliary_target = second.F->transpose();
  }
  // And the image before the reference: the target comes last of the three.
  if (reference > 0) {
    const auto& earlier = view(reference - 1).to_newer;
    if (!earlier.empty() && earlier.front().F)
      thirds.push_back(prior_matches(view(reference - 1).view, view(reference).view,
                                     earlier.front(), options_.disambiguation));
  }
  return matcher_->match(view(reference).view, view(target).view,
                         {chained_fundamental(reference, target), thirds});
}

std::vector<WindowMatcher::Seen> WindowMatcher::follow(WindowFrame& result) {
  std::vector<Seen> found;
  for (std::size_t r = 0; r + 1 < views_.size(); ++r) {
    const View& reference = views_[r];
    for (const PairMatch& match : reference.to_newer.back().matches) {
      if (!reference.tracks[match.point]) continue;
      // An error of the place in the reference moves the match by as much.
      const Eigen::Matrix2d to_here = match.warp.inverse();
      found.push_back({*reference.tracks[match.point],
                       {match.x_t,
                        match.covariance_px2 +
                            to_here * reference.covariances_px2[match.point] * to_here.transpose(),
                        match.score}});
    }
  }
  std::stable_sort(found.begin(), found.end(),
                   [](const Seen& a, const Seen& b) { return a.track < b.track; });
  std::vector<Seen> seen;
  std::vector<TrackId> torn;
  std::vector<TrackPlace> places;
  for (std::size_t i = 0; i < found.size();) {
    places.clear();
    const TrackId track = found[i].track;
    for (; i < found.size() && found[i].track == track; ++i) places.push_back(found[i].place);
    if (const auto place = agreed_place(places))
      seen.push_back({track, *place});
    else
      torn.push_back(track);
  }
  end(torn);
  result.disagreed = torn.size();
  return seen;
}

std::vector<WindowMatcher::Seen> WindowMatcher::merge(const std::vector<Seen>& seen,
                                                      WindowFrame& result) {
  std::vector<Eigen::Vector2d> pixels;
  for (const Seen& one : seen) pixels.push_back(one.place.pixel);
  const std::vector<std::size_t> duplicates = find_duplicates(pixels, {}, kSamePlacePx);
  std::vector<Seen> kept;
  std::vector<TrackId> ended;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (ended.size() < duplicates.size() && duplicates[ended.size()] == i)
      ended.push_back(seen[i].track);
    else
      kept.push_back(seen[i]);
  }
  end(ended);
  result.merged = ended.size();
  return kept;
}

void WindowMatcher::end(std::span<const TrackId> tracks) {
  const std::unordered_set<TrackId> ended(tracks.begin(), tracks.end());
  if (ended.empty()) return;
  for (View& view : views_)
    for (auto& track : view.tracks)
      if (track && ended.contains(*track)) track.reset();
}

WindowFrame WindowMatcher::add(const GreyImage& image, const Camera& camera) {
  WindowFrame result;
  Stopwatch watch;
  if (views_.size() == static_cast<std::size_t>(options_.window_frames)) views_.pop_front();
  views_.push_back({matcher_->prepare(image, camera), {}, {}, {}});
  View& newest = views_.back();
  ++frames_;
  result.timings.emplace_back("prepare", watch.lap_ms());

  const int count = static_cast<int>(views_.size());
  const std::uint64_t oldest = frames_ - views_.size();
  for (const auto& [reference, target] : window_pairs(count, count - 1)) {
    PairMatches matches = match(reference, target);
    result.pairs.push_back({oldest + static_cast<std::uint64_t>(reference),
                            oldest + static_cast<std::uint64_t>(target), matches.matches.size(),
                            matches.refusal, matches.timings});
    views_[static_cast<std::size_t>(reference)].to_newer.push_back(std::move(matches));
  }
  result.timings.emplace_back("match", watch.lap_ms());

  std::unordered_set<TrackId> sought;
  for (const View& view : views_)
    for (const auto& track : view.tracks)
      if (track) sought.insert(*track);
  result.before = sought.size();
  const std::vector<Seen> seen = merge(follow(result), result);
  std::vector<Eigen::Vector2d> carried;
  for (const Seen& one : seen) {
    carried.push_back(one.place.pixel);
    newest.tracks.emplace_back(one.track);
    newest.covariances_px2.push_back(one.place.covariance_px2);
    result.observations.push_back(
        {one.track, one.place.pixel, one.place.score, one.place.covariance_px2});
  }
  result.carried = carried.size();
  if (!carried.empty()) newest.view = matcher_->carry(newest.view, carried);
  for (std::size_t i = carried.size(); i < newest.view.points.size(); ++i) {
    newest.tracks.emplace_back(TrackId(next_track_++));
    newest.covariances_px2.emplace_back(Eigen::Matrix2d::Zero());
    result.observations.push_back(
        {*newest.tracks.back(), newest.view.points[i], 1.0F, newest.covariances_px2.back()});
  }
  result.timings.emplace_back("tracks", watch.lap_ms());
  return result;
}

}  // namespace corvid
