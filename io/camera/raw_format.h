#pragma once

#include <cstdint>

namespace corvid {

/// How a format lays a picture out.
enum class RawKind { grey, bayer, yuv422, yuv420, rgb, jpeg };
/// How a grey or Bayer sample is stored.
enum class RawSample { bits8, bits10, bits12, bits14, bits16, packed10, packed12 };

/// What is known of a format. The OpenCV codes are those of the conversion; -1 where there is none.
struct RawFormat {
  std::uint32_t fourcc = 0;
  RawKind kind = RawKind::grey;
  int rank = 0;
  RawSample sample = RawSample::bits8;  ///< grey, bayer
  int to_grey = -1;                     ///< bayer, rgb: conversion; yuv422: the channel of the luma
  int to_rgb = -1;
  int channels = 1;    ///< rgb: bytes of a pixel
  int planes = 1;      ///< yuv420: how many the luma and chroma lie in
  bool split = false;  ///< yuv420: U and V apart
  bool v_first = false;
};

/// Nothing for a format that is not understood.
[[nodiscard]] const RawFormat* find_raw_format(std::uint32_t fourcc);

}  // namespace corvid
