#include "io/depth_file.h"

#include <cstdint>
#include <exception>
#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "io/atomic_file.h"

namespace corvid {

Expected<FloatImage> read_depth_image(const std::string& path) {
  const auto bytes = read_file_bytes(path);
  if (!bytes) return tl::unexpected(bytes.error());
  cv::Mat image;
  try {
    image = cv::imdecode(
        cv::Mat(1, static_cast<int>(bytes->size()), CV_8U, const_cast<char*>(bytes->data())),
        cv::IMREAD_UNCHANGED);
  } catch (const std::exception&) {
    image.release();
  }
  if (image.empty() || image.type() != CV_16UC1) {
    return fail(ErrorCode::corrupt, "this is not a depth image", path,
                "expected a PNG with 16 bits and one channel, millimetres");
  }
  constexpr float kMetres = 1e-3F;
  FloatImage depth(image.cols, image.rows);
  for (int y = 0; y < depth.height(); ++y) {
    for (int x = 0; x < depth.width(); ++x) {
      const auto mm = image.at<std::uint16_t>(y, x);
      if (mm != std::numeric_limits<std::uint16_t>::max()) depth(x, y) = kMetres * mm;
    }
  }
  return depth;
}

}  // namespace corvid
