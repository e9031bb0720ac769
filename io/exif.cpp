#include "io/exif.h"

#include <libexif/exif-data.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <cmath>
#include <fstream>
#include <memory>
#include <string_view>
#include <vector>

#include "io/readers/text.h"

namespace corvid {
namespace {

struct Sensor {
  std::string_view model;  ///< prefix of the EXIF model, lower case
  double width_mm;
};
// Makers' data sheets. Prefixes: the first that fits wins.
constexpr std::array kSensors = {
    Sensor{"canon powershot sx", 6.17},
    Sensor{"canon powershot elph", 6.17},
    Sensor{"canon powershot s1", 7.44},
    Sensor{"canon powershot g7 x", 13.2},
    Sensor{"canon eos 5d", 36.0},
    Sensor{"canon eos 6d", 36.0},
    Sensor{"canon eos r5", 36.0},
    Sensor{"canon eos", 22.3},
    Sensor{"nikon d8", 36.0},
    Sensor{"nikon d6", 36.0},
    Sensor{"nikon d", 23.5},
    Sensor{"dsc-rx100", 13.2},
    Sensor{"dsc-wx", 6.17},
    Sensor{"ilce-7", 35.8},
    Sensor{"ilce-", 23.5},
    Sensor{"nex-", 23.5},
    Sensor{"fc6310", 13.2},
    Sensor{"l1d-20c", 13.2},
    Sensor{"fc330", 6.17},
    Sensor{"fc300", 6.17},
    Sensor{"fc220", 6.17},
    Sensor{"fc350", 6.17},
    Sensor{"hero", 6.17},
    Sensor{"gopro", 6.17},
    Sensor{"dmc-tz", 6.08},
};

struct FreeData {
  void operator()(ExifData* data) const { exif_data_unref(data); }
};

ExifEntry* entry(ExifData* data, ExifIfd ifd, ExifTag tag) {
  return exif_content_get_entry(data->ifd[ifd], tag);
}

std::string text_of(ExifData* data, ExifIfd ifd, ExifTag tag) {
  const ExifEntry* e = entry(data, ifd, tag);
  if (!e || e->format != EXIF_FORMAT_ASCII || !e->data) return {};
  const std::string_view all(reinterpret_cast<const char*>(e->data), e->size);
  return std::string(trim(all.substr(0, all.find('\0'))));
}

std::optional<double> any_number_of(ExifData* data, ExifIfd ifd, ExifTag tag) {
  const ExifEntry* e = entry(data, ifd, tag);
  if (!e || !e->data || e->components < 1) return {};
  const ExifByteOrder order = exif_data_get_byte_order(data);
  if (e->format == EXIF_FORMAT_RATIONAL && e->size >= 8) {
    const ExifRational r = exif_get_rational(e->data, order);
    if (r.denominator == 0) return {};
    return static_cast<double>(r.numerator) / r.denominator;
  }
  if (e->format == EXIF_FORMAT_SHORT && e->size >= 2) return exif_get_short(e->data, order);
  if (e->format == EXIF_FORMAT_LONG && e->size >= 4) return exif_get_long(e->data, order);
  return {};
}

// Where zero says that the camera does not know.
std::optional<double> number_of(ExifData* data, ExifIfd ifd, ExifTag tag) {
  const auto value = any_number_of(data, ifd, tag);
  return value && *value > 0 ? value : std::nullopt;
}

constexpr int kGpsHorizontalError = 0x001F;  // EXIF 2.31; libexif 0.6.24 has no name for it

// Degrees, minutes and seconds with the letter of their half of the Earth.
std::optional<double> angle_of(ExifData* data, int tag, int reference_tag, char negative) {
  const ExifEntry* e = entry(data, EXIF_IFD_GPS, static_cast<ExifTag>(tag));
  const std::string half = text_of(data, EXIF_IFD_GPS, static_cast<ExifTag>(reference_tag));
  if (!e || !e->data || e->format != EXIF_FORMAT_RATIONAL || e->components != 3 || e->size < 24 ||
      half.empty()) {
    return {};
  }
  double degrees = 0, unit = 1;
  for (unsigned i = 0; i < 3; ++i, unit /= 60) {
    const ExifRational r = exif_get_rational(e->data + 8 * i, exif_data_get_byte_order(data));
    if (r.denominator == 0 && r.numerator == 0) continue;  // seconds are often left out like this
    if (r.denominator == 0) return {};
    degrees += unit * static_cast<double>(r.numerator) / r.denominator;
  }
  return half.front() == negative ? -degrees : degrees;
}

// Latitude, longitude and altitude; nothing where the receiver had none: status V, or all zero.
std::optional<GeodeticPosition> gps_of(ExifData* data) {
  const auto latitude = angle_of(data, EXIF_TAG_GPS_LATITUDE, EXIF_TAG_GPS_LATITUDE_REF, 'S');
  const auto longitude = angle_of(data, EXIF_TAG_GPS_LONGITUDE, EXIF_TAG_GPS_LONGITUDE_REF, 'W');
  const auto altitude =
      any_number_of(data, EXIF_IFD_GPS, static_cast<ExifTag>(EXIF_TAG_GPS_ALTITUDE));
  if (!latitude || !longitude || !altitude || (*latitude == 0 && *longitude == 0)) return {};
  if (text_of(data, EXIF_IFD_GPS, static_cast<ExifTag>(EXIF_TAG_GPS_STATUS)) == "V") return {};
  const ExifEntry* below =
      entry(data, EXIF_IFD_GPS, static_cast<ExifTag>(EXIF_TAG_GPS_ALTITUDE_REF));
  const bool negative = below && below->data && below->size >= 1 && below->data[0] == 1;
  PositionFix fix;
  fix.position = {*latitude, *longitude, negative ? -*altitude : *altitude};
  return fix.problem().empty() ? std::optional(fix.position) : std::nullopt;
}

// "2014:10:19 13:20:51" and the digits of its fraction.
std::optional<std::int64_t> parse_time(const std::string& date, const std::string& fraction) {
  const std::vector<std::string_view> parts = fields(date, ": ");
  if (parts.size() != 6) return {};
  std::array<std::int64_t, 6> v{};
  for (std::size_t i = 0; i < 6; ++i) {
    const std::optional<std::int64_t> n = to_integer(parts[i]);
    if (!n || *n < 0 || *n > 9999) return {};
    v[i] = *n;
  }
  using namespace std::chrono;
  const year_month_day day{year(static_cast<int>(v[0])), month(static_cast<unsigned>(v[1])),
                           std::chrono::day(static_cast<unsigned>(v[2]))};
  if (!day.ok() || v[0] < 1900 || v[0] > 2200 || v[3] > 24 || v[4] > 60 || v[5] > 60) return {};
  const auto seconds =
      sys_days(day).time_since_epoch() + hours(v[3]) + minutes(v[4]) + std::chrono::seconds(v[5]);
  const std::int64_t whole = duration_cast<std::chrono::seconds>(seconds).count();
  return whole * 1'000'000'000 + seconds_to_ns("0." + fraction).value_or(0);
}

}  // namespace

std::optional<Exif> read_exif(const std::string& path) {
  // The EXIF segment is at most 64 KiB and stands first, behind JFIF's at most.
  std::ifstream file(path, std::ios::binary);
  if (file.get() != 0xFF || file.get() != 0xD8) return {};
  std::string head(std::size_t{128} << 10, '\0');
  head[0] = '\xFF', head[1] = '\xD8';
  file.read(head.data() + 2, static_cast<std::streamsize>(head.size() - 2));
  head.resize(2 + static_cast<std::size_t>(std::max<std::streamsize>(file.gcount(), 0)));
  const std::unique_ptr<ExifData, FreeData> data(exif_data_new_from_data(
      reinterpret_cast<const unsigned char*>(head.data()), static_cast<unsigned>(head.size())));
  if (!data) return {};
  bool any = false;
  for (const ExifContent* content : data->ifd) any |= content && content->count > 0;
  if (!any) return {};

  Exif exif;
  ExifData* d = data.get();
  exif.make = text_of(d, EXIF_IFD_0, EXIF_TAG_MAKE);
  exif.model = text_of(d, EXIF_IFD_0, EXIF_TAG_MODEL);
  exif.focal_mm = number_of(d, EXIF_IFD_EXIF, EXIF_TAG_FOCAL_LENGTH);
  exif.focal_35mm = number_of(d, EXIF_IFD_EXIF, EXIF_TAG_FOCAL_LENGTH_IN_35MM_FILM);
  exif.original_width_px = static_cast<int>(
      std::min(1e6, number_of(d, EXIF_IFD_EXIF, EXIF_TAG_PIXEL_X_DIMENSION).value_or(0)));
  exif.orientation = static_cast<int>(number_of(d, EXIF_IFD_0, EXIF_TAG_ORIENTATION).value_or(1));
  if (exif.orientation > 8) exif.orientation = 1;
  if (const auto resolution = number_of(d, EXIF_IFD_EXIF, EXIF_TAG_FOCAL_PLANE_X_RESOLUTION)) {
    const double unit =
        number_of(d, EXIF_IFD_EXIF, EXIF_TAG_FOCAL_PLANE_RESOLUTION_UNIT).value_or(2);
    exif.plane_px_per_mm = *resolution / (unit == 3 ? 10.0 : unit == 4 ? 1.0 : 25.4);
  }
  exif.time_ns = parse_time(text_of(d, EXIF_IFD_EXIF, EXIF_TAG_DATE_TIME_ORIGINAL),
                            text_of(d, EXIF_IFD_EXIF, EXIF_TAG_SUB_SEC_TIME_ORIGINAL));
  exif.gps = gps_of(d);
  exif.gps_sigma_m = number_of(d, EXIF_IFD_GPS, static_cast<ExifTag>(kGpsHorizontalError));
  return exif;
}

std::optional<ExifFocal> exif_focal(const Exif& exif, int width_px, int height_px) {
  const double diagonal_px = std::hypot(width_px, height_px);
  const double longer_px = std::max(width_px, height_px);
  // Outside these no lens that a camera carries is left: the tag is wrong.
  const auto sane = [&](double focal_px) {
    return std::isfinite(focal_px) && focal_px > 0.2 * longer_px && focal_px < 50 * longer_px;
  };
  if (exif.focal_35mm) {
    const double focal_px = *exif.focal_35mm * diagonal_px / std::hypot(36.0, 24.0);
    if (sane(focal_px)) return ExifFocal{focal_px, "35-mm equivalent"};
  }
  if (!exif.focal_mm) return {};
  const std::string model = lower_case(exif.model);
  for (const Sensor& sensor : kSensors) {
    if (!model.starts_with(sensor.model)) continue;
    const double focal_px = *exif.focal_mm / sensor.width_mm * longer_px;
    if (sane(focal_px)) return ExifFocal{focal_px, "sensor width of the " + exif.model};
  }
  if (exif.plane_px_per_mm) {
    const double original = exif.original_width_px > 0 ? exif.original_width_px : width_px;
    const double focal_px = *exif.focal_mm * *exif.plane_px_per_mm * width_px / original;
    if (sane(focal_px)) return ExifFocal{focal_px, "focal plane resolution"};
  }
  return {};
}

}  // namespace corvid
