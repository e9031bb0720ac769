#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "corvid/image.h"

namespace corvid {

/// What an image looks like as a whole, in 3 KiB: histograms of gradient orientations (Dalal and
/// Triggs, "Histograms of oriented gradients for human detection", CVPR 2005) of 12 x 8 cells, as
/// square roots less their mean. Needs no training. Does not depend on brightness and contrast.
struct PlaceDescriptor {
  static constexpr int kColumns = 12, kRows = 8, kBins = 8;
  /// [row][column][orientation]; a cell without gradients is all zero.
  std::array<float, static_cast<std::size_t>(kColumns* kRows* kBins)> values{};
};
/// All zero for an empty or even image.
[[nodiscard]] PlaceDescriptor describe_place(const GreyImage& image);

/// How alike two images are, in [-1, 1]: the largest correlation over shifts by up to 3 columns and
/// 2 rows of cells, where two thirds of the cells overlap. 0 where one of them is all zero.
[[nodiscard]] double similarity(const PlaceDescriptor& a, const PlaceDescriptor& b);

/// An entry of PlaceIndex that looks like an image.
struct RankedPlace {
  std::size_t position = 0;
  double similarity = 0;
};

/// Descriptors of keyframes, ranked by similarity. Linear in their number: some 20 us each.
class PlaceIndex {
 public:
  [[nodiscard]] std::size_t size() const { return descriptors_.size(); }
  void add(const PlaceDescriptor& descriptor) { descriptors_.push_back(descriptor); }
  /// The most similar entries, best first, none within `spacing` positions of a better one.
  /// @param usable  one per entry; those with 0 are passed over.
  /// @param yield   called after every 256 entries, some 1.5 ms; may be empty.
  [[nodiscard]] std::vector<RankedPlace> rank(const PlaceDescriptor& query,
                                              const std::vector<std::uint8_t>& usable,
                                              std::size_t count, std::size_t spacing,
                                              const std::function<void()>& yield = {}) const;

 private:
  std::vector<PlaceDescriptor> descriptors_;
};

}  // namespace corvid
