#include "corvid/options.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <string_view>

namespace corvid {
namespace {

/// Collects the problems of one stage.
class Problems {
 public:
  explicit Problems(std::string_view stage) : stage_(stage) {}

  /// The value must lie in [low, high]. NaN never does.
  template <class T>
  void in(std::string_view field, T value, T low, T high) {
    if (!(value >= low && value <= high)) {
      add(field, fmt::format("must be from {} to {}, not {}", low, high, value));
    }
  }
  template <class T>
  void at_least(std::string_view field, T value, T low) {
    if (!(value >= low) || !std::isfinite(static_cast<double>(value))) {
      add(field, fmt::format("must be at least {}, not {}", low, value));
    }
  }
  void positive(std::string_view field, double value) {
    if (!(value > 0) || !std::isfinite(value)) {
      add(field, fmt::format("must be more than 0, not {}", value));
    }
  }
  void above_one(std::string_view field, double value) {
    if (!(value >= 1) || !std::isfinite(value)) {
      add(field, fmt::format("is a ratio and must be at least 1, not {}", value));
    }
  }
  void template_side(std::string_view field, int value) {
    if (value < 3 || value > 31 || value % 2 == 0) {
      add(field, fmt::format("must be an odd number from 3 to 31, not {}", value));
    }
  }
  void add(std::string_view field, std::string_view text) {
    list_.push_back(stage_.empty() ? fmt::format("{}: {}", field, text)
                                   : fmt::format("{}.{}: {}", stage_, field, text));
  }
  [[nodiscard]] std::vector<std::string> take() { return std::move(list_); }

 private:
  std::string_view stage_;
  std::vector<std::string> list_;
};

bool is_index(std::string_view text) {
  return !text.empty() && text.size() <= 3 && std::all_of(text.begin(), text.end(), [](char c) {
    return std::isdigit(static_cast<unsigned char>(c)) != 0;
  });
}

}  // namespace

std::vector<std::string> FrontendOptions::validate() const {
  Problems p("frontend");
  p.in("max_tracks", max_tracks, 50, 100000);
  p.in("max_still_points", max_still_points, 50, 100000);
  p.in("corner_quality", corner_quality, 0.0, 1.0);
  p.in("harris_kappa", harris_kappa, 0.0, 0.25);  // 0.25: no structure tensor scores above zero
  p.template_side("template_px", template_px);
  p.in("min_score", min_score, 0.01, 1.0);
  p.in("peak_quality", peak_quality, 0.0, 1.0);
  p.above_one("ratio_highest_scores", ratio_highest_scores);
  p.positive("max_epipolar_px", max_epipolar_px);
  p.above_one("corner_score_ratio", corner_score_ratio);
  p.in("keyframe_min_tracked", keyframe_min_tracked, 0.0, 1.0);
  p.in("keyframe_parallax", keyframe_parallax, 0.0, 1.0);
  return p.take();
}

std::vector<std::string> DisambiguationOptions::validate() const {
  Problems p("matching.disambiguation");
  p.positive("max_epipolar_px", max_epipolar_px);
  p.above_one("ratio_highest_scores", ratio_highest_scores);
  p.above_one("ratio_epipolar", ratio_epipolar);
  p.above_one("ratio", ratio);
  p.positive("global_px", global_px);
  p.positive("affine_px", affine_px);
  p.in("topology_neighbours", topology_neighbours, 0, 100);
  p.at_least("min_matches", min_matches, 8);
  return p.take();
}

std::vector<std::string> MatchingOptions::validate() const {
  Problems p("matching");
  p.in("max_points", max_points, 50, 1000000);
  p.in("corner_quality", corner_quality, 0.0, 1.0);
  p.in("harris_kappa", harris_kappa, 0.0, 0.25);
  p.template_side("template_px", template_px);
  p.in("peak_quality", peak_quality, 0.0, 1.0);
  p.in("min_score", min_score, 0.01, 1.0);
  p.template_side("refine_template_px", refine_template_px);
  p.in("refine_min_score", refine_min_score, 0.01, 1.0);
  p.above_one("corner_score_ratio", corner_score_ratio);
  p.in("window_frames", window_frames, 2, 100);
  auto all = p.take();
  for (std::string& problem : disambiguation.validate()) all.push_back(std::move(problem));
  return all;
}

std::vector<std::string> BackendOptions::validate() const {
  Problems p("backend");
  p.in("start_min_parallax_rad", start_min_parallax_rad, 0.0, 1.5);
  p.at_least("start_min_inliers", start_min_inliers, 8);
  p.positive("max_error_px", max_error_px);
  p.in("min_angle_rad", min_angle_rad, 0.0, 1.5);
  p.positive("huber_px", huber_px);
  p.in("window_keyframes", window_keyframes, 2, 1000);
  p.at_least("max_iterations", max_iterations, 1);
  p.in("max_scale_sigma", max_scale_sigma, 1e-6, 1.0);
  p.in("max_position_gap_s", max_position_gap_s, 0.0, 60.0);
  p.at_least("adjustment_views", adjustment_views, 1000);
  p.at_least("min_inliers", min_inliers, 4);  // fewer do not fix a pose
  p.in("loop_max_drift", loop_max_drift, 0.0, 1.0);
  if (intrinsics != "auto" && intrinsics != "fixed" && intrinsics != "distortion" &&
      intrinsics != "all") {
    p.add("intrinsics",
          fmt::format("must be auto, fixed, distortion or all, not \"{}\"", intrinsics));
  }
  return p.take();
}

std::vector<std::string> PlaceOptions::validate() const {
  Problems p("place");
  p.in("candidates", candidates, 1, 20);
  p.in("min_similarity", min_similarity, 0.0, 1.0);
  p.in("min_landmarks", min_landmarks, 12, 1000);
  p.in("min_share", min_share, 0.0, 1.0);
  return p.take();
}

std::vector<std::string> MappingOptions::validate() const {
  Problems p("mapping");
  p.in("neighbours", neighbours, 1, 16);
  p.in("depth_samples", depth_samples, 8, 4096);
  p.in("depth_scale", depth_scale, 0, 16);
  p.template_side("template_px", template_px);
  p.in("min_score", min_score, 0.01, 0.99);
  p.at_least("min_views", min_views, 1);
  if (min_views > neighbours) {
    p.add("min_views",
          fmt::format("must be at most mapping.neighbours ({}), not {}", neighbours, min_views));
  }
  p.at_least("voxel_size", voxel_size, 0.0);
  p.at_least("memory_mb", memory_mb, 1);
  p.at_least("disk_mb", disk_mb, 0);
  p.at_least("stream_bytes_per_s", stream_bytes_per_s, 1.0);
  p.at_least("cut_voxel_size", cut_voxel_size, 0.0);
  p.positive("cut_decay", cut_decay);
  p.in("cut_ballooning", cut_ballooning, 0.0, 1.0);
  p.in("cut_max_mb", cut_max_mb, 1, 1000000);
  return p.take();
}

std::vector<std::string> Options::validate() const {
  std::vector<std::string> all = frontend.validate();
  const auto append = [&all](std::vector<std::string> more) {
    all.insert(all.end(), std::make_move_iterator(more.begin()),
               std::make_move_iterator(more.end()));
  };
  append(matching.validate());
  append(backend.validate());
  append(place.validate());
  append(mapping.validate());
  Problems p("");
  if (device != "auto" && device != "cpu" && device != "gpu" && !is_index(device)) {
    p.add("device", fmt::format("must be auto, cpu, gpu or a device's index, not \"{}\"", device));
  }
  p.in("threads", threads, 0, 1024);
  p.in("keyframe_images_mb", keyframe_images_mb, 1, 1 << 20);
  append(p.take());
  return all;
}

}  // namespace corvid
