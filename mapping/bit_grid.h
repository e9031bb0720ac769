#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace corvid {

/// One bit per voxel of a box of voxels, rows along x packed into words.
class BitGrid {
 public:
  BitGrid() = default;
  /// @pre size >= 0 in every axis.
  explicit BitGrid(const Eigen::Vector3i& size);

  [[nodiscard]] const Eigen::Vector3i& size() const { return size_; }
  [[nodiscard]] bool contains(const Eigen::Vector3i& p) const {
    return (p.array() >= 0).all() && (p.array() < size_.array()).all();
  }
  /// @pre contains(p), here and below.
  [[nodiscard]] bool test(const Eigen::Vector3i& p) const {
    return (words_[word(p)] >> (p.x() & 63) & 1U) != 0;
  }
  void set(const Eigen::Vector3i& p) { words_[word(p)] |= std::uint64_t{1} << (p.x() & 63); }
  /// Whether any of the 8x8x8 voxels from `low` on is set. @pre low.x() is a multiple of 8.
  [[nodiscard]] bool any_in_block(const Eigen::Vector3i& low) const;
  /// 64 voxels of a row from x = 64 * i on, the lowest bit first; 0 outside of the box.
  [[nodiscard]] std::uint64_t bits(int i, int y, int z) const {
    if (i < 0 || y < 0 || z < 0 || y >= size_.y() || z >= size_.z()) return 0;
    if (static_cast<std::size_t>(i) >= row_words_) return 0;
    return words_[word({64 * i, y, z})];
  }
  [[nodiscard]] std::size_t count() const;
  /// @pre the same size.
  BitGrid& operator|=(const BitGrid& other);

  /// The set voxels and those next to them along one axis.
  [[nodiscard]] BitGrid spread(int axis) const;
  /// All voxels whose distance from a set one is at most 4, and few of those farther away (the
  /// farthest at 4.9): two dilations by a cube and two by an octahedron of radius 1.
  [[nodiscard]] BitGrid within_4() const;

 private:
  [[nodiscard]] std::size_t word(const Eigen::Vector3i& p) const {
    return (static_cast<std::size_t>(p.z()) * static_cast<std::size_t>(size_.y()) +
            static_cast<std::size_t>(p.y())) *
               row_words_ +
           static_cast<std::size_t>(p.x() >> 6);
  }
  Eigen::Vector3i size_ = Eigen::Vector3i::Zero();
  std::size_t row_words_ = 0;
  std::vector<std::uint64_t> words_;
};

}  // namespace corvid
