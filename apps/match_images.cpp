#include "apps/match_images.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <utility>

#include "io/calibration.h"
#include "io/exif.h"
#include "io/image_file.h"
#include "io/source_images.h"
#include "replay/synthetic_flight.h"

namespace corvid {
namespace {

Expected<MatchImage> large_enough(MatchImage image, const std::string& where) {
  if (std::min(image.grey.width(), image.grey.height()) >= kMinMatchSide_px) return image;
  return fail(ErrorCode::unsupported,
              fmt::format("the image has {} x {} pixels: too small to be matched",
                          image.grey.width(), image.grey.height()),
              where, fmt::format("give images of at least {0} x {0} pixels", kMinMatchSide_px));
}

Expected<MatchImage> from_frame(const FramePtr& frame, const SourceInfo& info, int number,
                                const std::string& where) {
  return large_enough({frame->name.empty() ? fmt::format("frame {}", number) : frame->name,
                       frame->grey, *frame->camera, info.intrinsics, info.notes},
                      where);
}

// One frame of a source of files: only it is decoded where the source knows its places.
Expected<MatchImage> read_frame(SourceArguments source, int number, const std::stop_token& stop) {
  source.options.first = number;
  source.options.count = 1;
  const auto opened = source.open();
  if (!opened) return tl::unexpected(opened.error());
  const auto frame = (*opened)->next(stop);
  if (!frame) return tl::unexpected(frame.error());
  if (stop.stop_requested()) return fail(ErrorCode::interrupted, "interrupted while reading");
  if (*frame == nullptr) {
    return fail(ErrorCode::invalid_argument, fmt::format("there is no frame {}", number),
                source.spec, "`corvid info` says how many there are; the first is 0");
  }
  return from_frame(*frame, (*opened)->info(), number, source.spec);
}

}  // namespace

Expected<MatchImage> read_match_image(const std::string& path,
                                      const std::string& calibration_path) {
  std::error_code ignored;
  if (std::filesystem::is_directory(path, ignored)) {
    return fail(ErrorCode::unsupported, "this is a folder, not an image", path,
                "give image files, or the folder alone with --frames 0,1");
  }
  auto decoded = read_image(path, false);
  if (!decoded) return tl::unexpected(decoded.error());
  MatchImage image;
  image.name = std::filesystem::path(path).filename().string();
  image.grey = std::move(decoded->grey);
  const int width = image.grey.width(), height = image.grey.height();
  if (const auto exif = read_exif(path); exif && exif->orientation != 1) {
    image.notes.push_back(fmt::format(
        "viewers are asked to turn it (EXIF orientation {}): it is used as it is stored",
        exif->orientation));
  }
  if (calibration_path.empty()) {
    SourceInfo info;
    assume_camera(path, width, height, info);
    image.camera = *info.camera;
    image.intrinsics = info.intrinsics;
    image.notes.insert(image.notes.end(), info.notes.begin(), info.notes.end());
  } else {
    auto read = read_calibration(calibration_path);
    if (!read) return tl::unexpected(read.error());
    auto fitted = fit_calibration(std::move(*read), width, height, calibration_path);
    if (!fitted) return tl::unexpected(fitted.error());
    image.camera = fitted->camera;
    image.notes.insert(image.notes.end(), fitted->notes.begin(), fitted->notes.end());
  }
  return large_enough(std::move(image), path);
}

Expected<std::vector<MatchImage>> read_match_frames(const SourceArguments& source,
                                                    const std::vector<int>& frames,
                                                    const std::stop_token& stop) {
  const auto opened = source.open();
  if (!opened) return tl::unexpected(opened.error());
  const SourceInfo& info = (*opened)->info();
  const auto* flight = dynamic_cast<const SyntheticFlight*>(opened->get());
  std::vector<MatchImage> images;
  for (const int number : frames) {
    if (info.frames && static_cast<std::size_t>(number) >= *info.frames) {
      return fail(ErrorCode::invalid_argument,
                  fmt::format("there is no frame {} among its {} frames", number, *info.frames),
                  source.spec, "the first is number 0");
    }
    auto image = flight != nullptr ? from_frame(flight->render(static_cast<std::size_t>(number)),
                                                info, number, source.spec)
                                   : read_frame(source, number, stop);
    if (!image) return tl::unexpected(image.error());
    images.push_back(std::move(*image));
  }
  return images;
}

}  // namespace corvid
