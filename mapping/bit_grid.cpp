#include "mapping/bit_grid.h"

#include <algorithm>
#include <bit>

#include "core/check.h"

namespace corvid {

BitGrid::BitGrid(const Eigen::Vector3i& size)
    : size_(size), row_words_((static_cast<std::size_t>(size.x()) + 63) / 64) {
  words_.assign(
      row_words_ * static_cast<std::size_t>(size.y()) * static_cast<std::size_t>(size.z()), 0);
}

bool BitGrid::any_in_block(const Eigen::Vector3i& low) const {
  for (int z = low.z(); z < std::min(low.z() + 8, size_.z()); ++z) {
    for (int y = low.y(); y < std::min(low.y() + 8, size_.y()); ++y) {
      if ((words_[word({low.x(), y, z})] >> (low.x() & 63) & 0xFFU) != 0) return true;
    }
  }
  return false;
}

std::size_t BitGrid::count() const {
  std::size_t n = 0;
  for (const std::uint64_t w : words_) n += static_cast<std::size_t>(std::popcount(w));
  return n;
}

BitGrid& BitGrid::operator|=(const BitGrid& other) {
  CORVID_CHECK(size_ == other.size_, "grids must have one size");
  for (std::size_t i = 0; i < words_.size(); ++i) words_[i] |= other.words_[i];
  return *this;
}

BitGrid BitGrid::spread(int axis) const {
  BitGrid out = *this;
  if (words_.empty()) return out;
  if (axis == 0) {
    const int used = size_.x() & 63;
    const std::uint64_t last = used == 0 ? ~std::uint64_t{0} : (std::uint64_t{1} << used) - 1;
    for (std::size_t row = 0; row < words_.size(); row += row_words_) {
      for (std::size_t i = 0; i < row_words_; ++i) {
        const std::uint64_t w = words_[row + i];
        const std::uint64_t before = i > 0 ? words_[row + i - 1] >> 63 : 0;
        const std::uint64_t after = i + 1 < row_words_ ? words_[row + i + 1] << 63 : 0;
        out.words_[row + i] |= w << 1 | before | w >> 1 | after;
      }
      out.words_[row + row_words_ - 1] &= last;
    }
    return out;
  }
  const std::size_t layer = row_words_ * static_cast<std::size_t>(size_.y());
  const std::size_t step = axis == 1 ? row_words_ : layer;
  const std::size_t run = axis == 1 ? layer : words_.size();  // no neighbours across its ends
  for (std::size_t start = 0; start < words_.size(); start += run) {
    for (std::size_t i = start + step; i < start + run; ++i) {
      out.words_[i] |= words_[i - step];
      out.words_[i - step] |= words_[i];
    }
  }
  return out;
}

BitGrid BitGrid::within_4() const {
  BitGrid cube = spread(0).spread(1).spread(2).spread(0).spread(1).spread(2);
  for (int i = 0; i < 2; ++i) {
    BitGrid octahedron = cube.spread(0);
    octahedron |= cube.spread(1);
    octahedron |= cube.spread(2);
    cube = std::move(octahedron);
  }
  return cube;
}

}  // namespace corvid
