#include "io/camera/libcamera_format.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <iterator>
#include <tuple>
#include <vector>

#include "io/camera/raw_image.h"
#include "io/nearest_name.h"

namespace corvid {
namespace {

struct Name {
  const char* libcamera;
  const char* v4l2;
};

/// Those that raw_format.cpp understands.
constexpr std::array kNames = {
    Name{"R8", "GREY"},
    Name{"R10", "Y10 "},
    Name{"R12", "Y12 "},
    Name{"R16", "Y16 "},
    Name{"R10_CSI2P", "Y10P"},
    Name{"R12_CSI2P", "Y12P"},
    Name{"RGB888", "BGR3"},
    Name{"BGR888", "RGB3"},
    Name{"XRGB8888", "XR24"},
    Name{"XBGR8888", "XB24"},
    Name{"YUYV", "YUYV"},
    Name{"YVYU", "YVYU"},
    Name{"UYVY", "UYVY"},
    Name{"VYUY", "VYUY"},
    Name{"NV12", "NV12"},
    Name{"NV21", "NV21"},
    Name{"YUV420", "YU12"},
    Name{"YVU420", "YV12"},
    Name{"MJPEG", "MJPG"},
    Name{"SRGGB8", "RGGB"},
    Name{"SGRBG8", "GRBG"},
    Name{"SGBRG8", "GBRG"},
    Name{"SBGGR8", "BA81"},
    Name{"SRGGB10", "RG10"},
    Name{"SGRBG10", "BA10"},
    Name{"SGBRG10", "GB10"},
    Name{"SBGGR10", "BG10"},
    Name{"SRGGB10_CSI2P", "pRAA"},
    Name{"SGRBG10_CSI2P", "pgAA"},
    Name{"SGBRG10_CSI2P", "pGAA"},
    Name{"SBGGR10_CSI2P", "pBAA"},
    Name{"SRGGB12", "RG12"},
    Name{"SGRBG12", "BA12"},
    Name{"SGBRG12", "GB12"},
    Name{"SBGGR12", "BG12"},
    Name{"SRGGB12_CSI2P", "pRCC"},
    Name{"SGRBG12_CSI2P", "pgCC"},
    Name{"SGBRG12_CSI2P", "pGCC"},
    Name{"SBGGR12_CSI2P", "pBCC"},
    Name{"SRGGB16", "RG16"},
    Name{"SGRBG16", "GR16"},
    Name{"SGBRG16", "GB16"},
    Name{"SBGGR16", "BYR2"},
};

/// libcamera calls greys R, of so many bits: R8, R10_CSI2P.
bool is_grey(const std::string& name) {
  return name.size() > 1 && name[0] == 'R' && name[1] >= '0' && name[1] <= '9';
}

int rank_of(const OfferedFormat& format) {
  const std::uint32_t fourcc = v4l2_fourcc_of(format.name);
  return fourcc == 0 ? -1 : format_rank(fourcc);
}

}  // namespace

std::uint32_t v4l2_fourcc_of(const std::string& libcamera_name) {
  const auto* at = std::find_if(kNames.begin(), kNames.end(),
                                [&](const Name& name) { return libcamera_name == name.libcamera; });
  return at == kNames.end() ? 0 : fourcc_of(at->v4l2);
}

Expected<std::size_t> choose_format(std::span<const OfferedFormat> offered,
                                    const CameraRequest& request) {
  std::vector<std::string> names;
  for (const OfferedFormat& format : offered) names.push_back(format.name);
  const std::string list = fmt::format("the camera has {}", fmt::join(names, ", "));
  if (!request.format.empty()) {
    const auto at = std::find(names.begin(), names.end(), request.format);
    if (at == names.end()) {
      const std::string nearest = nearest_hint(request.format, names);
      return fail(ErrorCode::unsupported,
                  fmt::format("the camera has no format {}", request.format), request.device,
                  nearest.empty() ? list : nearest + " " + list);
    }
    const auto index = static_cast<std::size_t>(at - names.begin());
    if (rank_of(offered[index]) < 0) {
      return fail(ErrorCode::unsupported,
                  fmt::format("pictures of format {} are not understood", request.format),
                  request.device, list);
    }
    return index;
  }
  const auto badness = [&](const OfferedFormat& format) {
    const int rank = rank_of(format);
    return std::tuple(rank < 0, !format.has_size, request.colour && is_grey(format.name), rank);
  };
  const auto best = std::min_element(
      offered.begin(), offered.end(),
      [&](const OfferedFormat& a, const OfferedFormat& b) { return badness(a) < badness(b); });
  if (best == offered.end() || rank_of(*best) < 0) {
    return fail(ErrorCode::unsupported, "no format of the camera is understood", request.device,
                list);
  }
  return static_cast<std::size_t>(std::distance(offered.begin(), best));
}

}  // namespace corvid
