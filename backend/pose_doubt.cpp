#include "backend/pose_doubt.h"

#include <vector>

#include "core/median.h"

namespace corvid {

bool PoseDoubt::add(int segment, const Resection& r, const Pose& step, double max_error_px) {
  constexpr std::size_t kFrames = 40, kLeastFrames = 10;
  constexpr double kTimes = 2, kShareOfLargest = 0.3;
  constexpr int kLeastOdd = 3;
  const double large_px = kShareOfLargest * max_error_px;
  const bool odd =
      residuals_.size() >= kLeastFrames && r.mse_px2 > large_px * large_px &&
      r.mse_px2 > kTimes * upper_median(std::vector<double>(residuals_.begin(), residuals_.end()));
  if (!odd) residuals_.push_back(r.mse_px2);
  if (residuals_.size() > kFrames) residuals_.pop_front();

  Eigen::Vector2d& doubted = doubted_.try_emplace(segment, Eigen::Vector2d::Zero()).first->second;
  if (odd) {
    const Vector6d tangent = step.log();
    const Eigen::Vector2d moved(tangent.head<3>().norm(), tangent.tail<3>().norm());
    recent_ = odd_frames_ == 0 ? moved : Eigen::Vector2d(recent_ + moved);
    ++odd_frames_;
    if (odd_frames_ == kLeastOdd) doubted += recent_;
    if (odd_frames_ > kLeastOdd) doubted += moved;
  } else {
    odd_frames_ = 0;
  }
  // What makes residuals larger than they were is no noise: all observations are worth one.
  covariance_ = odd ? Matrix6d(r.inliers * r.covariance) : Matrix6d::Zero();
  covariance_.diagonal().head<3>().array() += doubted.x() * doubted.x();
  covariance_.diagonal().tail<3>().array() += doubted.y() * doubted.y();
  return odd;
}

void PoseDoubt::start(int segment) {
  jump();
  doubted_[segment] = Eigen::Vector2d::Zero();
}

void PoseDoubt::jump() {
  residuals_.clear();
  odd_frames_ = 0;
}

void PoseDoubt::join(int from, int to, double scale) {
  const auto it = doubted_.find(from);
  if (it == doubted_.end()) return;
  const Eigen::Vector2d moved = Eigen::Vector2d(scale, 1).cwiseProduct(it->second);
  doubted_.erase(it);
  doubted_.try_emplace(to, Eigen::Vector2d::Zero()).first->second += moved;
}

}  // namespace corvid
