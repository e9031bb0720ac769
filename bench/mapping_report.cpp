#include "bench/mapping_report.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <ostream>

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;

template <class T>
std::string text(const std::optional<T>& value, const char* format) {
  return value ? fmt::format(fmt::runtime(format), *value) : "-";
}
std::string percent(const std::optional<double>& share) {
  return share ? fmt::format("{:.1f} %", 100 * *share) : "-";
}
template <class T>
Json number(const std::optional<T>& value) {
  return value ? Json(*value) : Json();
}

constexpr const char* kNotes = R"(
rays        of one view
depths      samples along a ray
processor   mean processor time, all threads: little of it depends on other load
of peak     the weighted sums' arithmetic (12 operations per template side and coefficient) of the
            coefficients that were computed, over the peak measured beside it
within      of the answers, relative to the true depth
)";

}  // namespace

void print(const MappingReport& report, std::ostream& out) {
  print_machine(report.machine, out);
  if (report.peak_gflops > 0)
    out << fmt::format("peak, measured: {:.0f} GFLOP/s\n", report.peak_gflops);
  out << fmt::format("\n{:<34} {:>8} {:>5} {:>6} {:>9} {:>9} {:>8} {:>9} {:>8} {:>8} {:>9}\n",
                     "workload", "rays", "views", "depths", "seconds", "processor", "of peak",
                     "answered", "in 1 %", "in 2 %", "error [m]");
  for (const MappingRow& row : report.rows) {
    out << fmt::format("{:<34} {:>8} {:>5} {:>6} {:>9} {:>9} {:>8} {:>9} {:>8} {:>8} {:>9}\n",
                       row.workload, text(row.rays, "{:.0f}"), text(row.views, "{}"),
                       text(row.depths, "{}"), text(row.seconds, "{:.3f}"),
                       text(row.cpu_s, "{:.3f}"), percent(row.share_of_peak), percent(row.answered),
                       percent(row.within_1), percent(row.within_2),
                       text(row.median_error_m, "{:.4f}"));
    if (row.voxels)
      out << fmt::format(
          "  {:.1f} million voxels, graph {} s, maximum flow {} s, peak {} MB, {} sides of faces "
          "without partner\n",
          *row.voxels * 1e-6, text(row.graph_s, "{:.2f}"), text(row.maxflow_s, "{:.2f}"),
          text(row.peak_mb, "{:.0f}"), text(row.unpaired_sides, "{:.0f}"));
  }
  if (report.rows.empty()) {
    out << "\nNothing was measured.\n";
  } else {
    out << kNotes;
  }
}

std::string json_rows(const MappingReport& report) {
  std::string text = "[";
  for (const MappingRow& row : report.rows) {
    const Json json = {{"workload", row.workload},
                       {"rays", number(row.rays)},
                       {"views", number(row.views)},
                       {"depths", number(row.depths)},
                       {"seconds", number(row.seconds)},
                       {"cpu_s", number(row.cpu_s)},
                       {"share_of_peak", number(row.share_of_peak)},
                       {"answered", number(row.answered)},
                       {"within_1", number(row.within_1)},
                       {"within_2", number(row.within_2)},
                       {"median_error_m", number(row.median_error_m)},
                       {"voxels", number(row.voxels)},
                       {"graph_s", number(row.graph_s)},
                       {"maxflow_s", number(row.maxflow_s)},
                       {"peak_mb", number(row.peak_mb)},
                       {"unpaired_sides", number(row.unpaired_sides)},
                       {"peak_gflops", report.peak_gflops},
                       {"device", report.machine.device},
                       {"cores", report.machine.cores},
                       {"load_average", report.machine.load_average}};
    text += text.size() > 1 ? ",\n " : "\n ";
    text += json.dump(-1, ' ', false, Json::error_handler_t::replace);
  }
  return text + "\n]\n";
}

}  // namespace corvid
