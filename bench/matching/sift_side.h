#pragma once

#include <opencv2/features2d.hpp>
#include <optional>
#include <vector>

#include "bench/matching/pair_side.h"

namespace corvid {

/// OpenCV's SIFT as it is commonly used: default detector and descriptor, the two nearest
/// descriptors by brute force, ratio 0.8 (Lowe, "Distinctive image features from scale-invariant
/// keypoints", 2004, 7.1), F by RANSAC (1 px, confidence 0.999) on undistorted pixels; the matches
/// are its inliers. Brute force: FLANN's trees are faster, but random, and lose matches.
class SiftSide final : public PairSide {
 public:
  /// @param runs  of each piece of work, of which the median time counts; > 0.
  explicit SiftSide(int runs) : runs_(runs), sift_(cv::SIFT::create()) {}
  void start(std::span<const FramePtr> images) override;
  [[nodiscard]] MatchedPair match(int reference, int target) override;

 private:
  struct Features {
    std::vector<cv::KeyPoint> keypoints;
    cv::Mat descriptors;
    double ms = 0;
  };
  const Features& features(int image);

  int runs_;
  cv::Ptr<cv::SIFT> sift_;
  std::vector<FramePtr> images_;
  std::vector<std::optional<Features>> features_;
};

}  // namespace corvid
