#include "frontend/disambiguate/matched_mesh.h"

#include <opencv2/core/utility.hpp>

namespace corvid {

MatchedMesh::MatchedMesh(const MatchSets& sets) {
  std::vector<Eigen::Vector2d> x_r, x_t;
  for (std::size_t i = 0; i < sets.points.size(); ++i) {
    const MatchSets::Point& point = sets.points[i];
    if (!point.accepted) continue;
    points.push_back(i);
    x_r.push_back(point.x_r);
    x_t.push_back(point.match());
  }
  cv::parallel_for_(cv::Range(0, 2), [&](const cv::Range& images) {
    for (int image = images.start; image < images.end; ++image)
      (image == 0 ? reference : target) = Delaunay(image == 0 ? x_r : x_t);
  });
}

}  // namespace corvid
