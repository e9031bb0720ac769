#include "bench/ncc_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <ostream>

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;

std::string cell(const std::optional<double>& value, int width, int digits) {
  return value ? fmt::format("{:>{}.{}f}", *value, width, digits)
               : fmt::format("{:>{}}", "-", width);
}
std::optional<double> milliseconds(const std::optional<Timing>& timing) {
  return timing ? std::optional(timing->median_ms) : std::nullopt;
}
std::optional<double> share_of_peak(const NccReport& report, const NccRow& row) {
  if (report.peak_gflops <= 0 || row.coefficients <= 0) return std::nullopt;
  return row.gflops() / report.peak_gflops;
}
std::optional<double> percent(std::optional<double> share) {
  if (share) *share *= 100;
  return share;
}

void print_head(const NccReport& report, std::ostream& out) {
  print_machine(report.machine, out);
  if (report.peak_measurements > 0) {
    out << fmt::format(
        "peak      {:.1f} GFLOP/s by single precision fused multiply-adds, {:.1f} GB/s by copying "
        "(read and written);\n          medians of {} measurements between the rows\n",
        report.peak_gflops, report.copy_gbytes_s, report.peak_measurements);
  }
  out << fmt::format("runs      {} of each work, Corvid's and OpenCV's in turn; medians\n",
                     report.runs);
}

void print_title(NccTable table, std::ostream& out) {
  switch (table) {
    case NccTable::dense:
      out << "\nDense: every coefficient of a square image, against matchTemplate "
             "(TM_CCOEFF_NORMED)\n";
      break;
    case NccTable::strips:
      out << "\nStrips: 3,000 windows of 21 rows x 641 columns in 1024 x 1024, peaks out\n";
      break;
    case NccTable::windows:
      out << "\nSmall windows: batches of 1,000 in 752 x 480, peaks out\n";
      break;
    case NccTable::flavours:
      out << "\nFlavours: every coefficient of 1024 x 1024\n";
      break;
    case NccTable::features:
      out << "\nFeatures: 752 x 480, against goodFeaturesToTrack and pyrDown\n";
      break;
  }
  if (table == NccTable::dense) {
    out << fmt::format("{:>8} {:>6} {:>10} {:>10} {:>10} {:>10} {:>7} {:>9} {:>8} {:>10} {:>10}\n",
                       "template", "image", "corvid ms", "fastest", "kept ms", "OpenCV ms", "ratio",
                       "GFLOP/s", "of peak", "upload ms", "difference");
    return;
  }
  out << fmt::format("{:<38} {:>10} {:>10} {:>10} {:>10} {:>7} {:>9}", "", "corvid ms", "fastest",
                     "cpu ms", "OpenCV ms", "ratio", "Gcoef/s");
  out << (table == NccTable::features ? "\n"
                                      : fmt::format(" {:>9} {:>8} {:>8}\n", "GFLOP/s", "of peak",
                                                    table == NccTable::strips     ? "of dense"
                                                    : table == NccTable::flavours ? "differ."
                                                                                  : ""));
}

void print_row(const NccReport& report, const NccRow& row, std::ostream& out) {
  const auto share = percent(share_of_peak(report, row));
  const std::string of_peak = share ? cell(share, 6, 1) + " %" : cell(share, 8, 1);
  if (row.table == NccTable::dense) {
    const std::string side = fmt::format("{}x{}", row.template_width_px, row.template_height_px);
    out << fmt::format(
        "{:>8} {:>6} {:>10.3f} {:>10.3f} {} {} {} {:>9.1f} {} {} {:>10}\n", side,
        row.image_width_px, row.corvid.median_ms, row.corvid.fastest_ms, cell(row.kept_ms, 10, 3),
        cell(milliseconds(row.opencv), 10, 3), cell(row.ratio(), 7, 2), row.gflops(), of_peak,
        cell(row.upload_ms, 10, 3),
        row.largest_difference ? fmt::format("{:.1e}", *row.largest_difference) : std::string("-"));
    return;
  }
  out << fmt::format("{:<38} {:>10.3f} {:>10.3f} {:>10.3f} {} {}", row.name, row.corvid.median_ms,
                     row.corvid.fastest_ms, row.corvid.cpu_ms,
                     cell(milliseconds(row.opencv), 10, 3), cell(row.ratio(), 7, 2));
  if (row.coefficients > 0) {
    out << fmt::format(" {:>9.3f} {:>9.1f} {}", row.gcoefficients_per_s(), row.gflops(), of_peak);
  }
  if (row.share_of_dense) out << fmt::format(" {:>6.1f} %", 100 * *row.share_of_dense);
  if (row.largest_difference) out << fmt::format(" {:>8.1e}", *row.largest_difference);
  out << "\n";
}

constexpr const char* kNotes = R"(
corvid ms   all of it: template, denominators, correlation, waiting. The image is on the device
            already (upload ms is extra) and was never correlated before; scores stay on the device,
            peaks come back.
kept ms     the same with the denominators that the matcher keeps of an image, where it does
OpenCV ms   windows one by one, spread over all cores; dense as matchTemplate uses them
GFLOP/s     2 x template pixels x coefficients / time: numerators only, the rest counts as overhead
of peak     GFLOP/s over the peak. It can exceed 100 %: on a CPU 8-bit images are correlated by 16-bit
            integer products, of which a vector holds twice as many as of single precision.
)";

template <class T>
Json number(const std::optional<T>& value) {
  return value ? Json(*value) : Json();
}
Json side(int pixels) { return pixels > 0 ? Json(pixels) : Json(); }

Json to_json(const NccReport& report, const NccRow& row) {
  const bool correlates = row.coefficients > 0;
  Json json = {{"table", to_string(row.table)},
               {"name", row.name},
               {"template_px", side(row.template_width_px)},
               {"template_height_px", side(row.template_height_px)},
               {"image_px", row.image_width_px},
               {"image_height_px", row.image_height_px},
               {"runs", row.runs},
               {"corvid_ms", row.corvid.median_ms},
               {"corvid_fastest_ms", row.corvid.fastest_ms},
               {"corvid_cpu_ms", row.corvid.cpu_ms}};
  json["corvid_kept_ms"] = number(row.kept_ms);
  json["upload_ms"] = number(row.upload_ms);
  json["opencv_ms"] = number(milliseconds(row.opencv));
  json["opencv_fastest_ms"] = row.opencv ? Json(row.opencv->fastest_ms) : Json();
  json["opencv_cpu_ms"] = row.opencv ? Json(row.opencv->cpu_ms) : Json();
  json["ratio"] = number(row.ratio());
  json["coefficients"] = correlates ? Json(row.coefficients) : Json();
  json["gcoefficients_per_s"] = correlates ? Json(row.gcoefficients_per_s()) : Json();
  json["gflops"] = correlates ? Json(row.gflops()) : Json();
  json["share_of_peak"] = number(share_of_peak(report, row));
  json["share_of_dense"] = number(row.share_of_dense);
  json["largest_difference"] = number(row.largest_difference);
  json["device"] = report.machine.device;
  json["cores"] = report.machine.cores;
  json["load_average"] = report.machine.load_average;
  json["peak_gflops"] = report.peak_gflops;
  json["copy_gbytes_s"] = report.copy_gbytes_s;
  return json;
}

}  // namespace

std::string_view to_string(NccTable table) {
  switch (table) {
    case NccTable::dense:
      return "dense";
    case NccTable::strips:
      return "strips";
    case NccTable::windows:
      return "windows";
    case NccTable::flavours:
      return "flavours";
    case NccTable::features:
      return "features";
  }
  return "?";
}

std::optional<double> NccRow::ratio() const {
  if (!opencv || corvid.median_ms <= 0) return std::nullopt;
  return opencv->median_ms / corvid.median_ms;
}
double NccRow::gcoefficients_per_s() const {
  return corvid.median_ms > 0 ? coefficients / corvid.median_ms * 1e-6 : 0;
}
double NccRow::gflops() const {
  return 2.0 * template_width_px * template_height_px * gcoefficients_per_s();
}

std::vector<std::string> disagreements(const NccReport& report) {
  std::vector<std::string> found;
  for (const NccRow& row : report.rows) {
    if (!row.largest_difference || *row.largest_difference <= kLargestDifference) continue;
    found.push_back(fmt::format("{}: {}: a coefficient differs by {:.3g} from OpenCV's",
                                to_string(row.table), row.name, *row.largest_difference));
  }
  return found;
}

void print(const NccReport& report, std::ostream& out) {
  print_head(report, out);
  for (const NccTable table : kNccTables) {
    bool titled = false;
    for (const NccRow& row : report.rows) {
      if (row.table != table) continue;
      if (!titled) print_title(table, out);
      titled = true;
      print_row(report, row, out);
    }
  }
  if (report.rows.empty()) {
    out << "\nNothing was measured to its end.\n";
  } else {
    out << kNotes;
  }
}

std::string json_rows(const NccReport& report) {
  std::string text = "[";
  for (const NccRow& row : report.rows) {
    text += text.size() > 1 ? ",\n " : "\n ";
    text += to_json(report, row).dump(-1, ' ', false, Json::error_handler_t::replace);
  }
  return text + "\n]\n";
}

}  // namespace corvid
