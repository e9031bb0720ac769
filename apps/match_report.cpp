#include "apps/match_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>

#include "apps/match_picture.h"
#include "apps/progress.h"
#include "frontend/epipolar.h"

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;

struct Residuals {
  double median_px = 0, p95_px = 0;
};

// Sampson distances of the matches to F; nothing without matches.
std::optional<Residuals> residuals(const MatchRun& run) {
  std::vector<double> distances;
  for (const PairMatch& match : run.pair.matches) {
    const auto r = undistort_pixel(run.views[0].camera, match.x_r);
    const auto t = undistort_pixel(run.views[1].camera, match.x_t);
    if (run.pair.F && r && t) distances.push_back(sampson_distance_px(*run.pair.F, *r, *t));
  }
  if (distances.empty()) return std::nullopt;
  const auto quantile = [&](double share) {
    const auto nth = distances.begin() +
                     static_cast<std::ptrdiff_t>(share * static_cast<double>(distances.size() - 1));
    std::nth_element(distances.begin(), nth, distances.end());
    return *nth;
  };
  return Residuals{quantile(0.5), quantile(0.95)};
}

const char* role(std::size_t i) { return i == 0 ? "reference" : i == 1 ? "target" : "auxiliary"; }

}  // namespace

void print(std::ostream& out, const MatchRun& run) {
  const auto row = [&out](std::string_view name, const std::string& text) {
    out << fmt::format("{:<12} {}\n", name, text);
  };
  const PairMatches& pair = run.pair;
  for (std::size_t i = 0; i < run.images.size(); ++i) {
    const MatchImage& image = run.images[i];
    std::string text = fmt::format("{}: {}x{} px, intrinsics from {}, {} interest points",
                                   image.name, image.grey.width(), image.grey.height(),
                                   to_string(image.intrinsics), run.views[i].points.size());
    if (i >= 2) {
      const PairMatches& other = run.auxiliary[i - 2];
      text += other.F ? fmt::format(", {} matches", other.matches.size())
                      : ", not used: " + other.refusal;
    }
    row(role(i), text);
  }
  row("device", run.device);
  const std::size_t points = run.views[0].points.size();
  if (pair.F) {
    row("matches", fmt::format("{}, {:.1f} % of the reference's points", pair.matches.size(),
                               100.0 * static_cast<double>(pair.matches.size()) /
                                   static_cast<double>(std::max<std::size_t>(points, 1))));
  } else {
    row("matches", "none: no common geometry: " + pair.refusal);
  }
  std::string reasons;
  const auto counts = count_reasons(pair);
  for (std::size_t i = 0; i < counts.size(); ++i) {
    reasons += fmt::format("{}{} {}", i == 0 ? "" : ", ", counts[i], kNoMatchKinds[i].words);
  }
  row("no match", reasons);
  if (pair.F) {
    for (int i = 0; i < 3; ++i) {
      row(i == 0 ? "F" : "", fmt::format("{:>14.6e} {:>14.6e} {:>14.6e}", (*pair.F)(i, 0),
                                         (*pair.F)(i, 1), (*pair.F)(i, 2)));
    }
  }
  if (const auto r = residuals(run)) {
    row("distance", fmt::format("of the matches to F: median {:.3f} px, 95 % within {:.3f} px",
                                r->median_px, r->p95_px));
  }
  if (!pair.disambiguation.runs.empty()) {
    out << fmt::format("\n{:>5}  {:<22} {:>8} {:>8} {:>8} {:>9}\n", "round", "module", "in",
                       "accepted", "rejected", "ms");
    for (const ModuleRun& m : pair.disambiguation.runs) {
      out << fmt::format("{:>5}  {:<22} {:>8} {:>8} {:>8} {:>9.2f}\n", m.round, to_string(m.module),
                         m.counts.in, m.counts.accepted, m.counts.rejected, m.ms);
    }
  }
  out << fmt::format("\n{:<29} {:>9}\n", "step", "ms");
  double total_ms = 0;
  for (const auto& [step, ms] : run.timings) {
    out << fmt::format("{:<29} {:>9.1f}\n", step, ms);
    total_ms += ms;
  }
  out << fmt::format("{:<29} {:>9.1f}\n", "all", total_ms);
}

std::string matches_csv(const PairMatches& pair) {
  std::string text = "x_r,y_r,x_t,y_t,score,covariance_xx,covariance_xy,covariance_yy\n";
  for (const PairMatch& m : pair.matches) {
    const Eigen::Matrix2d& c = m.covariance_px2;
    fmt::format_to(std::back_inserter(text),
                   "{:.4f},{:.4f},{:.4f},{:.4f},{:.5f},{:.6g},{:.6g},{:.6g}\n", m.x_r.x(),
                   m.x_r.y(), m.x_t.x(), m.x_t.y(), m.score, c(0, 0), c(0, 1), c(1, 1));
  }
  return text;
}

std::string match_json(const MatchRun& run) {
  const PairMatches& pair = run.pair;
  Json images = Json::array();
  for (std::size_t i = 0; i < run.images.size(); ++i) {
    const MatchImage& image = run.images[i];
    Json json = {{"role", role(i)},
                 {"name", image.name},
                 {"width_px", image.grey.width()},
                 {"height_px", image.grey.height()},
                 {"camera", to_json(image.camera)},
                 {"intrinsics", name_of(image.intrinsics)},
                 {"points", run.views[i].points.size()},
                 {"notes", image.notes}};
    if (i >= 2) json["matches"] = run.auxiliary[i - 2].matches.size();
    images.push_back(std::move(json));
  }
  Json unmatched;
  const auto counts = count_reasons(pair);
  for (std::size_t i = 0; i < counts.size(); ++i) {
    unmatched[std::string(kNoMatchKinds[i].key)] = counts[i];
  }
  Json F;
  if (pair.F) {
    for (int i = 0; i < 3; ++i) F.push_back({(*pair.F)(i, 0), (*pair.F)(i, 1), (*pair.F)(i, 2)});
  }
  Json distance;
  if (const auto r = residuals(run)) distance = {{"median", r->median_px}, {"p95", r->p95_px}};
  Json modules = Json::array(), timings = Json::array();
  for (const ModuleRun& m : pair.disambiguation.runs) {
    modules.push_back({{"round", m.round},
                       {"module", to_string(m.module)},
                       {"in", m.counts.in},
                       {"accepted", m.counts.accepted},
                       {"rejected", m.counts.rejected},
                       {"ms", m.ms}});
  }
  for (const auto& [step, ms] : run.timings) timings.push_back({{"step", step}, {"ms", ms}});
  std::ostringstream text;
  write_json_line(text, {{"version", CORVID_VERSION},
                         {"device", run.device},
                         {"images", images},
                         {"matches", pair.matches.size()},
                         {"unmatched", unmatched},
                         {"F", F},
                         {"refusal", pair.F ? Json() : Json(pair.refusal)},
                         {"distance_px", distance},
                         {"modules", modules},
                         {"timings", timings}});
  return text.str();
}

}  // namespace corvid
