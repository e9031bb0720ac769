#include "frontend/motion_field.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <nanoflann.hpp>
#include <opencv2/core/utility.hpp>

#include "core/check.h"

namespace corvid {
namespace {

constexpr std::size_t kMostNeighbours = 32;
constexpr std::size_t kAgreementNeighbours = 8;
constexpr double kRidge =
    0.01;  // draws the linear part to the prior, share of the neighbours' reach

struct Cloud {
  const std::vector<Eigen::Vector2d>* points;
  [[nodiscard]] std::size_t kdtree_get_point_count() const { return points->size(); }
  [[nodiscard]] double kdtree_get_pt(std::size_t i, std::size_t axis) const {
    return (*points)[i][static_cast<Eigen::Index>(axis)];
  }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};
using Tree =
    nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Cloud>, Cloud, 2>;

/// The middle one of the first n; they are not reordered.
double middle_of(std::array<double, kMostNeighbours> values, std::size_t n) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(n / 2);
  std::nth_element(values.begin(), middle, values.begin() + static_cast<std::ptrdiff_t>(n));
  return *middle;
}

template <class Work>
void in_parallel(std::size_t count, const Work& work) {
  cv::parallel_for_(
      cv::Range(0, static_cast<int>(count)),
      [&](const cv::Range& range) {
        for (int i = range.start; i < range.end; ++i) work(static_cast<std::size_t>(i));
      },
      static_cast<double>(count) / 256);
}

}  // namespace

struct MotionField::Index {
  std::vector<Eigen::Vector2d> from, to;
  Cloud cloud;
  Tree tree;
  Index(std::span<const Eigen::Vector2d> a, std::span<const Eigen::Vector2d> b)
      : from(a.begin(), a.end()),
        to(b.begin(), b.end()),
        cloud{&from},
        tree(2, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(8)) {}
};

MotionField::MotionField(std::span<const Eigen::Vector2d> from, std::span<const Eigen::Vector2d> to,
                         const Eigen::Matrix2d& prior)
    : prior_(prior) {
  CORVID_CHECK(!from.empty() && from.size() == to.size(), "matches have two ends");
  index_ = std::make_unique<const Index>(from, to);
}

MotionField::MotionField(MotionField&&) noexcept = default;
MotionField& MotionField::operator=(MotionField&&) noexcept = default;
MotionField::~MotionField() = default;

LocalMotion MotionField::at(const Eigen::Vector2d& x, std::size_t neighbours) const {
  const auto& [from, to, cloud, tree] = *index_;
  neighbours = std::clamp<std::size_t>(neighbours, 1, kMostNeighbours);
  std::array<std::uint32_t, kMostNeighbours> id{};
  std::array<double, kMostNeighbours> squared{};
  const std::size_t n = tree.knnSearch(x.data(), neighbours, id.data(), squared.data());

  // Weighted least squares of to = x_t + A (from - x), A drawn to the prior.
  const double scale = std::max(squared[n / 2], 1.0);
  std::array<double, kMostNeighbours> misfit{};
  std::array<Eigen::Vector2d, kMostNeighbours> rest;  // the prior's linear part taken off
  for (std::size_t k = 0; k < n; ++k) rest[k] = to[id[k]] - prior_ * (from[id[k]] - x);
  LocalMotion motion;
  motion.distance_px = std::sqrt(squared[0]);
  // The first weights come from the median displacement, which a quarter of wrong neighbours does
  // not move far.
  motion.linear = prior_;
  for (int axis = 0; axis < 2; ++axis) {
    for (std::size_t k = 0; k < n; ++k) misfit[k] = rest[k][axis];
    motion.x_t[axis] = middle_of(misfit, n);
  }
  for (int round = 0; round < 5; ++round) {
    for (std::size_t k = 0; k < n; ++k)
      misfit[k] = (to[id[k]] - motion.x_t - motion.linear * (from[id[k]] - x)).norm();
    motion.spread_px = middle_of(misfit, n);
    if (round == 4) break;
    const double width = std::max(2 * motion.spread_px, 0.2);
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Matrix<double, 3, 2> right = Eigen::Matrix<double, 3, 2>::Zero();
    double weights = 0;
    for (std::size_t k = 0; k < n; ++k) {
      const double ratio = misfit[k] / width;
      const double w = 1 / ((1 + ratio * ratio) * (1 + squared[k] / scale));
      const Eigen::Vector2d offset = from[id[k]] - x;
      const Eigen::Vector3d row(1, offset.x(), offset.y());
      normal.noalias() += w * row * row.transpose();
      right.noalias() += w * row * rest[k].transpose();
      weights += w;
    }
    const double ridge = kRidge * weights * scale;
    normal(1, 1) += ridge;
    normal(2, 2) += ridge;
    const Eigen::Matrix<double, 3, 2> solution = normal.ldlt().solve(right);
    motion.x_t = solution.row(0).transpose();
    motion.linear = prior_ + solution.bottomRows<2>().transpose();
  }
  return motion;
}

std::vector<LocalMotion> MotionField::at(std::span<const Eigen::Vector2d> x,
                                         std::size_t neighbours) const {
  std::vector<LocalMotion> motions(x.size());
  in_parallel(x.size(), [&](std::size_t i) { motions[i] = at(x[i], neighbours); });
  return motions;
}

std::pair<double, double> MotionField::range_along(const Eigen::Vector2d& x,
                                                   const LocalMotion& motion,
                                                   const Eigen::Vector2d& direction,
                                                   std::size_t neighbours) const {
  std::array<std::uint32_t, kMostNeighbours> id{};
  std::array<double, kMostNeighbours> squared{};
  const std::size_t n = index_->tree.knnSearch(
      x.data(), std::clamp<std::size_t>(neighbours, 1, kMostNeighbours), id.data(), squared.data());
  double least = 0, most = 0;
  for (std::size_t k = 0; k < n; ++k) {
    const Eigen::Vector2d there =
        index_->to[id[k]] + motion.linear * (x - index_->from[id[k]]) - motion.x_t;
    least = std::min(least, direction.dot(there));
    most = std::max(most, direction.dot(there));
  }
  return {least, most};
}

std::vector<int> MotionField::agreement(double share, double slack_px) const {
  const auto& from = index_->from;
  const auto& to = index_->to;
  std::vector<int> agreeing(from.size(), 0);
  in_parallel(from.size(), [&](std::size_t i) {
    std::array<std::uint32_t, kAgreementNeighbours + 1> id{};
    std::array<double, kAgreementNeighbours + 1> squared{};
    const std::size_t n =
        index_->tree.knnSearch(from[i].data(), id.size(), id.data(), squared.data());
    for (std::size_t k = 0; k < n; ++k) {
      if (id[k] == i) continue;
      const Eigen::Vector2d offset = from[id[k]] - from[i];
      const double misfit = (to[id[k]] - to[i] - prior_ * offset).norm();
      agreeing[i] += misfit < share * offset.norm() + slack_px;
    }
  });
  return agreeing;
}

}  // namespace corvid
