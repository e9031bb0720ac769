#include "mapping/still_depth.h"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include "kernels/depth.h"
#include "mapping/depth_clean.h"
#include "mapping/view_choice.h"
#include "mapping/view_images.h"

namespace corvid {
namespace {

constexpr double kFirstRange = 3;      ///< times nearer and farther than the point looked at
constexpr int kFirstLook = 4;          ///< times coarser, to find the interval
constexpr double kMargin = 1.1;        ///< around what the first look found
constexpr double kMinAnswered = 0.01;  ///< of the rays, below which depth is no depth
constexpr double kMinIsland = 2e-4;    ///< share of the rays
constexpr double kAgree = 0.01;        ///< relative, between depth maps
constexpr int kWitnesses = 8;          ///< views asked whether they agree
constexpr int kRefinements = 2;
constexpr double kMaxScores = 268435456;  ///< of a sweep, for the memory that they take
constexpr std::size_t kImageBudget_bytes = 512UL << 20;

/// Everything that the views share.
struct Stills {
  std::shared_ptr<Device> device;
  std::vector<std::shared_ptr<const Keyframe>> keyframes;
  std::vector<Pose> poses;
  Camera lens;
  StillDepthOptions options;
  DepthSweeper sweeper;
  ViewImages coarse, fine;
  Eigen::Vector3d p_scene = Eigen::Vector3d::Zero();

  std::vector<Neighbour> neighbours(std::size_t i, int count) const {
    ViewChoiceOptions choice;
    choice.neighbours = count;
    return choose_neighbours(poses, lens, i, point_of(i), choice);
  }
  /// With a given interval, the middle of what the view sees.
  Eigen::Vector3d point_of(std::size_t i) const {
    if (!options.interval) return p_scene;
    const double z = 2 / (1 / options.interval->near + 1 / options.interval->far);
    return poses[i] * Eigen::Vector3d(0, 0, z);
  }

  /// Fills map, samples and answered; or refusal.
  void estimate(std::size_t i, const std::vector<Neighbour>& chosen, ViewImages& images,
                StillDepth& out) {
    DepthMap& map = out.map;
    map.camera = images.camera_of(lens);
    std::vector<Pose> T;
    for (const Neighbour& n : chosen) T.push_back(poses[n.index].inverse() * poses[i]);
    // The scores of half the resolution and half the samples, 2 bytes each.
    const double per_sample = 0.125 * map.camera.width_px * map.camera.height_px *
                              static_cast<double>(std::max<std::size_t>(chosen.size(), 1));
    out.samples = std::min(depth_samples(map.camera, T, out.interval),
                           std::max(16, static_cast<int>(kMaxScores / per_sample)));
    if (sweeper.scores_at_once(map.camera.width_px, map.camera.height_px, chosen.size(),
                               out.samples) > DepthSweeper::kMostScores) {
      out.refusal = fmt::format(
          "{} x {} rays with {} neighbours are too many for one sweep: take a larger --scale or "
          "fewer --neighbours",
          map.camera.width_px, map.camera.height_px, chosen.size());
      return;
    }
    const auto reference = images.sweep_image(*keyframes[i], lens, sweeper);
    std::vector<std::shared_ptr<const SweepImage>> held;
    std::vector<SweepNeighbour> views;
    for (std::size_t n = 0; n < chosen.size(); ++n) {
      held.push_back(images.sweep_image(*keyframes[chosen[n].index], lens, sweeper));
      views.push_back({held.back().get(), map.camera, T[n]});
    }
    SweepResult result = sweeper.estimate({reference.get(), map.camera, views, out.interval.near,
                                           out.interval.far, out.samples, true, kRefinements});
    map.depth = std::move(result.depth);
    map.confidence = std::move(result.confidence);
    weaken_ambiguous(map, result.lead);
    const auto rays = static_cast<double>(map.depth.size());
    remove_speckles(map, static_cast<int>(kMinIsland * rays));
    out.answered =
        static_cast<double>(std::count_if(map.depth.data(), map.depth.data() + map.depth.size(),
                                          [](float z) { return z > 0; })) /
        rays;
  }
};

/// The middle 98 % of the answers, and a margin.
DepthInterval interval_of(const FloatImage& depth) {
  std::vector<float> z;
  std::copy_if(depth.data(), depth.data() + depth.size(), std::back_inserter(z),
               [](float d) { return d > 0; });
  std::sort(z.begin(), z.end());
  const std::size_t cut = z.size() / 100;
  return {static_cast<double>(z[cut]) / kMargin,
          static_cast<double>(z[z.size() - 1 - cut]) * kMargin};
}

StillDepth depth_of(Stills& stills, std::size_t i) {
  StillDepth out;
  out.map.keyframe = stills.keyframes[i]->id;
  out.map.T_world_camera = stills.poses[i];
  const auto refuse = [&](std::string reason) {
    out.map.depth = {};
    out.map.confidence = {};
    out.refusal = std::move(reason);
    return out;
  };
  const std::vector<Neighbour> chosen = stills.neighbours(i, stills.options.neighbours);
  out.neighbours = static_cast<int>(chosen.size());
  if (chosen.size() < 2) {
    return refuse(
        "fewer than 2 other views see what it looks at, from an angle of 0.2 to 34 degrees");
  }
  if (stills.options.interval) {
    out.interval = *stills.options.interval;
  } else {
    const double z = (stills.poses[i].inverse() * stills.p_scene).z();
    if (!(z > 0)) return refuse("it looks away from what the others look at");
    out.interval = {z / kFirstRange, z * kFirstRange};
    stills.estimate(i, chosen, stills.coarse, out);
    if (!out.refusal.empty()) return refuse(out.refusal);
    if (out.answered < kMinAnswered) return refuse("no depth that its neighbours agree on");
    out.interval = interval_of(out.map.depth);
  }
  stills.estimate(i, chosen, stills.fine, out);
  if (!out.refusal.empty()) return refuse(out.refusal);
  if (out.answered < kMinAnswered) return refuse("no depth that its neighbours agree on");
  return out;
}

void ask_witnesses(const Stills& stills, std::vector<StillDepth>& depths) {
  for (std::size_t i = 0; i < depths.size(); ++i) {
    std::vector<DepthWitness> witnesses;
    if (!depths[i].refusal.empty()) continue;
    for (const Neighbour& n : stills.neighbours(i, kWitnesses)) {
      if (!depths[n.index].refusal.empty()) continue;
      witnesses.push_back(
          {&depths[n.index].map, stills.poses[n.index].inverse() * stills.poses[i]});
    }
    depths[i].seen_by = count_agreeing(depths[i].map, witnesses, kAgree);
  }
}

Error not_possible(const char* what, const char* hint) {
  return Error{ErrorCode::invalid_argument, what, "the views", hint};
}

}  // namespace

std::optional<Eigen::Vector3d> point_looked_at(std::span<const Pose> T_world_camera) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const Pose& T : T_world_camera) {
    const Eigen::Vector3d axis = T.R().col(2);
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - axis * axis.transpose();
    A += across;
    b += across * T.translation();
  }
  const auto n = static_cast<double>(T_world_camera.size());
  constexpr double kMinSpread = 1e-3;  // mean squared sine of the axes' angles
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(A);
  if (!(n > 0) || !A.allFinite() || !(solver.eigenvalues()(0) > kMinSpread * n))
    return std::nullopt;
  const Eigen::Vector3d p = A.ldlt().solve(b);
  std::size_t in_front = 0;
  for (const Pose& T : T_world_camera) in_front += (T.inverse() * p).z() > 0;
  if (!p.allFinite() || 2 * in_front <= T_world_camera.size()) return std::nullopt;
  return p;
}

Expected<std::vector<StillDepth>> depth_of_stills(
    const std::shared_ptr<Device>& device, std::span<const StillView> views,
    const StillDepthOptions& options, const std::function<bool(std::size_t)>& progress) {
  if (views.size() < 3) {
    return tl::unexpected(
        not_possible("fewer than 3 views have a pose", "depth compares a view with two others"));
  }
  std::vector<std::shared_ptr<const Keyframe>> keyframes;
  std::vector<Pose> poses;
  for (std::size_t i = 0; i < views.size(); ++i) {
    if (!(*views[i].frame->camera == *views[0].frame->camera)) {
      return tl::unexpected(
          not_possible("the views have different cameras", "give views of one camera"));
    }
    auto keyframe = std::make_shared<Keyframe>();
    keyframe->id = KeyframeId(static_cast<std::uint32_t>(i));
    keyframe->frame = std::make_shared<const StoredFrame>(views[i].frame);
    keyframe->T_world_camera = views[i].T_world_camera;
    keyframes.push_back(std::move(keyframe));
    poses.push_back(views[i].T_world_camera);
  }
  const bool one_place = std::all_of(poses.begin(), poses.end(), [&](const Pose& T) {
    return T.translation() == poses[0].translation();
  });
  if (one_place) {
    return tl::unexpected(not_possible("all views are from one place", "depth needs a baseline"));
  }
  const auto p_scene = point_looked_at(poses);
  if (!options.interval && !p_scene) {
    return tl::unexpected(
        not_possible("they do not look at one point, so how far away the scene is cannot be told",
                     "give the nearest and the farthest depth"));
  }
  auto sweeper = DepthSweeper::create(device, {});
  if (!sweeper) return tl::unexpected(sweeper.error());
  auto warper = Warper::create(device), coarse_warper = Warper::create(device);
  if (!warper) return tl::unexpected(warper.error());
  if (!coarse_warper) return tl::unexpected(coarse_warper.error());
  Stills stills{
      device,
      keyframes,
      poses,
      *views[0].frame->camera,
      options,
      std::move(*sweeper),
      ViewImages(device, std::move(*coarse_warper), kFirstLook * options.scale, kImageBudget_bytes),
      ViewImages(device, std::move(*warper), options.scale, kImageBudget_bytes),
      p_scene.value_or(Eigen::Vector3d::Zero())};
  constexpr int kSmallest_px = 16;
  const Camera smallest = stills.coarse.camera_of(stills.lens);
  if (std::min(smallest.width_px, smallest.height_px) < kSmallest_px) {
    return tl::unexpected(
        not_possible("the images are too small for this scale", "take a smaller one"));
  }
  std::vector<StillDepth> depths;
  try {
    for (std::size_t i = 0; i < views.size(); ++i) {
      if (progress && !progress(i)) {
        return tl::unexpected(Error{ErrorCode::interrupted, "stopped", "depth of stills", {}});
      }
      depths.push_back(depth_of(stills, i));
    }
  } catch (const DeviceFault& fault) {
    return fail(ErrorCode::device, fault.what(), device->info().name);
  }
  ask_witnesses(stills, depths);
  return depths;
}

TriangleMesh agreed_points(std::span<const StillView> views, std::span<const StillDepth> depths,
                           int min_views) {
  TriangleMesh cloud;
  for (std::size_t i = 0; i < depths.size(); ++i) {
    const StillDepth& d = depths[i];
    const Frame& frame = *views[i].frame;
    for (int y = 0; y < d.seen_by.height(); ++y) {
      for (int x = 0; x < d.seen_by.width(); ++x) {
        if (d.seen_by(x, y) < min_views) continue;
        const auto ray = d.map.camera.unproject({x, y});
        if (!ray) continue;
        const Eigen::Vector3d p = *ray * (static_cast<double>(d.map.depth(x, y)) / ray->z());
        cloud.vertices.push_back((d.map.T_world_camera * p).cast<float>());
        const auto pixel = frame.camera->project(*ray);
        if (!pixel || !frame.camera->in_image(*pixel)) {
          cloud.colours.push_back({128, 128, 128});
          continue;
        }
        const int u = static_cast<int>(pixel->x() + 0.5), v = static_cast<int>(pixel->y() + 0.5);
        const std::uint8_t grey = frame.grey(u, v);
        cloud.colours.push_back(frame.colour.empty() ? Rgb8{grey, grey, grey} : frame.colour(u, v));
      }
    }
  }
  return cloud;
}

}  // namespace corvid
