#include "corvid/position.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <utility>

namespace corvid {

std::string PositionFix::problem() const {
  const auto& [latitude, longitude, altitude] = position;
  if (!std::isfinite(latitude) || !std::isfinite(longitude) || !std::isfinite(altitude)) {
    return "a coordinate is not a finite number";
  }
  if (std::abs(latitude) > 90) {
    return fmt::format("latitude {} is not from -90 to 90 degrees", latitude);
  }
  if (std::abs(longitude) > 360) {
    return fmt::format("longitude {} is not from -360 to 360 degrees", longitude);
  }
  if (std::abs(altitude) > 1e6) return fmt::format("altitude {} m is not near Earth", altitude);
  const Eigen::Matrix3d& C = covariance_m2;
  if (!C.allFinite() || !C.isApprox(C.transpose(), 1e-6) || C.llt().info() != Eigen::Success) {
    return "the covariance is not symmetric and positive";
  }
  constexpr double kLeastSigma_m = 1e-4, kMostSigma_m = 1e5;
  if (C.diagonal().minCoeff() < kLeastSigma_m * kLeastSigma_m ||
      C.diagonal().maxCoeff() > kMostSigma_m * kMostSigma_m) {
    return fmt::format("a standard deviation is not from {} to {} m", kLeastSigma_m, kMostSigma_m);
  }
  return {};
}

std::string_view to_string(MapScale scale) {
  return scale == MapScale::metric ? "metric" : "arbitrary";
}

Expected<void> PositionFeed::push(const PositionFix& fix) {
  if (std::string problem = fix.problem(); !problem.empty()) {
    return fail(ErrorCode::invalid_argument, std::move(problem),
                fmt::format("position at {} ns", fix.time_ns));
  }
  const std::lock_guard lock(mutex_);
  waiting_.push_back(fix);
  return {};
}

std::vector<PositionFix> PositionFeed::take() {
  const std::lock_guard lock(mutex_);
  return std::exchange(waiting_, {});
}

}  // namespace corvid
