#include "bench/matching/matching_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <ostream>

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;
using Number = std::optional<double>;

Number ratio(Number over, Number under) {
  return over && under && *under > 0 ? Number(*over / *under) : std::nullopt;
}
Number per_pair(const PairFigures& figures) {
  return figures.pairs > 0 ? Number(static_cast<double>(figures.matches) / figures.pairs)
                           : std::nullopt;
}
Number milliseconds(const PairFigures& figures) {
  return figures.pairs > 0 ? Number(figures.ms) : std::nullopt;
}
Number slowest(const PairFigures& figures) {
  return figures.pairs > 0 ? Number(figures.slowest_ms) : std::nullopt;
}

std::string cell(const Number& value, int width, int digits) {
  return value ? fmt::format("{:>{}.{}f}", *value, width, digits)
               : fmt::format("{:>{}}", "-", width);
}
void line(const std::string& what, Number sift, Number corvid, Number ratio, int digits,
          std::ostream& out) {
  out << fmt::format("  {:<46} {} {} {}\n", what, cell(sift, 11, digits), cell(corvid, 11, digits),
                     cell(ratio, 8, 2));
}

void print_head(const MatchingReport& report, std::ostream& out) {
  print_machine(report.machine, out);
  out << fmt::format("runs      {} of each work, SIFT and Corvid in turn pair by pair; medians\n",
                     report.runs);
}

void print_row(const MatchingRow& row, std::ostream& out) {
  const SideFigures &s = row.sift, &c = row.corvid;
  out << fmt::format("\n{}: {} images of {}x{}, {} pairs\n", row.set, row.images, row.width_px,
                     row.height_px, s.all.pairs);
  out << fmt::format("  {:<46} {:>11} {:>11} {:>8}\n", "", "SIFT", "Corvid", "ratio");
  line("2-d matches", s.all.matches, c.all.matches, row.matches_ratio(), 0, out);
  line("  per pair, gap 1", per_pair(s.gap1), per_pair(c.gap1),
       ratio(per_pair(c.gap1), per_pair(s.gap1)), 0, out);
  line("  per pair, gap 2", per_pair(s.gap2), per_pair(c.gap2),
       ratio(per_pair(c.gap2), per_pair(s.gap2)), 0, out);
  line("3-d points", s.points, c.points, row.points_ratio(), 0, out);
  line("  images per point", s.images_per_point, c.images_per_point, {}, 2, out);
  line("  matches in them, per hundred", s.used_percent, c.used_percent, {}, 1, out);
  line("  images with a pose", s.posed_images, c.posed_images, {}, 0, out);
  line("mean squared reprojection error [px^2]", s.mse_px2, c.mse_px2, row.mse_ratio(), 4, out);
  line("median distance to the true line [px]", s.all.truth_px, c.all.truth_px,
       ratio(c.all.truth_px, s.all.truth_px), 3, out);
  line("  gap 1", s.gap1.truth_px, c.gap1.truth_px, ratio(c.gap1.truth_px, s.gap1.truth_px), 3,
       out);
  line("  gap 2", s.gap2.truth_px, c.gap2.truth_px, ratio(c.gap2.truth_px, s.gap2.truth_px), 3,
       out);
  line("wrong (> 3 px) per hundred matches", s.all.wrong_percent, c.all.wrong_percent,
       ratio(c.all.wrong_percent, s.all.wrong_percent), 2, out);
  line("time per pair [ms] (ratio: times as fast)", milliseconds(s.all), milliseconds(c.all),
       row.time_ratio(), 1, out);
  line("  slowest pair", slowest(s.all), slowest(c.all), ratio(slowest(s.all), slowest(c.all)), 1,
       out);
}

void print_summary(const MatchingReport& report, std::ostream& out) {
  std::size_t width = 10;
  for (const MatchingRow& row : report.rows) width = std::max(width, row.set.size());
  out << fmt::format("\n{:<{}} {:>9} {:>9} {:>9} {:>9} {:>9}\n", "ratios", width, "matches",
                     "points", "error", "truth", "speed");
  for (const MatchingRow& row : report.rows) {
    out << fmt::format("{:<{}} {} {} {} {} {}\n", row.set, width, cell(row.matches_ratio(), 9, 2),
                       cell(row.points_ratio(), 9, 2), cell(row.mse_ratio(), 9, 2),
                       cell(ratio(row.corvid.all.truth_px, row.sift.all.truth_px), 9, 2),
                       cell(row.time_ratio(), 9, 2));
  }
}

constexpr const char* kNotes = R"(
SIFT      OpenCV's defaults, two nearest by brute force, ratio 0.8, RANSAC for F (1 px); matches are
          its inliers. Corvid: pair matching from nothing. Ratios: Corvid over SIFT, speed the other
          way round. Gap 2: next-but-one images.
time      two detections (preparations) and the match, all cores, native size
3-d, error  after the same bundle adjustment of either side's tracks; the error is the mean over pair
          correspondences of both images' squared errors. Tracks seen in more images have more of it.
)";

template <class T>
Json number(const std::optional<T>& value) {
  return value ? Json(*value) : Json();
}

Json gap_json(int gap, const PairFigures& sift, const PairFigures& corvid) {
  return {{"gap", gap},
          {"pairs", sift.pairs},
          {"sift_matches", sift.matches},
          {"corvid_matches", corvid.matches},
          {"sift_truth_px", number(sift.truth_px)},
          {"corvid_truth_px", number(corvid.truth_px)},
          {"sift_wrong_percent", number(sift.wrong_percent)},
          {"corvid_wrong_percent", number(corvid.wrong_percent)},
          {"sift_ms", number(milliseconds(sift))},
          {"corvid_ms", number(milliseconds(corvid))}};
}

Json to_json(const MatchingReport& report, const MatchingRow& row) {
  const SideFigures &s = row.sift, &c = row.corvid;
  return {{"set", row.set},
          {"pairs", s.all.pairs},
          {"sift_matches", s.all.matches},
          {"corvid_matches", c.all.matches},
          {"sift_points", s.points},
          {"corvid_points", c.points},
          {"sift_mse_px2", number(s.mse_px2)},
          {"corvid_mse_px2", number(c.mse_px2)},
          {"sift_truth_px", number(s.all.truth_px)},
          {"corvid_truth_px", number(c.all.truth_px)},
          {"sift_wrong_percent", number(s.all.wrong_percent)},
          {"corvid_wrong_percent", number(c.all.wrong_percent)},
          {"sift_ms", number(milliseconds(s.all))},
          {"corvid_ms", number(milliseconds(c.all))},
          {"sift_slowest_ms", number(slowest(s.all))},
          {"corvid_slowest_ms", number(slowest(c.all))},
          {"matches_ratio", number(row.matches_ratio())},
          {"points_ratio", number(row.points_ratio())},
          {"mse_ratio", number(row.mse_ratio())},
          {"time_ratio", number(row.time_ratio())},
          {"images", row.images},
          {"width_px", row.width_px},
          {"height_px", row.height_px},
          {"sift_posed_images", s.posed_images},
          {"corvid_posed_images", c.posed_images},
          {"sift_images_per_point", number(s.images_per_point)},
          {"corvid_images_per_point", number(c.images_per_point)},
          {"sift_used_percent", number(s.used_percent)},
          {"corvid_used_percent", number(c.used_percent)},
          {"gaps", Json::array({gap_json(1, s.gap1, c.gap1), gap_json(2, s.gap2, c.gap2)})},
          {"runs", report.runs},
          {"device", report.machine.device},
          {"cores", report.machine.cores},
          {"load_average", report.machine.load_average}};
}

}  // namespace

Number MatchingRow::matches_ratio() const { return ratio(corvid.all.matches, sift.all.matches); }
Number MatchingRow::points_ratio() const { return ratio(corvid.points, sift.points); }
Number MatchingRow::mse_ratio() const { return ratio(corvid.mse_px2, sift.mse_px2); }
Number MatchingRow::time_ratio() const {
  return ratio(milliseconds(sift.all), milliseconds(corvid.all));
}

void print(const MatchingReport& report, std::ostream& out) {
  print_head(report, out);
  for (const MatchingRow& row : report.rows) print_row(row, out);
  if (report.rows.empty()) {
    out << "\nNothing was measured to its end.\n";
    return;
  }
  print_summary(report, out);
  out << kNotes;
}

std::string json_rows(const MatchingReport& report) {
  std::string text = "[";
  for (const MatchingRow& row : report.rows) {
    text += text.size() > 1 ? ",\n " : "\n ";
    text += to_json(report, row).dump(-1, ' ', false, Json::error_handler_t::replace);
  }
  return text + "\n]\n";
}

}  // namespace corvid
