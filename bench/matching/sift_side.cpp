#include "bench/matching/sift_side.h"

#include <opencv2/calib3d.hpp>

#include "frontend/epipolar.h"

namespace corvid {
namespace {

constexpr float kRatio = 0.8F;
constexpr double kMaxDistance_px = 1, kConfidence = 0.999;

Eigen::Vector2d pixel_of(const cv::KeyPoint& keypoint) { return {keypoint.pt.x, keypoint.pt.y}; }

}  // namespace

void SiftSide::start(std::span<const FramePtr> images) {
  images_.assign(images.begin(), images.end());
  features_.assign(images.size(), std::nullopt);
}

const SiftSide::Features& SiftSide::features(int image) {
  const auto i = static_cast<std::size_t>(image);
  if (!features_[i]) {
    Features found;
    const GreyImage& grey = images_[i]->grey;
    // OpenCV has no view of constant pixels; detectAndCompute() reads only.
    const cv::Mat pixels(grey.height(), grey.width(), CV_8U,
                         const_cast<std::uint8_t*>(grey.data()));
    found.ms = median_ms(runs_, [&] {
      sift_->detectAndCompute(pixels, cv::noArray(), found.keypoints, found.descriptors);
    });
    features_[i] = std::move(found);
  }
  return *features_[i];
}

MatchedPair SiftSide::match(int reference, int target) {
  const Features &r = features(reference), &t = features(target);
  const Camera& camera = *images_[static_cast<std::size_t>(reference)]->camera;
  MatchedPair pair{reference, target, {}, 0};
  const double match_ms = median_ms(runs_, [&] {
    pair.matches.clear();
    if (r.keypoints.empty() || t.keypoints.size() < 2) return;
    std::vector<std::vector<cv::DMatch>> nearest;
    cv::BFMatcher(cv::NORM_L2).knnMatch(r.descriptors, t.descriptors, nearest, 2);
    std::vector<Correspondence> matches;
    std::vector<cv::Point2d> x_r, x_t;
    for (const auto& two : nearest) {
      if (two.size() < 2 || !(two[0].distance < kRatio * two[1].distance)) continue;
      const int i = two[0].queryIdx, j = two[0].trainIdx;
      const Correspondence c{i, j, pixel_of(r.keypoints[static_cast<std::size_t>(i)]),
                             pixel_of(t.keypoints[static_cast<std::size_t>(j)])};
      const auto u_r = undistort_pixel(camera, c.x_r), u_t = undistort_pixel(camera, c.x_t);
      if (!u_r || !u_t) continue;
      matches.push_back(c);
      x_r.emplace_back(u_r->x(), u_r->y());
      x_t.emplace_back(u_t->x(), u_t->y());
    }
    if (matches.size() < 8) return;
    std::vector<std::uint8_t> inlier;
    const cv::Mat F =
        cv::findFundamentalMat(x_r, x_t, cv::FM_RANSAC, kMaxDistance_px, kConfidence, inlier);
    if (F.empty()) return;
    for (std::size_t k = 0; k < matches.size(); ++k) {
      if (inlier[k] != 0) pair.matches.push_back(matches[k]);
    }
  });
  pair.ms = r.ms + t.ms + match_ms;
  return pair;
}

}  // namespace corvid
