#include "io/camera/raw_image.h"

#include <gtest/gtest.h>

#include <array>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

namespace corvid {
namespace {

using Bytes = std::vector<std::uint8_t>;

GreyImage grey_of(int width_px, int height_px, const Bytes& values) {
  GreyImage image(width_px, height_px);
  std::copy(values.begin(), values.end(), image.data());
  return image;
}

/// Converts one plane; a failed conversion gives an empty picture.
Capture converted(const std::string& format, int width_px, int height_px, const Bytes& bytes,
                  std::size_t stride_bytes, bool colour = false) {
  Capture out;
  const RawPlane plane{bytes, stride_bytes};
  const auto ok =
      convert_raw(fourcc_of(format), width_px, height_px, std::array{plane}, colour, out);
  EXPECT_TRUE(ok.has_value()) << (ok ? "" : ok.error().to_string());
  return out;
}

/// The message of a conversion that must fail and leave the picture as it was.
std::string fault_of(const std::string& format, int width_px, int height_px, const Bytes& bytes,
                     std::size_t stride_bytes, ErrorCode code = ErrorCode::corrupt) {
  Capture out;
  out.grey = GreyImage(1, 1, 77);
  out.sequence = 5;
  const RawPlane plane{bytes, stride_bytes};
  const auto ok = convert_raw(fourcc_of(format), width_px, height_px, std::array{plane}, true, out);
  EXPECT_FALSE(ok.has_value());
  EXPECT_EQ(out.grey, GreyImage(1, 1, 77));
  EXPECT_EQ(out.sequence, 5u);
  if (ok) return "";
  EXPECT_EQ(ok.error().code, code) << ok.error().to_string();
  return ok.error().to_string();
}

/// Every channel within `tolerance` of (r, g, b).
void expect_colour(const Rgb8& got, int r, int g, int b, int tolerance) {
  EXPECT_NEAR(got.r, r, tolerance);
  EXPECT_NEAR(got.g, g, tolerance);
  EXPECT_NEAR(got.b, b, tolerance);
}

TEST(RawImage, NamesOfFormats) {
  EXPECT_EQ(fourcc_of("YUYV"), 0x56595559u);
  EXPECT_EQ(fourcc_of("Y16"), 0x20363159u);
  EXPECT_EQ(fourcc_of("Y16 "), 0x20363159u);
  EXPECT_EQ(fourcc_name(0x20363159u), "Y16 ");
  EXPECT_EQ(fourcc_name(0xA0363159u), "Y16?");
  EXPECT_EQ(fourcc_of(""), 0u);
  EXPECT_EQ(fourcc_of("YUYV2"), 0u);
}

TEST(RawImage, GreyComesBeforeColourAndRawBeforeCompressed) {
  EXPECT_EQ(format_rank(fourcc_of("GREY")), 0);
  EXPECT_LT(format_rank(fourcc_of("NV12")), format_rank(fourcc_of("RGB3")));
  EXPECT_LT(format_rank(fourcc_of("YUYV")), format_rank(fourcc_of("BA81")));
  EXPECT_LT(format_rank(fourcc_of("BA81")), format_rank(fourcc_of("MJPG")));
  EXPECT_LT(format_rank(fourcc_of("H264")), 0);
}

TEST(RawImage, GreyIsTakenAsItIsWithoutThePaddingOfItsRows) {
  const Bytes bytes = {1, 2, 3, 99, 99, 4, 5, 6};
  const Capture out = converted("GREY", 3, 2, bytes, 5, true);
  EXPECT_EQ(out.grey, grey_of(3, 2, {1, 2, 3, 4, 5, 6}));
  EXPECT_TRUE(out.colour.empty());
}

TEST(RawImage, SixteenBitFormatsKeepTheirUpperEightBits) {
  // 0x0000, 0x00FF, 0x0200, 0x03FF as little-endian words
  const Bytes ten = {0x00, 0x00, 0xFF, 0x00, 0x00, 0x02, 0xFF, 0x03};
  EXPECT_EQ(converted("Y10 ", 4, 1, ten, 8).grey, grey_of(4, 1, {0, 63, 128, 255}));
  const Bytes twelve = {0x0F, 0x00, 0x10, 0x00, 0x00, 0x08, 0xFF, 0x0F};
  EXPECT_EQ(converted("Y12 ", 4, 1, twelve, 8).grey, grey_of(4, 1, {0, 1, 128, 255}));
  const Bytes sixteen = {0xFF, 0x00, 0x00, 0x01, 0x34, 0x82, 0xFF, 0xFF};
  EXPECT_EQ(converted("Y16 ", 4, 1, sixteen, 8).grey, grey_of(4, 1, {0, 1, 0x82, 255}));
  // More than ten bits in a ten-bit word: white, not what the upper bits would wrap to.
  EXPECT_EQ(converted("Y10 ", 1, 1, {0x00, 0x04}, 2).grey, grey_of(1, 1, {255}));
}

TEST(RawImage, PackedFormatsKeepTheirWholeBytes) {
  // Four upper bytes, one of lower bits; the second group of five holds one more pixel.
  const Bytes ten = {10, 20, 30, 40, 0xFF, 50, 0, 0, 0, 0xFF};
  EXPECT_EQ(converted("Y10P", 5, 1, ten, 10).grey, grey_of(5, 1, {10, 20, 30, 40, 50}));
  const Bytes twelve = {10, 20, 0xFF, 30, 0, 0xFF};
  EXPECT_EQ(converted("Y12P", 3, 1, twelve, 6).grey, grey_of(3, 1, {10, 20, 30}));
}

// BT.601 of limited range: Y 81, U 90, V 240 is red; Y 145, U 54, V 34 green.
TEST(RawImage, OrdersOfPackedYuv) {
  const std::vector<std::pair<std::string, Bytes>> red = {{"YUYV", {81, 90, 82, 240}},
                                                          {"YVYU", {81, 240, 82, 90}},
                                                          {"UYVY", {90, 81, 240, 82}},
                                                          {"VYUY", {240, 81, 90, 82}}};
  for (const auto& [format, bytes] : red) {
    SCOPED_TRACE(format);
    const Capture out = converted(format, 2, 1, bytes, 4, true);
    EXPECT_EQ(out.grey, grey_of(2, 1, {81, 82}));
    ASSERT_EQ(out.colour.width(), 2);
    expect_colour(out.colour(0, 0), 255, 0, 0, 2);
  }
}

TEST(RawImage, OddWidthOfPackedYuv) {
  const Bytes bytes = {81, 90, 82, 240, 83, 90, 0, 240};
  const Capture out = converted("YUYV", 3, 1, bytes, 8, true);
  EXPECT_EQ(out.grey, grey_of(3, 1, {81, 82, 83}));
  expect_colour(out.colour(2, 0), 255, 0, 0, 4);
}

// 4 x 2 pixels, rows 6 bytes apart; left half red, right half green.
TEST(RawImage, PlanarYuvWithOneAndWithMorePlanes) {
  const GreyImage luma = grey_of(4, 2, {81, 81, 145, 145, 82, 82, 146, 146});
  const Bytes y = {81, 81, 145, 145, 9, 9, 82, 82, 146, 146, 9, 9};
  const Bytes uv = {90, 240, 54, 34, 9, 9}, vu = {240, 90, 34, 54, 9, 9};
  const Bytes u = {90, 54, 9}, v = {240, 34, 9};
  const std::vector<std::pair<std::string, std::vector<Bytes>>> cases = {
      {"NV12", {uv}}, {"NV21", {vu}}, {"YU12", {u, v}}, {"YV12", {v, u}},
      {"NM12", {uv}}, {"NM21", {vu}}, {"YM12", {u, v}}, {"YM21", {v, u}}};
  for (const auto& [format, parts] : cases) {
    SCOPED_TRACE(format);
    const bool apart = format[1] == 'M';
    Bytes joined = y;
    for (const Bytes& part : parts) joined.insert(joined.end(), part.begin(), part.end());
    std::vector<RawPlane> planes = {{apart ? y : joined, 6}};
    for (const Bytes& part : parts) {
      if (apart) planes.push_back({part, part.size()});
    }
    Capture out;
    ASSERT_TRUE(convert_raw(fourcc_of(format), 4, 2, planes, true, out).has_value());
    EXPECT_EQ(out.grey, luma);
    expect_colour(out.colour(0, 0), 255, 0, 0, 3);
    expect_colour(out.colour(3, 1), 0, 255, 0, 3);
    planes.pop_back();
    EXPECT_FALSE(convert_raw(fourcc_of(format), 4, 2, planes, false, out).has_value());
  }
}

TEST(RawImage, OddSizeOfPlanarYuv) {
  const Bytes bytes = {81, 81,  81, 0,   81, 81,  81, 0,  81, 81, 81, 0,  // 3 x 3
                       90, 240, 90, 240, 90, 240, 90, 240};               // 2 x 2 pairs
  const Capture out = converted("NV12", 3, 3, bytes, 4, true);
  EXPECT_EQ(out.grey, GreyImage(3, 3, 81));
  expect_colour(out.colour(2, 2), 255, 0, 0, 2);
}

TEST(RawImage, RgbInBothOrders) {
  // 0.299 R + 0.587 G + 0.114 B of (200, 100, 50): 59.8 + 58.7 + 5.7 = 124.2
  const std::vector<std::pair<std::string, Bytes>> cases = {{"RGB3", {200, 100, 50}},
                                                            {"BGR3", {50, 100, 200}},
                                                            {"XB24", {200, 100, 50, 9}},
                                                            {"XR24", {50, 100, 200, 9}}};
  for (const auto& [format, bytes] : cases) {
    SCOPED_TRACE(format);
    const Capture out = converted(format, 1, 1, bytes, bytes.size(), true);
    EXPECT_EQ(out.grey, grey_of(1, 1, {124}));
    expect_colour(out.colour(0, 0), 200, 100, 50, 0);
  }
}

/// 6 x 6 samples of a mosaic, `width_bits` wide, of an even colour (200, 100, 40).
Bytes mosaic(const std::string& order, int bytes_per_sample, int shift) {
  Bytes bytes;
  for (int y = 0; y < 6; ++y) {
    for (int x = 0; x < 6; ++x) {
      const char letter = order[static_cast<std::size_t>(2 * (y % 2) + x % 2)];
      const int value = (letter == 'R' ? 200 : letter == 'G' ? 100 : 40) << shift;
      bytes.push_back(static_cast<std::uint8_t>(value));
      if (bytes_per_sample == 2) bytes.push_back(static_cast<std::uint8_t>(value >> 8));
    }
  }
  return bytes;
}

// 0.299 * 200 + 0.587 * 100 + 0.114 * 40 = 123.06, in every pixel, at the border too.
TEST(RawImage, BayerInAllOrdersGivesTheGreyOfItsColour) {
  struct Case {
    std::string order, eight, ten, twelve, sixteen;
  };
  for (const Case& c :
       {Case{"BGGR", "BA81", "BG10", "BG12", "BYR2"}, Case{"GBRG", "GBRG", "GB10", "GB12", "GB16"},
        Case{"GRBG", "GRBG", "BA10", "BA12", "GR16"},
        Case{"RGGB", "RGGB", "RG10", "RG12", "RG16"}}) {
    SCOPED_TRACE(c.order);
    const Capture eight = converted(c.eight, 6, 6, mosaic(c.order, 1, 0), 6, true);
    for (int y = 0; y < 6; ++y) {
      for (int x = 0; x < 6; ++x) {
        EXPECT_NEAR(eight.grey(x, y), 123, 1);
        expect_colour(eight.colour(x, y), 200, 100, 40, 1);
      }
    }
    EXPECT_EQ(converted(c.ten, 6, 6, mosaic(c.order, 2, 2), 12).grey, eight.grey);
    EXPECT_EQ(converted(c.twelve, 6, 6, mosaic(c.order, 2, 4), 12).grey, eight.grey);
    EXPECT_EQ(converted(c.sixteen, 6, 6, mosaic(c.order, 2, 8), 12).grey, eight.grey);
  }
}

TEST(RawImage, BayerOfTheSmallestSizes) {
  EXPECT_NEAR(converted("RGGB", 2, 2, {200, 100, 100, 40}, 2).grey(1, 1), 123, 1);
  EXPECT_EQ(converted("RGGB", 1, 1, {100}, 1).grey.size(), 1u);
}

TEST(RawImage, PackedBayer) {
  const Bytes rows = {200, 100, 200, 100, 0, 100, 40, 100, 40, 0};
  EXPECT_NEAR(converted("pRAA", 4, 2, rows, 5).grey(2, 1), 123, 1);
}

/// A JPEG of 32 x 24 pixels, all of one grey.
Bytes jpeg_of(std::uint8_t value) {
  Bytes bytes;
  cv::imencode(".jpg", cv::Mat(24, 32, CV_8UC1, cv::Scalar(value)), bytes);
  return bytes;
}

TEST(RawImage, Jpeg) {
  Bytes bytes = jpeg_of(150);
  bytes.resize(bytes.size() + 100);  // what cameras send behind the end
  const Capture out = converted("MJPG", 32, 24, bytes, 0, true);
  EXPECT_EQ(out.grey, GreyImage(32, 24, 150));
  expect_colour(out.colour(31, 23), 150, 150, 150, 0);
}

TEST(RawImage, JpegWithColourIsDecodedOnceAndItsGreyIsNearlyTheLuma) {
  cv::Mat picture(24, 32, CV_8UC3);
  for (int y = 0; y < 24; ++y) {
    for (int x = 0; x < 32; ++x)
      picture.at<cv::Vec3b>(y, x) = cv::Vec3b(60 + 2 * x, 100, 90 + 4 * y);
  }
  Bytes bytes;
  cv::imencode(".jpg", picture, bytes);
  const Capture grey = converted("MJPG", 32, 24, bytes, 0),
                both = converted("MJPG", 32, 24, bytes, 0, true);
  EXPECT_TRUE(grey.colour.empty());
  for (int y = 0; y < 24; ++y) {
    for (int x = 0; x < 32; ++x) EXPECT_NEAR(both.grey(x, y), grey.grey(x, y), 2);
  }
  expect_colour(both.colour(16, 12), 138, 100, 92, 12);
}

TEST(RawImage, JpegWithoutHuffmanTablesAsCamerasSendIt) {
  Bytes bytes = jpeg_of(150);
  for (std::size_t at = 2; bytes[at + 1] != 0xDA;) {  // FF DA: the scan
    const std::size_t size = 2u + (bytes[at + 2] << 8) + bytes[at + 3];
    if (bytes[at + 1] == 0xC4) {  // DHT
      const auto from = bytes.begin() + static_cast<std::ptrdiff_t>(at);
      bytes.erase(from, from + static_cast<std::ptrdiff_t>(size));
    } else {
      at += size;
    }
  }
  EXPECT_LT(bytes.size(), jpeg_of(150).size());
  EXPECT_EQ(converted("MJPG", 32, 24, bytes, 0).grey, GreyImage(32, 24, 150));
}

TEST(RawImage, JpegThatIsCutOffAnywhereIsAFault) {
  const Bytes whole = jpeg_of(150);
  for (std::size_t size = 0; size < whole.size(); ++size) {
    const Bytes part(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
    EXPECT_NE(fault_of("MJPG", 32, 24, part, 0).find("cut-off"), std::string::npos) << size;
  }
}

TEST(RawImage, JpegOfAnotherSizeIsAFault) {
  EXPECT_EQ(fault_of("MJPG", 24, 32, jpeg_of(1), 0),
            "MJPG picture of 24 x 32 pixels: the JPEG has 32 x 24 pixels");
}

TEST(RawImage, FaultsSayWhatIsMissing) {
  EXPECT_EQ(fault_of("GREY", 3, 2, {1, 2, 3, 4, 5}, 3),
            "GREY picture of 3 x 2 pixels: 5 bytes came, 6 are needed");
  EXPECT_EQ(fault_of("Y16 ", 2, 1, {1, 2, 3}, 3),
            "Y16  picture of 2 x 1 pixels: rows lie 3 bytes apart but have 4 bytes");
  EXPECT_EQ(fault_of("H264", 2, 1, {1, 2, 3}, 3, ErrorCode::unsupported),
            "pictures in the format H264 are not understood");
  fault_of("NV12", 2, 2, {1, 2, 3, 4, 5}, 2);
  fault_of("YU12", 2, 2, {1, 2, 3, 4, 5}, 2);
  fault_of("YUYV", 1, 1, {1, 2}, 2);
  fault_of("RGGB", 2, 2, {1, 2, 3}, 2);
  fault_of("GREY", 0, 2, {1, 2, 3}, 3);
  fault_of("GREY", 1 << 30, 1 << 30, {1, 2, 3}, std::size_t{1} << 62);
  fault_of("GREY", 3, 5, Bytes(15), std::size_t{1} << 62);
  fault_of("MJPG", 4, 4, {}, 0);
}

}  // namespace
}  // namespace corvid
