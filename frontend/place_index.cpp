#include "frontend/place_index.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "core/check.h"

namespace corvid {
namespace {

constexpr int kColumns = PlaceDescriptor::kColumns, kRows = PlaceDescriptor::kRows,
              kBins = PlaceDescriptor::kBins;
constexpr int kCellPx = 16;              // of the image that is made small first
constexpr float kNoiseGradient = 4;      // [grey levels] that count nothing
constexpr std::size_t kSlice = 256;      // entries between two yields
constexpr int kShiftX = 3, kShiftY = 2;  // [cells]

constexpr std::size_t cell_offset(int row, int column) {
  return static_cast<std::size_t>((row * kColumns + column) * kBins);
}

/// Magnitudes by orientation in one cell, shared between the two nearest of the bins.
std::array<float, kBins> histogram(const cv::Mat& dx, const cv::Mat& dy, int row, int column) {
  std::array<float, kBins> bins{};
  for (int y = row * kCellPx; y < (row + 1) * kCellPx; ++y)
    for (int x = column * kCellPx; x < (column + 1) * kCellPx; ++x) {
      const float gx = dx.at<float>(y, x), gy = dy.at<float>(y, x);
      const float magnitude = std::hypot(gx, gy) - kNoiseGradient;
      if (!(magnitude > 0)) continue;
      constexpr float kTurn = 2 * std::numbers::pi_v<float>;
      const float at = (std::atan2(gy, gx) / kTurn + 1) * kBins;
      const int lower = static_cast<int>(std::floor(at));
      const float share = at - static_cast<float>(lower);
      bins[static_cast<std::size_t>(lower % kBins)] += (1 - share) * magnitude;
      bins[static_cast<std::size_t>((lower + 1) % kBins)] += share * magnitude;
    }
  return bins;
}

}  // namespace

PlaceDescriptor describe_place(const GreyImage& image) {
  PlaceDescriptor place;
  if (image.empty()) return place;
  const cv::Mat whole(image.height(), image.width(), CV_8U,
                      const_cast<std::uint8_t*>(image.data()));  // only read
  cv::Mat small, dx, dy;
  cv::resize(whole, small, {kColumns * kCellPx, kRows * kCellPx}, 0, 0, cv::INTER_AREA);
  small.convertTo(small, CV_32F);
  cv::Sobel(small, dx, CV_32F, 1, 0, 3, 0.25);
  cv::Sobel(small, dy, CV_32F, 0, 1, 3, 0.25);
  for (int row = 0; row < kRows; ++row)
    for (int column = 0; column < kColumns; ++column) {
      std::array<float, kBins> bins = histogram(dx, dy, row, column);
      float sum = 0, mean = 0;
      for (const float b : bins) sum += b;
      if (!(sum > 0)) continue;
      for (float& b : bins) mean += (b = std::sqrt(b / sum)) / kBins;
      // Of an image of noise gradients little is left; a cell full of edges counts in full.
      const float weight = std::min(1.0F, sum / (kCellPx * kCellPx));
      for (std::size_t k = 0; k < kBins; ++k)
        place.values[cell_offset(row, column) + k] = weight * (bins[k] - mean);
    }
  return place;
}

double similarity(const PlaceDescriptor& a, const PlaceDescriptor& b) {
  double best = 0;
  bool any = false;
  for (int sy = -kShiftY; sy <= kShiftY; ++sy)
    for (int sx = -kShiftX; sx <= kShiftX; ++sx) {
      float ab = 0, aa = 0, bb = 0;
      const int width = kColumns - std::abs(sx);
      for (int row = std::max(0, -sy); row < std::min(kRows, kRows - sy); ++row) {
        using Row = Eigen::Map<const Eigen::VectorXf>;
        const Row pa(a.values.data() + cell_offset(row, std::max(0, -sx)), width * kBins);
        const Row pb(b.values.data() + cell_offset(row + sy, std::max(0, sx)), width * kBins);
        ab += pa.dot(pb);
        aa += pa.squaredNorm();
        bb += pb.squaredNorm();
      }
      if (!(aa > 0) || !(bb > 0)) continue;
      const double score = static_cast<double>(ab) / std::sqrt(static_cast<double>(aa) * bb);
      if (!any || score > best) best = score;
      any = true;
    }
  return best;
}

std::vector<RankedPlace> PlaceIndex::rank(const PlaceDescriptor& query,
                                          const std::vector<std::uint8_t>& usable,
                                          std::size_t count, std::size_t spacing,
                                          const std::function<void()>& yield) const {
  CORVID_CHECK(usable.size() == descriptors_.size(), "one flag per entry");
  std::vector<RankedPlace> all;
  for (std::size_t i = 0; i < descriptors_.size(); ++i) {
    if (yield && i > 0 && i % kSlice == 0) yield();
    if (usable[i] != 0) all.push_back({i, similarity(query, descriptors_[i])});
  }
  std::stable_sort(all.begin(), all.end(),
                   [](const auto& a, const auto& b) { return a.similarity > b.similarity; });
  std::vector<RankedPlace> best;
  for (const RankedPlace& place : all) {
    if (best.size() >= count) break;
    const bool near = std::any_of(best.begin(), best.end(), [&](const RankedPlace& other) {
      const std::size_t gap =
          std::max(place.position, other.position) - std::min(place.position, other.position);
      return gap <= spacing;
    });
    if (!near) best.push_back(place);
  }
  return best;
}

}  // namespace corvid
