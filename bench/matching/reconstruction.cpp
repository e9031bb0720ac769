#include "bench/matching/reconstruction.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <utility>

#include "backend/backend.h"
#include "backend/bundle.h"
#include "backend/triangulate.h"

namespace corvid {
namespace {

constexpr double kSamePoint_px = 1, kMinAngle_rad = 1e-3, kFirstError_px = 20, kLastError_px = 3;

/// A measured point of an image.
struct Node {
  int image = 0;
  Eigen::Vector2d pixel;
};
using Track = std::vector<std::size_t>;  // nodes, ascending by image

struct Tracks {
  std::vector<Node> nodes;
  std::vector<Track> tracks;
  std::vector<int> track_of;  ///< of each node; -1: left out
  /// Of each pair, of each match, its nodes.
  std::vector<std::vector<std::pair<std::size_t, std::size_t>>> ends;
  int conflicts = 0;
};

class Sets {  // union-find
 public:
  std::size_t add() {
    parent_.push_back(parent_.size());
    return parent_.back();
  }
  std::size_t root(std::size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(std::size_t a, std::size_t b) {
    a = root(a);
    b = root(b);
    parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::size_t> parent_;
};

bool conflicts(const std::vector<Node>& nodes, const Track& track) {
  for (std::size_t i = 0; i < track.size(); ++i) {
    for (std::size_t j = i + 1; j < track.size(); ++j) {
      const Node &a = nodes[track[i]], &b = nodes[track[j]];
      if (a.image == b.image && (a.pixel - b.pixel).norm() > kSamePoint_px) return true;
    }
  }
  return false;
}

Tracks chain(std::span<const MatchedPair> pairs, std::size_t images) {
  Tracks out;
  Sets sets;
  std::vector<std::map<int, std::size_t>> named(images);
  const auto node = [&](int image, int name, const Eigen::Vector2d& pixel) {
    const auto [it, added] = named[static_cast<std::size_t>(image)].try_emplace(name, 0);
    if (added) {
      it->second = sets.add();
      out.nodes.push_back({image, pixel});
    }
    return it->second;
  };
  for (const MatchedPair& pair : pairs) {
    auto& ends = out.ends.emplace_back();
    for (const Correspondence& match : pair.matches) {
      ends.emplace_back(node(pair.reference, match.point_r, match.x_r),
                        node(pair.target, match.point_t, match.x_t));
      sets.join(ends.back().first, ends.back().second);
    }
  }
  std::map<std::size_t, Track> by_root;
  for (std::size_t i = 0; i < out.nodes.size(); ++i) by_root[sets.root(i)].push_back(i);
  out.track_of.assign(out.nodes.size(), -1);
  for (auto& [root, track] : by_root) {
    if (conflicts(out.nodes, track)) {
      ++out.conflicts;
      continue;
    }
    std::stable_sort(track.begin(), track.end(), [&](std::size_t a, std::size_t b) {
      return out.nodes[a].image < out.nodes[b].image;
    });
    for (const std::size_t i : track) out.track_of[i] = static_cast<int>(out.tracks.size());
    out.tracks.push_back(std::move(track));
  }
  return out;
}

/// Poses of the images, by position; nothing where there is none.
struct Cameras {
  Camera camera;
  std::vector<std::optional<Pose>> T_world_camera;
};

/// Poses from the tracks alone: every image is a keyframe of the backend; of the parts that it
/// could not join, the one with the most images.
Cameras start_from_tracks(std::span<const FramePtr> images, const Tracks& tracks,
                          IntrinsicsFreedom freedom) {
  std::vector<std::vector<TrackObservation>> observations(images.size());
  for (std::size_t t = 0; t < tracks.tracks.size(); ++t) {
    int last = -1;
    for (const std::size_t i : tracks.tracks[t]) {
      const Node& node = tracks.nodes[i];
      if (node.image == last) continue;
      last = node.image;
      TrackObservation observation;
      observation.track = TrackId(static_cast<std::uint32_t>(t));
      observation.pixel = node.pixel;
      observations[static_cast<std::size_t>(node.image)].push_back(observation);
    }
  }
  BackendOptions options;
  options.intrinsics = freedom == IntrinsicsFreedom::all ? "all" : "fixed";
  Backend backend(options, IntrinsicsOrigin::calibration, 1);
  for (std::size_t i = 0; i < images.size(); ++i) {
    (void)backend.add({images[i], true, std::move(observations[i])});
  }
  backend.finish();
  const auto map = backend.map();
  Cameras cameras{map->camera ? *map->camera : *images[0]->camera,
                  std::vector<std::optional<Pose>>(images.size())};
  std::map<int, int> sizes;
  for (const auto& keyframe : map->keyframes) ++sizes[keyframe->segment];
  const auto largest = std::max_element(
      sizes.begin(), sizes.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  for (const auto& keyframe : map->keyframes) {
    if (keyframe->segment != largest->first) continue;
    const auto image = std::find_if(images.begin(), images.end(), [&](const FramePtr& i) {
      return i->id == keyframe->frame->id;
    });
    cameras.T_world_camera[static_cast<std::size_t>(image - images.begin())] =
        keyframe->T_world_camera;
  }
  return cameras;
}

/// Triangulates all tracks from the cameras and adjusts both; `point_of` names each track's point,
/// or -1.
BundleProblem adjust_tracks(const Tracks& tracks, const Cameras& cameras, double max_error_px,
                            const BundleSettings& settings, std::vector<int>& point_of) {
  BundleProblem problem;
  problem.camera = cameras.camera;
  std::vector<int> pose_of(cameras.T_world_camera.size(), -1);
  for (std::size_t i = 0; i < pose_of.size(); ++i) {
    if (!cameras.T_world_camera[i]) continue;
    pose_of[i] = static_cast<int>(problem.T_world_camera.size());
    problem.T_world_camera.push_back(*cameras.T_world_camera[i]);
  }
  problem.fixed.assign(problem.T_world_camera.size(), 0);
  point_of.assign(tracks.tracks.size(), -1);
  if (problem.T_world_camera.size() < 2) return problem;
  problem.fixed[0] = 1;
  const auto distance = [&](const Pose& T) {
    return (T.translation() - problem.T_world_camera[0].translation()).norm();
  };
  const auto farthest =
      std::max_element(problem.T_world_camera.begin(), problem.T_world_camera.end(),
                       [&](const Pose& a, const Pose& b) { return distance(a) < distance(b); });
  problem.hold_distance = {{0, static_cast<int>(farthest - problem.T_world_camera.begin())}};

  std::vector<RayView> views;
  std::vector<BundleObservation> observations;
  for (std::size_t t = 0; t < tracks.tracks.size(); ++t) {
    views.clear();
    observations.clear();
    for (const std::size_t i : tracks.tracks[t]) {
      const Node& node = tracks.nodes[i];
      const int pose = pose_of[static_cast<std::size_t>(node.image)];
      const auto ray = problem.camera.unproject(node.pixel);
      if (pose < 0 || !ray) continue;
      views.push_back({problem.T_world_camera[static_cast<std::size_t>(pose)], node.pixel, *ray});
      observations.push_back({pose, static_cast<int>(problem.points.size()), node.pixel});
    }
    if (views.size() < 2) continue;
    const Triangulation point = triangulate(problem.camera, views, kMinAngle_rad, max_error_px);
    if (point.status != TriangulationStatus::ok) continue;
    point_of[t] = static_cast<int>(problem.points.size());
    problem.points.push_back(point.p_world);
    problem.observations.insert(problem.observations.end(), observations.begin(),
                                observations.end());
  }
  if (!problem.points.empty()) adjust(problem, settings);
  return problem;
}

}  // namespace

Reconstruction reconstruct(std::span<const FramePtr> images,
                           std::span<const std::optional<Pose>> T_world_camera,
                           std::span<const MatchedPair> pairs, IntrinsicsOrigin origin) {
  Reconstruction out;
  const Tracks tracks = chain(pairs, images.size());
  out.conflicts = tracks.conflicts;
  if (tracks.tracks.empty()) return out;

  BundleSettings settings;
  settings.max_iterations = 100;
  settings.cost_tolerance = 1e-6;
  settings.freedom =
      origin == IntrinsicsOrigin::calibration ? IntrinsicsFreedom::fixed : IntrinsicsFreedom::all;
  settings.intrinsics_prior = adjustable(*images[0]->camera, settings.freedom);

  Cameras cameras;
  if (std::all_of(T_world_camera.begin(), T_world_camera.end(),
                  [](const auto& T) { return T.has_value(); })) {
    cameras = {settings.intrinsics_prior, {T_world_camera.begin(), T_world_camera.end()}};
  } else {
    cameras = start_from_tracks(images, tracks, settings.freedom);
  }

  std::vector<int> point_of;
  BundleProblem problem;
  for (const double max_error_px : {kFirstError_px, kLastError_px}) {
    problem = adjust_tracks(tracks, cameras, max_error_px, settings, point_of);
    cameras.camera = problem.camera;
    auto adjusted = problem.T_world_camera.begin();
    for (auto& T : cameras.T_world_camera) {
      if (T) T = *adjusted++;
    }
  }
  out.images = static_cast<int>(problem.T_world_camera.size());

  // Squared error of each node; over the limit where the point is not in front of the camera.
  const auto squared_error = [&](std::size_t i) {
    const Node& node = tracks.nodes[i];
    const auto t = static_cast<std::size_t>(tracks.track_of[i]);
    const auto& T = cameras.T_world_camera[static_cast<std::size_t>(node.image)];
    const Eigen::Vector3d& p = problem.points[static_cast<std::size_t>(point_of[t])];
    if (!T) return 0.0;  // not an observation of the point
    const Eigen::Vector3d p_camera = T->inverse() * p;
    const auto pixel = p_camera.z() > 0 ? cameras.camera.project(p_camera) : std::nullopt;
    return pixel ? (*pixel - node.pixel).squaredNorm() : 2 * kLastError_px * kLastError_px;
  };
  for (std::size_t t = 0; t < tracks.tracks.size(); ++t) {
    if (point_of[t] < 0) continue;
    const bool good = std::all_of(
        tracks.tracks[t].begin(), tracks.tracks[t].end(),
        [&](std::size_t i) { return squared_error(i) <= kLastError_px * kLastError_px; });
    if (good) {
      ++out.points;
      int last = -1;
      for (const std::size_t i : tracks.tracks[t]) {
        const int image = tracks.nodes[i].image;
        const bool seen = cameras.T_world_camera[static_cast<std::size_t>(image)].has_value();
        if (seen && image != last) ++out.point_images;
        last = image;
      }
    } else {
      point_of[t] = -1;
    }
  }
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const auto posed = [&](int i) {
      return cameras.T_world_camera[static_cast<std::size_t>(i)].has_value();
    };
    if (!posed(pairs[k].reference) || !posed(pairs[k].target)) continue;
    for (const auto& [r, t] : tracks.ends[k]) {
      const int track = tracks.track_of[r];
      if (track < 0 || point_of[static_cast<std::size_t>(track)] < 0) continue;
      out.squared_error_px2 += squared_error(r) + squared_error(t);
      ++out.correspondences;
    }
  }
  return out;
}

}  // namespace corvid
