#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>

namespace corvid {

/// An integer name for one kind of thing; ids of different kinds do not mix. Default: invalid.
template <class Tag>
struct Id {
  static constexpr std::uint32_t kInvalid = std::numeric_limits<std::uint32_t>::max();
  std::uint32_t value = kInvalid;

  constexpr Id() = default;
  constexpr explicit Id(std::uint32_t v) : value(v) {}
  [[nodiscard]] constexpr bool valid() const { return value != kInvalid; }
  auto operator<=>(const Id&) const = default;
};

using FrameId = Id<struct FrameTag>;        ///< position in the source, gaps where frames were lost
using TrackId = Id<struct TrackTag>;        ///< one image feature followed over frames
using KeyframeId = Id<struct KeyframeTag>;  ///< counts keyframes from 0
using LandmarkId = Id<struct LandmarkTag>;  ///< equals the TrackId it was triangulated from

}  // namespace corvid

template <class Tag>
struct std::hash<corvid::Id<Tag>> {
  std::size_t operator()(const corvid::Id<Tag>& id) const noexcept {
    return std::hash<std::uint32_t>{}(id.value);
  }
};
