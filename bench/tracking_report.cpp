#include "bench/tracking_report.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <ostream>

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;

std::string percent(const std::optional<double>& share) {
  return share ? fmt::format("{:.1f} %", 100 * *share) : "-";
}
std::string pixels(const std::optional<double>& px) {
  return px ? fmt::format("{:.2f} px", *px) : "-";
}
template <class T>
Json number(const std::optional<T>& value) {
  return value ? Json(*value) : Json();
}

constexpr const char* kNotes = R"(
alive       seen in the frame that many frames after their birth
visible     the same, without the tracks whose true point had left the image by then (where truth is
            known and the point can be triangulated; hidden ones count as lost)
to line     median distance to the true epipolar line of the place of birth
to point    median distance to the projection of the point that all places and the true poses give;
            both contain the error of the truth itself
processor   median processor time per frame, all threads: little of it depends on other load
)";

}  // namespace

std::optional<double> TrackAge::share_alive() const {
  if (born == 0) return std::nullopt;
  return static_cast<double>(alive) / born;
}
std::optional<double> TrackAge::share_alive_visible() const {
  if (born == left) return std::nullopt;
  return static_cast<double>(alive) / (born - left);
}

void print(const TrackingReport& report, std::ostream& out) {
  print_machine(report.machine, out);
  for (const TrackingRow& row : report.rows) {
    out << fmt::format("\n{}\n{} frames of {}x{}, {} keyframes; {:.0f} tracks in a frame (of {})\n",
                       row.set, row.frames, row.width_px, row.height_px, row.keyframes, row.tracks,
                       row.max_tracks);
    out << fmt::format(
        "frontend per frame: median {:.1f} ms, 95 % below {:.1f} ms, processor {:.1f} ms\n",
        row.median_ms, row.p95_ms, row.cpu_ms);
    for (const TrackingStep& step : row.steps)
      out << fmt::format("  {:<22} {:>8.2f} ms median in {:>5} frames, {:>8.2f} ms per frame\n",
                         step.name, step.median_ms, step.runs, step.mean_ms);
    out << fmt::format(
        "  per frame: {:.0f} sought, {:.0f} found, {:.0f} recovered, {:.0f} outliers, {:.1f} "
        "merged, {:.0f} new\n",
        row.sought, row.found, row.recovered, row.outliers, row.merged, row.added);
    out << fmt::format("  {:>6} {:>8} {:>9} {:>9} {:>10} {:>10}\n", "after", "born", "alive",
                       "visible", "to line", "to point");
    for (const TrackAge& age : row.ages)
      out << fmt::format("  {:>6} {:>8} {:>9} {:>9} {:>10} {:>10}\n", age.frames, age.born,
                         percent(age.share_alive()),
                         row.has_truth ? percent(age.share_alive_visible()) : "-",
                         pixels(age.epipolar_px), pixels(age.reprojection_px));
  }
  if (report.rows.empty()) {
    out << "\nNothing was measured.\n";
  } else {
    out << kNotes;
  }
}

std::string json_rows(const TrackingReport& report) {
  std::string text = "[";
  for (const TrackingRow& row : report.rows) {
    Json json = {{"set", row.set},
                 {"width_px", row.width_px},
                 {"height_px", row.height_px},
                 {"frames", row.frames},
                 {"keyframes", row.keyframes},
                 {"max_tracks", row.max_tracks},
                 {"tracks", row.tracks},
                 {"median_ms", row.median_ms},
                 {"p95_ms", row.p95_ms},
                 {"cpu_ms", row.cpu_ms},
                 {"sought", row.sought},
                 {"found", row.found},
                 {"recovered", row.recovered},
                 {"outliers", row.outliers},
                 {"merged", row.merged},
                 {"added", row.added}};
    for (const TrackingStep& step : row.steps)
      json["steps"].push_back({{"name", step.name},
                               {"runs", step.runs},
                               {"median_ms", step.median_ms},
                               {"mean_ms", step.mean_ms}});
    for (const TrackAge& age : row.ages)
      json["ages"].push_back(
          {{"frames", age.frames},
           {"born", age.born},
           {"alive", age.alive},
           {"left", row.has_truth ? Json(age.left) : Json()},
           {"share_alive", number(age.share_alive())},
           {"share_alive_visible", row.has_truth ? number(age.share_alive_visible()) : Json()},
           {"epipolar_px", number(age.epipolar_px)},
           {"reprojection_px", number(age.reprojection_px)}});
    json["device"] = report.machine.device;
    json["cores"] = report.machine.cores;
    json["load_average"] = report.machine.load_average;
    text += text.size() > 1 ? ",\n " : "\n ";
    text += json.dump(-1, ' ', false, Json::error_handler_t::replace);
  }
  return text + "\n]\n";
}

}  // namespace corvid
