#include "bench/matching/corvid_side.h"

#include <algorithm>
#include <utility>

namespace corvid {
namespace {

// A point found twice, from two earlier images, is carried once.
constexpr double kSamePoint_px = 2;

}  // namespace

void CorvidSide::start(std::span<const FramePtr> images) {
  images_.clear();
  for (const FramePtr& frame : images) images_.emplace_back().frame = frame;
}

CorvidSide::View CorvidSide::prepare(const Image& image, std::span<const Eigen::Vector2d> carried) {
  View prepared;
  prepared.ms = median_ms(runs_, [&] {
    prepared.view = matcher_.prepare(image.frame->grey, *image.frame->camera, carried);
  });
  return prepared;
}

const CorvidSide::View& CorvidSide::target_view(Image& image) {
  if (!image.as_target) image.as_target = prepare(image, {});
  return *image.as_target;
}

const CorvidSide::View& CorvidSide::reference_view(Image& image) {
  if (!image.as_reference) {
    image.as_reference = image.carried.empty() ? target_view(image) : prepare(image, image.carried);
    while (image.names.size() < image.as_reference->view.points.size())
      image.names.push_back(image.next_name++);
  }
  return *image.as_reference;
}

MatchedPair CorvidSide::match(int reference, int target) {
  Image &r = images_[static_cast<std::size_t>(reference)],
        &t = images_[static_cast<std::size_t>(target)];
  const View &reference_v = reference_view(r), &target_v = target_view(t);
  PairMatches found;
  const double match_ms =
      median_ms(runs_, [&] { found = matcher_.match(reference_v.view, target_v.view); });

  MatchedPair pair{reference, target, {}, reference_v.ms + target_v.ms + match_ms};
  const auto carried_before = static_cast<std::ptrdiff_t>(t.carried.size());
  for (const PairMatch& match : found.matches) {
    const int name = t.next_name++;
    pair.matches.push_back({r.names[match.point], name, match.x_r, match.x_t});
    const bool known = std::any_of(
        t.carried.begin(), t.carried.begin() + carried_before,
        [&](const Eigen::Vector2d& x) { return (x - match.x_t).norm() < kSamePoint_px; });
    if (known) continue;
    t.carried.push_back(match.x_t);
    t.names.push_back(name);
  }
  return pair;
}

}  // namespace corvid
