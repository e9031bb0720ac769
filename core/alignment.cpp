#include "core/alignment.h"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <cmath>
#include <cstddef>

namespace corvid {
namespace {

// The points' second extent over their first, squared, below which they count as a line.
constexpr double kMinSpreadRatio = 1e-12;
// Extent over distance from the origin below which an extent may be rounding.
constexpr double kRounding = 1e-14;

}  // namespace

std::string_view to_string(AlignmentStatus status) {
  switch (status) {
    case AlignmentStatus::ok:
      return "ok";
    case AlignmentStatus::too_few:
      return "fewer than three point pairs";
    case AlignmentStatus::not_finite:
      return "a coordinate is not finite";
    case AlignmentStatus::degenerate:
      return "the points lie on one line or in one place";
  }
  return "unknown";
}

PointAlignment align_points(std::span<const Eigen::Vector3d> source,
                            std::span<const Eigen::Vector3d> target, bool with_scale) {
  PointAlignment result;
  const std::size_t n = source.size();
  if (n < 3 || target.size() != n) return result;

  Eigen::Vector3d source_mean = Eigen::Vector3d::Zero(), target_mean = source_mean;
  for (std::size_t i = 0; i < n; ++i) {
    source_mean += source[i];
    target_mean += target[i];
  }
  source_mean /= static_cast<double>(n);
  target_mean /= static_cast<double>(n);
  if (!source_mean.allFinite() || !target_mean.allFinite()) {
    result.status = AlignmentStatus::not_finite;
    return result;
  }

  Eigen::Matrix3d cross = Eigen::Matrix3d::Zero();
  double source_variance = 0, target_variance = 0;
  for (std::size_t i = 0; i < n; ++i) {
    cross += (target[i] - target_mean) * (source[i] - source_mean).transpose();
    source_variance += (source[i] - source_mean).squaredNorm();
    target_variance += (target[i] - target_mean).squaredNorm();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(cross, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Vector3d d = svd.singularValues();
  const auto spread = [n](double variance, const Eigen::Vector3d& mean) {
    return variance > static_cast<double>(n) * kRounding * kRounding * mean.squaredNorm();
  };
  result.status = AlignmentStatus::degenerate;
  if (!spread(source_variance, source_mean) || !spread(target_variance, target_mean) ||
      !(d[1] > kMinSpreadRatio * d[0])) {
    return result;
  }
  Eigen::Vector3d sign = Eigen::Vector3d::Ones();
  if (svd.matrixU().determinant() * svd.matrixV().determinant() < 0) sign[2] = -1;
  const Eigen::Matrix3d R = svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
  const double scale = with_scale ? d.dot(sign) / source_variance : 1.0;
  if (!(scale > 0) || !std::isfinite(scale)) return result;

  const Sim3 T(scale, Eigen::Quaterniond(R), Eigen::Vector3d::Zero());
  result.T_target_source = Sim3(scale, T.rotation(), target_mean - T * source_mean);
  double squares = 0;
  for (std::size_t i = 0; i < n; ++i) {
    squares += (result.T_target_source * source[i] - target[i]).squaredNorm();
  }
  result.rmse = std::sqrt(squares / static_cast<double>(n));
  result.status = AlignmentStatus::ok;
  return result;
}

}  // namespace corvid
