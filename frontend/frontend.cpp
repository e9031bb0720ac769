#include "frontend/frontend.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <unordered_set>

#include "core/log.h"
#include "core/median.h"
#include "frontend/disambiguate/epipolar_constraint.h"
#include "frontend/disambiguate/highest_scores.h"
#include "frontend/disambiguate/unique.h"
#include "frontend/disambiguate/weak_corners.h"
#include "frontend/epipolar.h"
#include "frontend/merge.h"
#include "frontend/predict.h"
#include "frontend/spread_corners.h"

namespace corvid {
namespace {

constexpr int kMaxLevels = 6;
constexpr int kMinLevelSidePx = 40;
constexpr int kMaxMisses = 15;  // frames without a match until all tracks are given up
constexpr int kMinFound = 8;    // fewer found tracks: the frame is a miss
constexpr double kMinFoundShare = 0.1;
constexpr std::size_t kNeighbours = 7;  // whose motion says where a track went
// Windows around predictions, in shares of the width: errors of constant velocity are about 1.5 px
// of 752 in the median and 3.5 px at 95 %; neighbours at another depth are further off.
constexpr double kKnownRadius = 6.0 / 752, kNeighbourRadius = 10.0 / 752;
constexpr SearchSchedule kCoarseToFine{2, 4, 3};

int level_count(int width_px, int height_px) {
  int levels = 1;
  while (levels < kMaxLevels && (std::min(width_px, height_px) >> levels) >= kMinLevelSidePx)
    ++levels;
  return levels;
}

/// Indices of the `k` points nearest to `x`, in no order that means anything.
std::vector<std::size_t> nearest(const std::vector<Eigen::Vector2d>& points,
                                 const Eigen::Vector2d& x, std::size_t k) {
  std::vector<std::pair<double, std::size_t>> order(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) order[i] = {(points[i] - x).squaredNorm(), i};
  k = std::min(k, points.size());
  std::nth_element(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(k), order.end());
  std::vector<std::size_t> indices;
  for (std::size_t i = 0; i < k; ++i) indices.push_back(order[i].second);
  return indices;
}

std::ptrdiff_t count_found(const std::vector<SearchCandidate>& found) {
  return std::count_if(found.begin(), found.end(), [](const auto& f) { return f.score > 0; });
}

/// Component-wise median displacement of the points nearest to `x`.
Eigen::Vector2d neighbour_motion(const std::vector<Eigen::Vector2d>& points,
                                 const std::vector<Eigen::Vector2d>& displacements,
                                 const Eigen::Vector2d& x) {
  std::vector<double> dx, dy;
  for (std::size_t i : nearest(points, x, kNeighbours)) {
    dx.push_back(displacements[i].x());
    dy.push_back(displacements[i].y());
  }
  return {upper_median(std::move(dx)), upper_median(std::move(dy))};
}

}  // namespace

Expected<std::unique_ptr<Frontend>> Frontend::create(std::shared_ptr<Device> device,
                                                     const FrontendOptions& options, bool stills,
                                                     const MatchingOptions& matching) {
  auto pyramids = PyramidBuilder::create(device);
  if (!pyramids) return tl::unexpected(pyramids.error());
  auto corners = CornerDetector::create(device);
  if (!corners) return tl::unexpected(corners.error());
  auto matcher = NccMatcher::create(device);
  if (!matcher) return tl::unexpected(matcher.error());
  NccOptions ncc_options;
  ncc_options.template_px = options.template_px;
  if (const auto ready = matcher->prepare(ncc_options); !ready)
    return tl::unexpected(ready.error());
  std::unique_ptr<Frontend> frontend(
      new Frontend(options, std::move(*pyramids), std::move(*corners), std::move(*matcher)));
  if (stills) {
    MatchingOptions of_stills = matching;
    of_stills.max_points = options.max_still_points;
    auto window = WindowMatcher::create(device, of_stills);
    if (!window) return tl::unexpected(window.error());
    frontend->window_ = std::move(*window);
  } else {
    auto pairs = PairMatcher::create(device, matching);
    if (!pairs) return tl::unexpected(pairs.error());
    frontend->pairs_ = std::move(*pairs);
  }
  return frontend;
}

Frontend::Frontend(const FrontendOptions& options, PyramidBuilder pyramids, CornerDetector corners,
                   NccMatcher matcher)
    : options_(options),
      pyramids_(std::move(pyramids)),
      corners_(std::move(corners)),
      matcher_(std::move(matcher)),
      search_(matcher_, options.template_px, options.peak_quality) {}

FrameTracks Frontend::process(const FramePtr& frame, const MotionState* motion) {
  counts_ = {};
  timings_.clear();
  if (window_) return process_still(frame, motion);
  Stopwatch watch;
  ++frame_count_;
  const int width = frame->grey.width(), height = frame->grey.height();
  auto anchor = std::make_shared<Anchor>();
  anchor->pyramid = pyramids_.build(frame->grey, level_count(width, height), Lane::tracking);
  anchor->frame = frame->id;
  current_ = anchor;
  timings_.emplace_back("frontend/pyramid", watch.lap_ms());

  if (motion && !motion->rejected.empty()) {
    const std::unordered_set<TrackId> rejected(motion->rejected.begin(), motion->rejected.end());
    std::erase_if(tracks_, [&](const Track& track) { return rejected.contains(track.id); });
  }
  counts_.before = static_cast<int>(tracks_.size());

  FrameTracks result;
  result.frame = frame;
  std::vector<SearchCandidate> found;
  if (!tracks_.empty()) {
    const auto enough = [&] {
      const auto n = count_found(found);
      return n >= kMinFound && static_cast<double>(n) >= kMinFoundShare * counts_.before;
    };
    found = search(*frame, motion);
    counts_.found = static_cast<int>(count_found(found));
    timings_.emplace_back("frontend/search", watch.lap_ms());
    recover(*frame->camera, found);
    // Nothing is where it was: a jump of the camera, or frames that were lost.
    if (!enough() && misses_ % 5 == 0) rematch(*frame, found);
    timings_.emplace_back("frontend/recover", watch.lap_ms());
    reject_outliers(*frame->camera, found);
    timings_.emplace_back("frontend/epipolar", watch.lap_ms());

    if (!enough()) {
      // Keep the tracks for a while: the view may come back (a hand before the lens, a dark frame).
      if (++misses_ <= kMaxMisses) return result;
      reset();
    } else {
      const double gap = misses_ + 1;  // frames since the tracks were seen
      misses_ = 0;
      std::vector<Track> alive;
      alive.reserve(tracks_.size());
      for (std::size_t i = 0; i < tracks_.size(); ++i) {
        if (found[i].score <= 0) continue;
        Track& track = tracks_[i];
        track.velocity_px = (found[i].pixel - track.pixel) / gap;
        track.found_before = true;
        track.pixel = found[i].pixel;
        // An error of the template's place moves the match by as much.
        const Eigen::Matrix2d to_here = track.warp.inverse();
        track.covariance_px2 =
            found[i].covariance_px2 + to_here * track.anchor_covariance_px2 * to_here.transpose();
        result.observations.push_back(
            {track.id, track.pixel, found[i].score, track.covariance_px2});
        alive.push_back(std::move(track));
      }
      tracks_ = std::move(alive);
    }
  }

  result.keyframe = keyframe_due(*frame->camera);
  if (result.keyframe) {
    anchor->keyframe = true;
    merge(result.observations);
    const std::size_t before = tracks_.size();
    make_keyframe(*frame);
    for (std::size_t i = before; i < tracks_.size(); ++i)
      result.observations.push_back(
          {tracks_[i].id, tracks_[i].pixel, 1.0F, tracks_[i].covariance_px2});
    timings_.emplace_back("frontend/corners", watch.lap_ms());
  }
  previous_ = current_;
  previous_frame_ = frame;
  return result;
}

FrameTracks Frontend::process_still(const FramePtr& frame, const MotionState* motion) {
  if (motion) window_->end(motion->rejected);
  WindowFrame seen = window_->add(frame->grey, *frame->camera);
  counts_.before = static_cast<int>(seen.before);
  counts_.found = static_cast<int>(seen.carried);
  counts_.merged = static_cast<int>(seen.merged);
  counts_.added = static_cast<int>(seen.observations.size() - seen.carried);
  for (const auto& [step, ms] : seen.timings) timings_.emplace_back("frontend/" + step, ms);
  for (const WindowPair& pair : seen.pairs)
    if (!pair.refusal.empty())
      corvid::log().debug("frames {} and {} have no matches: {}", pair.reference, pair.target,
                          pair.refusal);
  return {frame, true, std::move(seen.observations)};
}

std::optional<SearchQuery> Frontend::predict(const Track& track, const Camera& camera,
                                             const MotionState& motion,
                                             const Pose& T_world_camera) {
  const Eigen::Vector3d* const p_world = find_landmark(motion, track.id);
  if (!p_world) return std::nullopt;
  const auto pixel = camera.project(T_world_camera.inverse() * *p_world);
  if (!pixel) return std::nullopt;
  SearchQuery query{track.anchor->pyramid, track.anchor_px, track.warp, *pixel};
  if (const Pose* T_world_anchor = find_keyframe(motion, track.anchor->frame))
    if (const auto warp = predict_warp(camera, *T_world_anchor, T_world_camera, *p_world))
      query.warp = *warp;
  return query;
}

std::vector<SearchCandidate> Frontend::search(const Frame& frame, const MotionState* motion) {
  const double width_px = frame.grey.width();
  const auto window = [&](double share) {
    const int radius_px = std::max(4, static_cast<int>(std::lround(share * width_px)));
    return SearchSchedule{0, radius_px, radius_px};
  };
  std::vector<SearchCandidate> found(tracks_.size());
  const auto look = [&](std::span<const SearchQuery> queries, std::span<const std::size_t> slots,
                        const SearchSchedule& schedule) {
    const auto matches = search_.track(*current_->pyramid, queries, schedule);
    for (std::size_t k = 0; k < slots.size(); ++k) {
      tracks_[slots[k]].warp = queries[k].warp;
      if (matches[k].score >= options_.min_score) found[slots[k]] = matches[k];
    }
  };

  // First those of which the backend knows where they are; then the others where their neighbours
  // went.
  std::vector<std::size_t> known, others;
  std::vector<SearchQuery> queries, other_queries;
  const Camera& camera = motion && motion->camera ? *motion->camera : *frame.camera;
  const auto T_world_camera = motion ? predict_pose(*motion, frame.time_ns) : std::nullopt;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    auto query = T_world_camera ? predict(tracks_[i], camera, *motion, *T_world_camera)
                                : std::optional<SearchQuery>();
    if (query) {
      known.push_back(i);
      queries.push_back(std::move(*query));
    } else {
      others.push_back(i);
    }
  }
  if (known.size() >= kNeighbours) look(queries, known, window(kKnownRadius));
  std::vector<Eigen::Vector2d> at, moved, changed;
  for (const std::size_t i : known)
    if (found[i].score > 0) {
      at.push_back(tracks_[i].pixel);
      moved.push_back(found[i].pixel - tracks_[i].pixel);
      changed.push_back(moved.back() - tracks_[i].velocity_px);
    }
  const bool guided = at.size() >= kNeighbours && 2 * at.size() >= known.size();
  if (!guided) {  // no map yet, or not where it was predicted: everything coarse to fine
    others.resize(tracks_.size());
    std::iota(others.begin(), others.end(), std::size_t{0});
  }
  for (const std::size_t i : others) {
    const Track& track = tracks_[i];
    Eigen::Vector2d motion_px = misses_ == 0 ? track.velocity_px : Eigen::Vector2d::Zero();
    if (guided && misses_ == 0 && track.found_before)
      motion_px += neighbour_motion(at, changed, track.pixel);
    else if (guided)
      motion_px = neighbour_motion(at, moved, track.pixel);
    other_queries.push_back(
        {track.anchor->pyramid, track.anchor_px, track.warp, track.pixel + motion_px});
  }
  look(other_queries, others, guided ? window(kNeighbourRadius) : kCoarseToFine);
  return found;
}

void Frontend::recover(const Camera& camera, std::vector<SearchCandidate>& found) {
  std::vector<std::size_t> missing;
  std::vector<Eigen::Vector2d> at, moved;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (found[i].score > 0) {
      at.push_back(tracks_[i].pixel);
      moved.push_back(found[i].pixel - tracks_[i].pixel);
    } else {
      missing.push_back(i);
    }
  }
  if (missing.empty()) return;
  // Templates from the last frame in which the tracks were seen: it looks most like this one.
  std::vector<SearchQuery> queries;
  for (std::size_t i : missing) {
    SearchQuery query{previous_->pyramid, tracks_[i].pixel, Eigen::Matrix2d::Identity(),
                      tracks_[i].pixel};
    if (at.size() >= kNeighbours)
      query.predicted_px += neighbour_motion(at, moved, tracks_[i].pixel);
    queries.push_back(query);
  }
  const bool bounded = at.size() >= kNeighbours && at.size() >= tracks_.size() / 2;
  const int level = bounded ? 0 : std::min(3, current_->pyramid->levels() - 1);
  const int radius = bounded ? 15 : 8;
  auto candidates = search_.candidates(*current_->pyramid, queries, level, radius);
  std::vector<Eigen::Vector2d> anchors;
  for (const SearchQuery& query : queries) anchors.push_back(query.anchor_px);
  (void)take_weak_corners(corners_, previous_->pyramid->level(level),
                          current_->pyramid->level(level), level, anchors, options_.harris_kappa,
                          options_.corner_score_ratio, candidates, Lane::tracking);

  MatchSets sets;
  for (std::size_t k = 0; k < missing.size(); ++k) {
    MatchSets::Point point;
    const auto x_r = undistort_pixel(camera, tracks_[missing[k]].pixel);
    point.x_r = x_r ? *x_r : tracks_[missing[k]].pixel;
    if (x_r)
      for (const SearchCandidate& candidate : candidates[k])
        if (const auto x_t = undistort_pixel(camera, candidate.pixel)) {
          point.candidates.push_back(candidate);
          point.x_t.push_back(*x_t);
        }
    sets.points.push_back(std::move(point));
  }
  accept_unique(sets);
  accept_highest_scores(sets, options_.ratio_highest_scores);
  std::vector<Eigen::Vector2d> x_r, x_t;
  for (const auto& point : sets.points)
    if (point.accepted) {
      x_r.push_back(point.x_r);
      x_t.push_back(point.x_t[*point.accepted]);
    }
  // Positions are good to about half a pixel of the level.
  const double tolerance_px = std::max(options_.max_epipolar_px, std::ldexp(0.75, level));
  if (const auto geometry =
          estimate_fundamental(x_r, x_t, tolerance_px, options_.seed + frame_count_);
      geometry && geometry->inliers >= 16) {
    reject_epipolar_outliers(sets, geometry->F, tolerance_px);
    accept_epipolar(sets, geometry->F, 10.0, tolerance_px);
  }

  std::vector<SearchQuery> refined;
  std::vector<std::size_t> slots;
  for (std::size_t k = 0; k < missing.size(); ++k)
    if (sets.points[k].accepted) {
      refined.push_back(queries[k]);
      refined.back().predicted_px = sets.points[k].candidates[*sets.points[k].accepted].pixel;
      slots.push_back(missing[k]);
    }
  const auto matches = search_.track(*current_->pyramid, refined, {std::max(0, level - 1), 3, 3});
  for (std::size_t k = 0; k < slots.size(); ++k) {
    if (accept_recovered(tracks_[slots[k]], refined[k], matches[k])) found[slots[k]] = matches[k];
  }
}

bool Frontend::accept_recovered(Track& track, const SearchQuery& query,
                                const SearchCandidate& match) {
  if (match.score < options_.min_score) return false;
  track.anchor = previous_;
  track.anchor_px = track.pixel;
  track.anchor_covariance_px2 = track.covariance_px2;
  track.warp = query.warp;
  ++counts_.recovered;
  return true;
}

void Frontend::rematch(const Frame& frame, std::vector<SearchCandidate>& found) {
  std::vector<Eigen::Vector2d> carried;
  for (const Track& track : tracks_) carried.push_back(track.pixel);
  const MatchView reference =
      pairs_->prepare(previous_frame_->grey, *previous_frame_->camera, carried);
  const PairMatches matches = pairs_->match(reference, pairs_->prepare(frame.grey, *frame.camera));
  found.assign(tracks_.size(), {});
  for (const PairMatch& match : matches.matches) {
    if (match.point >= tracks_.size()) break;  // a corner
    const SearchQuery query{previous_->pyramid, match.x_r, match.warp, match.x_t};
    const SearchCandidate candidate{match.x_t, match.score, match.covariance_px2};
    if (accept_recovered(tracks_[match.point], query, candidate)) found[match.point] = candidate;
  }
}

void Frontend::reject_outliers(const Camera& camera, std::vector<SearchCandidate>& found) {
  std::vector<Eigen::Vector2d> x_r, x_t;
  std::vector<std::size_t> slots;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (found[i].score <= 0) continue;
    const auto x = undistort_pixel(camera, found[i].pixel);
    if (!x || !camera.in_image(found[i].pixel)) {
      found[i] = {};
      continue;
    }
    x_r.push_back(tracks_[i].keyframe_px);
    x_t.push_back(*x);
    slots.push_back(i);
  }
  const auto geometry =
      estimate_fundamental(x_r, x_t, options_.max_epipolar_px, options_.seed + frame_count_);
  if (!geometry) return;
  for (std::size_t k = 0; k < slots.size(); ++k)
    if (!geometry->inlier[k]) {
      found[slots[k]] = {};
      ++counts_.epipolar_outliers;
    }
}

void Frontend::merge(std::vector<TrackObservation>& observations) {
  constexpr double kSameFeaturePx = 1.5;
  std::vector<Eigen::Vector2d> pixels, velocities_px;
  for (const Track& track : tracks_) {
    pixels.push_back(track.pixel);
    velocities_px.push_back(track.velocity_px);
  }
  std::unordered_set<TrackId> ended;
  for (const std::size_t i : find_duplicates(pixels, velocities_px, kSameFeaturePx))
    ended.insert(tracks_[i].id);
  std::erase_if(tracks_, [&](const Track& track) { return ended.contains(track.id); });
  std::erase_if(observations, [&](const auto& o) { return ended.contains(o.track); });
  counts_.merged = static_cast<int>(ended.size());
}

bool Frontend::keyframe_due(const Camera& camera) const {
  if (keyframe_tracks_ == 0 || tracks_.size() < 8) return true;
  if (static_cast<double>(tracks_.size()) <
      options_.keyframe_min_tracked * static_cast<double>(keyframe_tracks_))
    return true;
  std::vector<double> motion_px;
  for (const Track& track : tracks_)
    if (const auto x = undistort_pixel(camera, track.pixel))
      motion_px.push_back((*x - track.keyframe_px).norm());
  return !motion_px.empty() &&
         upper_median(std::move(motion_px)) > options_.keyframe_parallax * camera.width_px;
}

void Frontend::make_keyframe(const Frame& frame) {
  const DeviceImage& image = current_->pyramid->level(0);
  std::vector<Eigen::Vector2f> occupied;
  for (const Track& track : tracks_) occupied.push_back(track.pixel.cast<float>());
  CornerOptions corner_options =
      spread_corners(image, options_.max_tracks, options_.template_px, occupied);
  corner_options.quality = options_.corner_quality;
  corner_options.kappa = options_.harris_kappa;
  const auto corners = corners_.detect(image, corner_options);

  for (Track& track : tracks_) {
    const double scale = std::sqrt(std::abs(track.warp.determinant()));
    if (!track.anchor->keyframe || scale > 1.5 || scale < 0.67 ||
        current_->frame.value - track.anchor->frame.value > 200) {
      track.anchor = current_;
      track.anchor_px = track.pixel;
      track.anchor_covariance_px2 = track.covariance_px2;
      track.warp = Eigen::Matrix2d::Identity();
    }
    if (const auto x = undistort_pixel(*frame.camera, track.pixel)) track.keyframe_px = *x;
  }
  for (const Corner& corner : corners) {
    Track track;
    track.pixel = Eigen::Vector2d(corner.x_px, corner.y_px);
    const auto x = undistort_pixel(*frame.camera, track.pixel);
    if (!x) continue;
    track.id = TrackId(next_track_++);
    track.velocity_px = Eigen::Vector2d::Zero();
    track.keyframe_px = *x;
    track.anchor = current_;
    track.anchor_px = track.pixel;
    tracks_.push_back(std::move(track));
    ++counts_.added;
  }
  keyframe_tracks_ = tracks_.size();
}

void Frontend::reset() {
  tracks_.clear();
  keyframe_tracks_ = 0;
  misses_ = 0;
}

}  // namespace corvid
