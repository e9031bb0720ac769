#pragma once

#include <gtest/gtest.h>
#include <libexif/exif-data.h>
#include <stdlib.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <string>
#include <vector>

#include "corvid/position.h"
#include "io/source.h"

namespace corvid::test {

/// A folder that goes away with the test.
class TempFolder {
 public:
  TempFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "corvid-XXXXXX").string();
    path_ = ::mkdtemp(name.data());
  }
  ~TempFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TempFolder(const TempFolder&) = delete;
  TempFolder& operator=(const TempFolder&) = delete;
  [[nodiscard]] std::string path() const { return path_.string(); }
  [[nodiscard]] std::string operator/(const std::string& name) const {
    return (path_ / name).string();
  }

 private:
  std::filesystem::path path_;
};

inline void write_text(const std::string& path, const std::string& text) {
  std::filesystem::create_directories(std::filesystem::path(path).parent_path());
  std::ofstream(path, std::ios::binary) << text;
}

inline std::string read_text(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

/// A picture that differs from place to place and from `value` to `value`.
inline cv::Mat picture(int width_px, int height_px, int value, int channels = 1) {
  cv::Mat image(height_px, width_px, CV_8UC(channels));
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px * channels; ++x) {
      image.ptr(y)[x] = static_cast<unsigned char>((x * 7 + y * 13 + value * 31) % 256);
    }
  }
  return image;
}

inline void write_image(const std::string& path, int width_px = 32, int height_px = 24,
                        int value = 0, int channels = 1) {
  std::filesystem::create_directories(std::filesystem::path(path).parent_path());
  ASSERT_TRUE(cv::imwrite(path, picture(width_px, height_px, value, channels)));
}

inline void truncate_file(const std::string& path, double share) {
  const auto size = static_cast<double>(std::filesystem::file_size(path));
  std::filesystem::resize_file(path, static_cast<std::uintmax_t>(size * share));
}

/// What a JPEG with EXIF is made of; fields that are empty are left out.
struct ExifFields {
  std::string make, model, time, fraction;
  std::optional<double> focal_mm, focal_35mm, plane_px_per_inch;
  int original_width_px = 0;
  int orientation = 0;
  std::optional<GeodeticPosition> gps;
};

inline void write_jpeg_with_exif(const std::string& path, int width_px, int height_px,
                                 const ExifFields& fields) {
  ExifData* data = exif_data_new();
  exif_data_set_byte_order(data, EXIF_BYTE_ORDER_INTEL);
  const auto add = [&](ExifIfd ifd, int tag, ExifFormat format, const std::string& bytes,
                       unsigned long components) {
    ExifEntry* entry = exif_entry_new();
    entry->tag = static_cast<ExifTag>(tag);
    entry->format = format;
    entry->components = components;
    entry->size = static_cast<unsigned>(bytes.size());
    entry->data = static_cast<unsigned char*>(malloc(bytes.size()));
    std::copy(bytes.begin(), bytes.end(), entry->data);
    exif_content_add_entry(data->ifd[ifd], entry);
    exif_entry_unref(entry);
  };
  const auto add_text = [&](ExifIfd ifd, int tag, const std::string& text) {
    if (!text.empty()) add(ifd, tag, EXIF_FORMAT_ASCII, text + '\0', text.size() + 1);
  };
  const auto add_short = [&](ExifIfd ifd, int tag, int value) {
    std::string bytes(2, '\0');
    exif_set_short(reinterpret_cast<unsigned char*>(bytes.data()), EXIF_BYTE_ORDER_INTEL,
                   static_cast<ExifShort>(value));
    add(ifd, tag, EXIF_FORMAT_SHORT, bytes, 1);
  };
  const auto add_ratio = [&](ExifIfd ifd, int tag, double value) {
    std::string bytes(8, '\0');
    exif_set_rational(reinterpret_cast<unsigned char*>(bytes.data()), EXIF_BYTE_ORDER_INTEL,
                      ExifRational{static_cast<ExifLong>(value * 1000), 1000});
    add(ifd, tag, EXIF_FORMAT_RATIONAL, bytes, 1);
  };
  add_text(EXIF_IFD_0, EXIF_TAG_MAKE, fields.make);
  add_text(EXIF_IFD_0, EXIF_TAG_MODEL, fields.model);
  if (fields.orientation) add_short(EXIF_IFD_0, EXIF_TAG_ORIENTATION, fields.orientation);
  add_text(EXIF_IFD_EXIF, EXIF_TAG_DATE_TIME_ORIGINAL, fields.time);
  add_text(EXIF_IFD_EXIF, EXIF_TAG_SUB_SEC_TIME_ORIGINAL, fields.fraction);
  if (fields.focal_mm) add_ratio(EXIF_IFD_EXIF, EXIF_TAG_FOCAL_LENGTH, *fields.focal_mm);
  if (fields.focal_35mm) {
    add_short(EXIF_IFD_EXIF, EXIF_TAG_FOCAL_LENGTH_IN_35MM_FILM,
              static_cast<int>(*fields.focal_35mm));
  }
  if (fields.plane_px_per_inch) {
    add_ratio(EXIF_IFD_EXIF, EXIF_TAG_FOCAL_PLANE_X_RESOLUTION, *fields.plane_px_per_inch);
    add_short(EXIF_IFD_EXIF, EXIF_TAG_FOCAL_PLANE_RESOLUTION_UNIT, 2);
  }
  if (fields.original_width_px) {
    add_short(EXIF_IFD_EXIF, EXIF_TAG_PIXEL_X_DIMENSION, fields.original_width_px);
  }
  const auto add_angle = [&](int tag, double degrees) {
    const double whole = std::floor(std::abs(degrees));
    const double minutes = 60 * (std::abs(degrees) - whole);
    const double parts[] = {whole, std::floor(minutes), 60 * (minutes - std::floor(minutes))};
    std::string bytes(24, '\0');
    for (int i = 0; i < 3; ++i) {
      exif_set_rational(
          reinterpret_cast<unsigned char*>(bytes.data()) + 8 * i, EXIF_BYTE_ORDER_INTEL,
          ExifRational{static_cast<ExifLong>(std::lround(parts[i] * 1e6)), 1'000'000});
    }
    add(EXIF_IFD_GPS, tag, EXIF_FORMAT_RATIONAL, bytes, 3);
  };
  if (fields.gps) {
    add_text(EXIF_IFD_GPS, EXIF_TAG_GPS_LATITUDE_REF, fields.gps->latitude_deg < 0 ? "S" : "N");
    add_angle(EXIF_TAG_GPS_LATITUDE, fields.gps->latitude_deg);
    add_text(EXIF_IFD_GPS, EXIF_TAG_GPS_LONGITUDE_REF, fields.gps->longitude_deg < 0 ? "W" : "E");
    add_angle(EXIF_TAG_GPS_LONGITUDE, fields.gps->longitude_deg);
    add(EXIF_IFD_GPS, EXIF_TAG_GPS_ALTITUDE_REF, EXIF_FORMAT_BYTE,
        std::string(1, fields.gps->altitude_m < 0 ? '\1' : '\0'), 1);
    add_ratio(EXIF_IFD_GPS, EXIF_TAG_GPS_ALTITUDE, std::abs(fields.gps->altitude_m));
  }
  unsigned char* block = nullptr;
  unsigned size = 0;
  exif_data_save_data(data, &block, &size);

  std::vector<unsigned char> jpeg;
  cv::imencode(".jpg", picture(width_px, height_px, 1), jpeg);
  std::string bytes("\xFF\xD8\xFF\xE1", 4);
  bytes += static_cast<char>((size + 2) >> 8);
  bytes += static_cast<char>((size + 2) & 0xFF);
  bytes.append(reinterpret_cast<const char*>(block), size);
  bytes.append(reinterpret_cast<const char*>(jpeg.data()) + 2, jpeg.size() - 2);
  write_text(path, bytes);
  free(block);
  exif_data_unref(data);
}

/// Opens the source or fails the test.
inline std::unique_ptr<FrameSource> opened(const std::string& path,
                                           const SourceOptions& options = {}) {
  auto source = open_source(path, options);
  EXPECT_TRUE(source) << source.error().to_string();
  return source ? std::move(*source) : nullptr;
}

/// All frames to the end of the source.
inline std::vector<FramePtr> all_frames(FrameSource& source) {
  std::vector<FramePtr> frames;
  for (;;) {
    Expected<FramePtr> frame = source.next();
    if (!frame) {
      ADD_FAILURE() << frame.error().to_string();
      return frames;
    }
    if (!*frame) return frames;
    frames.push_back(*frame);
  }
}

/// The message of the error that opening gives; fails the test if it opens.
inline std::string open_error(const std::string& path, const SourceOptions& options = {}) {
  auto source = open_source(path, options);
  EXPECT_FALSE(source) << path << " was opened";
  return source ? "" : source.error().to_string();
}

inline bool has_note(const std::vector<std::string>& notes, const std::string& part) {
  for (const std::string& note : notes) {
    if (note.find(part) != std::string::npos) return true;
  }
  return false;
}

/// A small ASL recording: `count` images of 32x24 at 10 Hz, from 1 s on, truth at 100 Hz.
inline void write_asl(const std::string& root, int count = 4) {
  const std::string cam = root + "/mav0/cam0/";
  std::string csv = "#timestamp [ns],filename\n";
  for (int i = 0; i < count; ++i) {
    const std::string time = std::to_string(1'000'000'000LL + i * 100'000'000LL);
    write_image(cam + "data/" + time + ".png", 32, 24, i);
    csv += time + "," + time + ".png\n";
  }
  write_text(cam + "data.csv", csv);
  write_text(cam + "sensor.yaml",
             "sensor_type: camera\ncomment: test\nT_BS:\n  cols: 4\n  rows: 4\n"
             "  data: [0.0, -1.0, 0.0, 0.1,\n         1.0, 0.0, 0.0, 0.2,\n"
             "         0.0, 0.0, 1.0, 0.3,\n         0.0, 0.0, 0.0, 1.0]\n"
             "rate_hz: 10\nresolution: [32, 24]\ncamera_model: pinhole\n"
             "intrinsics: [30.5, 31.5, 15.25, 11.75] #fu, fv, cu, cv\n"
             "distortion_model: radial-tangential\n"
             "distortion_coefficients: [-0.1, 0.02, 0.001, -0.002]\n");
  std::string truth = "#timestamp, p_x [m], p_y, p_z, q_w [], q_x, q_y, q_z, v_x\n";
  for (int i = 0; i < count * 10; ++i) {
    truth += std::to_string(1'000'000'000LL + i * 10'000'000LL) + "," + std::to_string(i) +
             ".5,2,3,1,0,0,0,0.7\n";
  }
  write_text(root + "/mav0/state_groundtruth_estimate0/data.csv", truth);
}

}  // namespace corvid::test
