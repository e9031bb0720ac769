#include "bench/matching/tally.h"

#include <algorithm>

#include "bench/matching/epipolar_truth.h"
#include "bench/timing.h"

namespace corvid {

void Tally::add(const Camera& camera, const MatchedPair& pair,
                const std::optional<Eigen::Matrix3d>& F) {
  std::vector<double> distances_px;
  if (F) distances_px = epipolar_distances_px(camera, *F, pair.matches);
  for (Sums* sums : {&all_, pair.target - pair.reference == 1 ? &gap1_ : &gap2_}) {
    sums->matches += static_cast<long>(pair.matches.size());
    sums->ms.push_back(pair.ms);
    sums->distances_px.insert(sums->distances_px.end(), distances_px.begin(), distances_px.end());
  }
}

void Tally::add(const Reconstruction& run) {
  total_.images += run.images;
  total_.points += run.points;
  total_.point_images += run.point_images;
  total_.squared_error_px2 += run.squared_error_px2;
  total_.correspondences += run.correspondences;
}

PairFigures Tally::of(const Sums& sums) {
  PairFigures figures;
  figures.pairs = static_cast<int>(sums.ms.size());
  figures.matches = sums.matches;
  if (figures.pairs > 0) {
    figures.ms = median(sums.ms);
    figures.slowest_ms = *std::max_element(sums.ms.begin(), sums.ms.end());
  }
  if (!sums.distances_px.empty()) {
    figures.truth_px = median(sums.distances_px);
    const auto wrong = std::count_if(sums.distances_px.begin(), sums.distances_px.end(),
                                     [](double d) { return d > kWrong_px; });
    figures.wrong_percent =
        100 * static_cast<double>(wrong) / static_cast<double>(sums.distances_px.size());
  }
  return figures;
}

SideFigures Tally::figures() const {
  SideFigures figures;
  figures.all = of(all_);
  figures.gap1 = of(gap1_);
  figures.gap2 = of(gap2_);
  figures.points = total_.points;
  figures.posed_images = total_.images;
  figures.mse_px2 = total_.mse_px2();
  if (total_.points > 0)
    figures.images_per_point = static_cast<double>(total_.point_images) / total_.points;
  if (all_.matches > 0)
    figures.used_percent = 100.0 * total_.correspondences / static_cast<double>(all_.matches);
  return figures;
}

}  // namespace corvid
