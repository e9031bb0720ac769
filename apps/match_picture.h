#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <string>
#include <string_view>

#include "corvid/image.h"
#include "frontend/pair_matcher.h"

namespace corvid {

/// One reason for a point without a match, as the user meets it.
struct NoMatchKind {
  NoMatch reason;
  std::string_view key, words;
  Rgb8 colour;  ///< in the picture
};
inline constexpr std::array<NoMatchKind, 6> kNoMatchKinds{{
    {NoMatch::no_candidate, "no_candidate", "no candidate", {150, 156, 166}},
    {NoMatch::ambiguous, "ambiguous", "ambiguous", {255, 196, 0}},
    {NoMatch::geometry, "geometry", "against the epipolar geometry", {255, 64, 56}},
    {NoMatch::weak_corner, "weak_corner", "weak corner", {190, 110, 255}},
    {NoMatch::topology, "topology", "against its neighbours", {255, 130, 200}},
    {NoMatch::low_score, "low_score", "lost in the last measurement", {110, 200, 255}},
}};
/// Points without a match by reason, in the order of kNoMatchKinds.
[[nodiscard]] std::array<int, kNoMatchKinds.size()> count_reasons(const PairMatches& pair);

/// How matches are shown (thesis 4.1.1): lines are unambiguous but hide each other when there are
/// thousands; markers of random shape, width and colour, the same on both images, do not.
enum class MatchMarks { markers, lines };

/// One of the two images.
struct MatchSide {
  const GreyImage& image;
  std::string caption;
};

/// Both images beside each other (or one above the other if they are wide), dimmed, with the
/// matches, and, as dots, the points without a match: coloured by reason, in the target the
/// candidates that were left or refused. A legend with the counts lies below. 960 to 2400 px wide;
/// small images are enlarged up to twice. The same input gives the same picture.
/// @param points  of the reference, full resolution [px]: what PairMatches' indices mean.
/// Images must not be empty (CORVID_CHECK).
[[nodiscard]] ColourImage match_picture(const MatchSide& reference, const MatchSide& target,
                                        std::span<const Eigen::Vector2d> points,
                                        const PairMatches& pair, MatchMarks marks);

}  // namespace corvid
