#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "bench/matching/pair_side.h"
#include "frontend/pair_matcher.h"

namespace corvid {

/// Corvid's pair matching from nothing: no poses, no other pair's geometry. Where earlier images
/// found points in an image, these are looked for again when it becomes the reference, so that
/// matches chain into tracks.
class CorvidSide final : public PairSide {
 public:
  /// @param runs  of each piece of work, of which the median time counts; > 0.
  CorvidSide(PairMatcher& matcher, int runs) : matcher_(matcher), runs_(runs) {}
  void start(std::span<const FramePtr> images) override;
  [[nodiscard]] MatchedPair match(int reference, int target) override;

 private:
  struct View {
    MatchView view;
    double ms = 0;
  };
  struct Image {
    FramePtr frame;
    std::optional<View> as_target, as_reference;
    std::vector<Eigen::Vector2d> carried;  ///< found here from earlier images
    std::vector<int> names;                ///< of the carried points; then, once it is a
                                           ///< reference, of all of its points
    int next_name = 0;
  };
  [[nodiscard]] View prepare(const Image& image, std::span<const Eigen::Vector2d> carried);
  [[nodiscard]] const View& target_view(Image& image);
  [[nodiscard]] const View& reference_view(Image& image);

  PairMatcher& matcher_;
  int runs_;
  std::vector<Image> images_;
};

}  // namespace corvid
