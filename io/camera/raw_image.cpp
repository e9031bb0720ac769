#include "io/camera/raw_image.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string_view>
#include <utility>

#include "io/camera/raw_format.h"
#include "io/camera/upper_bits.h"
#include "io/jpeg_header.h"

namespace corvid {
namespace {

/// The picture that is being converted.
struct Raw {
  const RawFormat& format;
  int width_px, height_px;
  std::span<const RawPlane> planes;
  bool colour;
};

tl::unexpected<Error> corrupt(const Raw& raw, std::string what) {
  return fail(ErrorCode::corrupt, std::move(what),
              fmt::format("{} picture of {} x {} pixels", fourcc_name(raw.format.fourcc),
                          raw.width_px, raw.height_px));
}

/// Rows of a plane: `type` elements from byte `offset` on.
Expected<cv::Mat> rows_of(const Raw& raw, const RawPlane& plane, std::size_t offset,
                          std::size_t stride, int rows, int cols, int type) {
  const std::size_t row = static_cast<std::size_t>(cols) * CV_ELEM_SIZE(type);
  if (stride < row) {
    return corrupt(raw, fmt::format("rows lie {} bytes apart but have {} bytes", stride, row));
  }
  if (rows > 1 && stride > plane.bytes.size()) {
    return corrupt(raw, fmt::format("rows lie {} bytes apart but only {} bytes came", stride,
                                    plane.bytes.size()));
  }
  const std::size_t needed = offset + stride * static_cast<std::size_t>(rows - 1) + row;
  if (plane.bytes.size() < needed) {
    return corrupt(raw, fmt::format("{} bytes came, {} are needed", plane.bytes.size(), needed));
  }
  // OpenCV has no view of constant data; nothing below writes into it.
  auto* data = const_cast<std::uint8_t*>(plane.bytes.data() + offset);
  return cv::Mat(rows, cols, type, data, stride);
}

cv::Mat view(GreyImage& image) { return {image.height(), image.width(), CV_8UC1, image.data()}; }

cv::Mat view(ColourImage& image) {
  static_assert(sizeof(Rgb8) == 3);
  return {image.height(), image.width(), CV_8UC3, image.data()};
}

struct Converted {
  GreyImage grey;
  ColourImage colour;
};

/// Empty images of the right size.
Converted blank(const Raw& raw, bool colour) {
  Converted result;
  result.grey = GreyImage(raw.width_px, raw.height_px);
  if (colour) result.colour = ColourImage(raw.width_px, raw.height_px);
  return result;
}

/// MIPI CSI-2's packing: kGroup samples' upper 8 bits, then one byte of all their lower bits.
template <int kGroup>
void take_packed(const cv::Mat& bytes, cv::Mat& out) {
  const int whole = out.cols / kGroup * kGroup;
  for (int y = 0; y < out.rows; ++y) {
    const std::uint8_t* in = bytes.ptr(y);
    std::uint8_t* to = out.ptr(y);
    for (int x = 0; x < whole; x += kGroup, in += kGroup + 1) std::copy_n(in, kGroup, to + x);
    std::copy_n(in, out.cols - whole, to + whole);
  }
}

/// The samples as 8-bit ones, one per pixel.
Expected<GreyImage> samples_of(const Raw& raw) {
  const RawPlane& plane = raw.planes[0];
  const auto rows = [&](int cols, int type) {
    return rows_of(raw, plane, 0, plane.stride_bytes, raw.height_px, cols, type);
  };
  const int w = raw.width_px;
  GreyImage result;
  const auto with = [&](Expected<cv::Mat> in, const auto& take) -> Expected<GreyImage> {
    if (!in) return tl::unexpected(in.error());
    result = GreyImage(w, raw.height_px);
    cv::Mat out = view(result);
    take(*in, out);
    return std::move(result);
  };
  const auto words = [&](int bits) {
    return with(rows(w, CV_8UC2), [&](const cv::Mat& in, cv::Mat& out) {
      for (int y = 0; y < out.rows; ++y) {
        take_upper_bits(in.ptr(y), static_cast<std::size_t>(w), bits, out.ptr(y));
      }
    });
  };
  const auto packed = [&](int group, const auto& take) {
    return with(rows((w + group - 1) / group * (group + 1), CV_8UC1), take);
  };
  switch (raw.format.sample) {
    case RawSample::bits10:
      return words(10);
    case RawSample::bits12:
      return words(12);
    case RawSample::bits14:
      return words(14);
    case RawSample::bits16:
      return words(16);
    case RawSample::packed10:
      return packed(4, take_packed<4>);
    case RawSample::packed12:
      return packed(2, take_packed<2>);
    case RawSample::bits8:
      break;
  }
  return with(rows(w, CV_8UC1), [](const cv::Mat& in, cv::Mat& out) { in.copyTo(out); });
}

Expected<Converted> convert_grey(const Raw& raw) {
  Expected<GreyImage> samples = samples_of(raw);
  if (!samples) return tl::unexpected(samples.error());
  return Converted{.grey = std::move(*samples), .colour = {}};
}

Expected<Converted> convert_bayer(const Raw& raw) {
  Expected<GreyImage> samples = samples_of(raw);
  if (!samples) return tl::unexpected(samples.error());
  // Reflected by an even number of pixels, which keeps the order of the colours: OpenCV gives no
  // values at the border, and none at all for pictures below 3 pixels.
  cv::Mat padded;
  cv::copyMakeBorder(view(*samples), padded, 2, 2, 2, 2, cv::BORDER_REFLECT_101);
  const cv::Rect inside(2, 2, raw.width_px, raw.height_px);
  Converted result = blank(raw, raw.colour);
  cv::Mat all;
  cv::cvtColor(padded, all, raw.format.to_grey);
  all(inside).copyTo(view(result.grey));
  if (raw.colour) {
    cv::cvtColor(padded, all, raw.format.to_rgb);
    all(inside).copyTo(view(result.colour));
  }
  return result;
}

Expected<Converted> convert_yuv422(const Raw& raw) {
  const int even_px = (raw.width_px + 1) / 2 * 2;
  const Expected<cv::Mat> pairs =
      rows_of(raw, raw.planes[0], 0, raw.planes[0].stride_bytes, raw.height_px, even_px, CV_8UC2);
  if (!pairs) return tl::unexpected(pairs.error());
  Converted result = blank(raw, raw.colour);
  cv::extractChannel(pairs->colRange(0, raw.width_px), view(result.grey), raw.format.to_grey);
  if (raw.colour) {
    cv::Mat ordered = *pairs;
    if (raw.format.v_first) {  // V and U stand where OpenCV looks for U and V
      cv::cvtColor(pairs->reshape(4), ordered, cv::COLOR_BGRA2RGBA);
      ordered = ordered.reshape(2);
    }
    cv::Mat all;
    cv::cvtColor(ordered, all, raw.format.to_rgb);
    all.colRange(0, raw.width_px).copyTo(view(result.colour));
  }
  return result;
}

/// The chroma of a yuv420 picture as one image of pairs, in the order in which they are stored
/// together (U V, or V U if format.v_first).
Expected<cv::Mat> chroma_of(const Raw& raw) {
  const int rows = (raw.height_px + 1) / 2, cols = (raw.width_px + 1) / 2;
  const RawPlane& first = raw.planes[0];
  const std::size_t luma_bytes = first.stride_bytes * static_cast<std::size_t>(raw.height_px);
  if (!raw.format.split) {
    return raw.format.planes == 1
               ? rows_of(raw, first, luma_bytes, first.stride_bytes, rows, cols, CV_8UC2)
               : rows_of(raw, raw.planes[1], 0, raw.planes[1].stride_bytes, rows, cols, CV_8UC2);
  }
  std::array<cv::Mat, 2> halves;
  for (std::size_t i = 0; i < 2; ++i) {
    const bool own = raw.format.planes == 3;
    const RawPlane& plane = own ? raw.planes[i + 1] : first;
    const std::size_t stride = own ? plane.stride_bytes : (first.stride_bytes + 1) / 2;
    const std::size_t offset = own ? 0 : luma_bytes + i * stride * static_cast<std::size_t>(rows);
    Expected<cv::Mat> half = rows_of(raw, plane, offset, stride, rows, cols, CV_8UC1);
    if (!half) return half;
    halves[i] = *half;
  }
  cv::Mat pairs;
  cv::merge(halves.data(), 2, pairs);
  return pairs;
}

Expected<Converted> convert_yuv420(const Raw& raw) {
  const Expected<cv::Mat> luma = rows_of(raw, raw.planes[0], 0, raw.planes[0].stride_bytes,
                                         raw.height_px, raw.width_px, CV_8UC1);
  if (!luma) return tl::unexpected(luma.error());
  const Expected<cv::Mat> chroma = chroma_of(raw);
  if (!chroma) return tl::unexpected(chroma.error());
  Converted result = blank(raw, raw.colour);
  luma->copyTo(view(result.grey));
  if (raw.colour) {
    cv::Mat even, all;
    cv::copyMakeBorder(*luma, even, 0, raw.height_px % 2, 0, raw.width_px % 2,
                       cv::BORDER_REPLICATE);
    cv::cvtColorTwoPlane(even, *chroma, all,
                         raw.format.v_first ? cv::COLOR_YUV2RGB_NV21 : cv::COLOR_YUV2RGB_NV12);
    all(cv::Rect(0, 0, raw.width_px, raw.height_px)).copyTo(view(result.colour));
  }
  return result;
}

Expected<Converted> convert_rgb(const Raw& raw) {
  const Expected<cv::Mat> pixels =
      rows_of(raw, raw.planes[0], 0, raw.planes[0].stride_bytes, raw.height_px, raw.width_px,
              CV_8UC(raw.format.channels));
  if (!pixels) return tl::unexpected(pixels.error());
  Converted result = blank(raw, raw.colour);
  cv::cvtColor(*pixels, view(result.grey), raw.format.to_grey);
  if (raw.colour && raw.format.to_rgb >= 0) {
    cv::cvtColor(*pixels, view(result.colour), raw.format.to_rgb);
  } else if (raw.colour) {
    pixels->copyTo(view(result.colour));
  }
  return result;
}

Expected<Converted> convert_jpeg(const Raw& raw) {
  const std::span<const std::uint8_t> bytes = raw.planes[0].bytes;
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  const std::optional<JpegHeader> header = whole_jpeg_header(text);
  if (!header) {
    return corrupt(raw, fmt::format("the {} bytes are no JPEG, or a cut-off one", bytes.size()));
  }
  if (header->width_px != raw.width_px || header->height_px != raw.height_px) {
    return corrupt(raw,
                   fmt::format("the JPEG has {} x {} pixels", header->width_px, header->height_px));
  }
  const cv::Mat data(1, static_cast<int>(bytes.size()), CV_8UC1,
                     const_cast<std::uint8_t*>(bytes.data()));
  // Decoded once: with colour, grey is made of that.
  const cv::Mat decoded = cv::imdecode(
      data, (raw.colour ? cv::IMREAD_COLOR : cv::IMREAD_GRAYSCALE) | cv::IMREAD_IGNORE_ORIENTATION);
  if (decoded.rows != raw.height_px || decoded.cols != raw.width_px) {
    return corrupt(raw, "the JPEG cannot be decoded");
  }
  Converted result = blank(raw, raw.colour);
  if (raw.colour) {
    cv::cvtColor(decoded, view(result.grey), cv::COLOR_BGR2GRAY);
    cv::cvtColor(decoded, view(result.colour), cv::COLOR_BGR2RGB);
  } else {
    decoded.copyTo(view(result.grey));
  }
  return result;
}

Expected<Converted> convert(const Raw& raw) {
  switch (raw.format.kind) {
    case RawKind::bayer:
      return convert_bayer(raw);
    case RawKind::yuv422:
      return convert_yuv422(raw);
    case RawKind::yuv420:
      return convert_yuv420(raw);
    case RawKind::rgb:
      return convert_rgb(raw);
    case RawKind::jpeg:
      return convert_jpeg(raw);
    case RawKind::grey:
      break;
  }
  return convert_grey(raw);
}

}  // namespace

Expected<void> convert_raw(std::uint32_t code, int width_px, int height_px,
                           std::span<const RawPlane> planes, bool colour, Capture& out) {
  const RawFormat* format = find_raw_format(code);
  if (!format) {
    return fail(ErrorCode::unsupported,
                fmt::format("pictures in the format {} are not understood", fourcc_name(code)));
  }
  const Raw raw{*format, width_px, height_px, planes, colour};
  constexpr int kMaxSide = 1 << 15;
  if (width_px < 1 || height_px < 1 || width_px > kMaxSide || height_px > kMaxSide) {
    return corrupt(raw, fmt::format("the sides must be 1 to {} pixels", kMaxSide));
  }
  if (planes.size() < static_cast<std::size_t>(format->planes)) {
    return corrupt(raw,
                   fmt::format("{} planes came, {} are needed", planes.size(), format->planes));
  }
  try {
    Expected<Converted> converted = convert(raw);
    if (!converted) return tl::unexpected(converted.error());
    out.grey = std::move(converted->grey);
    out.colour = std::move(converted->colour);
    return {};
  } catch (const cv::Exception& fault) {
    return corrupt(raw, fmt::format("cannot be converted: {}", fault.err));
  }
}

}  // namespace corvid
