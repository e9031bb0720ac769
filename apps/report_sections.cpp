// The report's sections about poses and time.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "apps/plot.h"
#include "apps/render_mesh.h"
#include "apps/report.h"
#include "apps/report_page.h"

namespace corvid {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

const Vector2d kBreak = Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());

std::vector<Pose> poses_of(const Trajectory& trajectory) {
  std::vector<Pose> out;
  for (const StampedPose& p : trajectory) out.push_back(p.T_world_camera);
  return out;
}

bool has_truth(const ReportFacts& facts) {
  const auto& e = facts.input.trajectory_errors;
  return e && e->problem.empty() && !e->poses.empty();
}

/// Capture time since the first event, in seconds.
double seconds(const RunResult& result, std::int64_t time_ns) {
  const std::int64_t begin = result.events.empty() ? time_ns : result.events.front().time_ns;
  return static_cast<double>(time_ns - begin) * 1e-9;
}

/// A value per event over time; the line breaks where there is none.
template <class F>
PlotSeries over_time(const RunResult& result, std::string name, int colour, F value) {
  PlotSeries series{std::move(name), {}, colour, PlotSeries::Style::line};
  bool any = false;
  for (const PoseEvent& e : result.events) {
    const std::optional<double> v = value(e);
    any = any || v;
    series.points.push_back(v ? Vector2d(seconds(result, e.time_ns), *v) : kBreak);
  }
  if (!any) series.points.clear();
  return series;
}

PlotOptions time_plot(const RunNumbers& numbers, std::string title, std::string y_label) {
  PlotOptions options;
  if (numbers.capture_s > 0) options.x_range = Vector2d(0, numbers.capture_s);
  options.title = std::move(title);
  options.x_label = "time [s]";
  options.y_label = std::move(y_label);
  options.width_px = 560;
  options.height_px = 230;
  return options;
}

std::string pair(const std::string& a, const std::string& b) {
  return "<div class=\"pair\">" + a + b + "</div>\n";
}

/// Rows of a table of errors.
std::vector<TableCell> statistics_row(const char* name, const char* unit, const Statistics& s) {
  return {{name, {}},
          {format_number(s.rmse), {}},
          {format_number(s.mean), {}},
          {format_number(s.median), {}},
          {format_number(s.p90), {}},
          {format_number(s.max), {}},
          {unit, {}}};
}

}  // namespace

std::string trajectory_section(const ReportFacts& facts) {
  const RunResult& result = facts.input.result;
  if (result.trajectory.empty()) {
    return html_section("trajectory", "Trajectory", html_nothing("No frame has a pose."));
  }
  const ViewAxes axes = guess_axes(poses_of(result.trajectory));
  std::vector<Vector3d> estimate, truth;
  std::string unit = unit_of(result);
  std::string note = axes.up_name == "up"
                         ? "Up is guessed: the direction that the cameras' x axes keep level to."
                         : "Axes of the first camera: x right, y down, z forward.";
  if (has_truth(facts)) {
    // Drawn in the estimate's axes, so that up stays up, but in the truth's metres.
    const TrajectoryErrors& errors = *facts.input.trajectory_errors;
    const Eigen::Quaterniond R = errors.T_truth_estimate.rotation().conjugate();
    const Vector3d t = errors.T_truth_estimate.translation();
    for (const PosePair& p : errors.poses) {
      truth.push_back(R * (p.truth.translation() - t));
    }
    const double scale = errors.T_truth_estimate.scale();
    for (const StampedPose& p : result.trajectory) {
      estimate.push_back(scale * p.T_world_camera.translation());
    }
    unit = "m";
    note += " The estimate is aligned to the truth (scale " + format_number(scale) + ").";
  } else {
    for (const StampedPose& p : result.trajectory) {
      estimate.push_back(p.T_world_camera.translation());
    }
  }
  const auto plot = [&](const char* title, const std::string& x, const std::string& y,
                        Vector2d (ViewAxes::*project)(const Vector3d&) const) {
    PlotOptions options;
    options.title = title;
    options.x_label = fmt::format("{} [{}]", x, unit);
    options.y_label = fmt::format("{} [{}]", y, unit);
    options.width_px = 560;
    options.equal_axes = true;
    std::vector<PlotSeries> series(3);
    series[0] = {"truth", {}, 1, PlotSeries::Style::dashed};
    series[1] = {"estimate", {}, 0, PlotSeries::Style::line};
    series[2] = {"start", {(axes.*project)(estimate.front())}, 2, PlotSeries::Style::points};
    for (const Vector3d& p : truth) series[0].points.push_back((axes.*project)(p));
    for (const Vector3d& p : estimate) series[1].points.push_back((axes.*project)(p));
    return svg_plot(options, series);
  };
  return html_section(
      "trajectory", "Trajectory",
      pair(plot("From above", axes.right_name, axes.forward_name, &ViewAxes::top),
           plot("From the side", axes.forward_name, axes.up_name, &ViewAxes::side)) +
          fmt::format("<p class=\"note\">{}</p>\n", html_escape(note)));
}

std::string truth_section(const ReportFacts& facts) {
  const char* title = "Errors against truth";
  const auto& errors = facts.input.trajectory_errors;
  const auto& surface = facts.input.surface_errors;
  std::string html;
  if (!errors) html += html_nothing("The source has no true trajectory.");
  if (errors && !errors->problem.empty()) {
    html += html_nothing("The trajectory was not compared: " + errors->problem);
  }
  if (errors && errors->problem.empty()) {
    html += html_table({{""},
                        {"RMSE", true},
                        {"mean", true},
                        {"median", true},
                        {"90 %", true},
                        {"max", true},
                        {"unit"}},
                       {statistics_row("position (ATE)", "m", errors->position_m),
                        statistics_row("orientation", "deg", errors->orientation_deg),
                        statistics_row("relative position (RPE)", "m", errors->rpe_translation_m),
                        statistics_row("relative orientation", "deg", errors->rpe_rotation_deg)});
    std::string text = fmt::format(
        "{} poses compared with the truth, {} without a true pose at their time; "
        "{} m of path; one map unit is {} m",
        format_count(errors->matched), format_count(errors->unmatched),
        format_number(errors->path_length_m), format_number(errors->scale));
    if (errors->scale_drift) {
      text += fmt::format("; scale at the end over scale at the start {}",
                          format_number(*errors->scale_drift, 4));
    }
    text += ".";
    if (errors->kitti.segments > 0) {
      text += fmt::format(" KITTI measure over {} segments{}: {} % of the length, {} deg/100 m.",
                          format_count(errors->kitti.segments),
                          errors->kitti.short_segments ? " (of 10 to 80 m)" : "",
                          format_number(errors->kitti.t_rel_percent),
                          format_number(errors->kitti.r_rel_deg_per_100m));
    }
    html += fmt::format("<p class=\"note\">{}</p>\n", html_escape(text));
    std::vector<PlotSeries> position(1), orientation(1);
    const double gap_s = 3.5 * facts.numbers.capture_s /
                         static_cast<double>(std::max<std::size_t>(facts.numbers.events, 1));
    position[0] = {"position", {}, 0, PlotSeries::Style::line};
    orientation[0] = {"orientation", {}, 0, PlotSeries::Style::line};
    for (std::size_t i = 0; i < errors->poses.size(); ++i) {
      const double t = seconds(facts.input.result, errors->poses[i].time_ns);
      if (i > 0 && t - seconds(facts.input.result, errors->poses[i - 1].time_ns) > gap_s) {
        position[0].points.push_back(kBreak);
        orientation[0].points.push_back(kBreak);
      }
      if (i < errors->position_errors_m.size()) {
        position[0].points.emplace_back(t, errors->position_errors_m[i]);
      }
      if (i < errors->orientation_errors_deg.size()) {
        orientation[0].points.emplace_back(t, errors->orientation_errors_deg[i]);
      }
    }
    html +=
        pair(svg_plot(time_plot(facts.numbers, "Position error", "error [m]"), position),
             svg_plot(time_plot(facts.numbers, "Orientation error", "error [deg]"), orientation));
  }
  if (surface && !surface->problem.empty()) {
    html += html_nothing("The surface was not compared: " + surface->problem);
  }
  if (surface && surface->problem.empty()) {
    std::vector<std::vector<TableCell>> rows = {
        {{"median distance to the true surface", {}},
         {format_number(surface->median_m) + " m", {}}},
        {{"mean distance", {}}, {format_number(surface->mean_m) + " m", {}}},
        {{"RMS distance", {}}, {format_number(surface->rmse_m) + " m", {}}},
        {{"90 % are within", {}}, {format_number(surface->accuracy90_m) + " m", {}}}};
    for (std::size_t i = 0; i < surface->completeness.size(); ++i) {
      rows.push_back({{fmt::format("true surface covered within {} m",
                                   format_number(surface->completeness_distances_m[i], 2)),
                       {}},
                      {format_percent(surface->completeness[i]), {}}});
    }
    html += html_table({{"surface"}, {"", true}}, rows);
  }
  return html_section("truth", title, html);
}

std::string tracking_section(const ReportFacts& facts) {
  const RunResult& result = facts.input.result;
  const RunNumbers& n = facts.numbers;
  if (result.events.empty()) {
    return html_section("tracking", "Tracking", html_nothing("No frame came through."));
  }
  std::vector<PlotBand> bands;
  for (std::size_t i = 0; i < result.events.size(); ++i) {
    const PoseEvent& e = result.events[i];
    const double begin = seconds(result, e.time_ns);
    const double end = i + 1 < result.events.size()
                           ? seconds(result, result.events[i + 1].time_ns)
                           : begin + (i > 0 ? n.capture_s / static_cast<double>(i) : 1);
    const std::string css = "state-" + std::string(to_string(e.state));
    const std::string title =
        std::string(to_string(e.state)) + (e.reason.empty() ? "" : ": " + e.reason);
    if (!bands.empty() && bands.back().css_class == css && bands.back().title == title) {
      bands.back().end = end;
    } else {
      bands.push_back({begin, end, css, title});
    }
  }
  PlotOptions strip = time_plot(n, "State", "");
  strip.width_px = 1140;
  strip.height_px = 78;
  strip.y_axis = false;
  std::string html = svg_plot(strip, {}, bands);
  html += "<p class=\"key\">";
  for (std::size_t i = 0; i < n.states.size(); ++i) {
    const std::string_view name = to_string(static_cast<TrackingState>(i));
    html += fmt::format("<span><i class=\"state-{0}\"></i>{0}: {1}</span>", name,
                        format_count(n.states[i]));
  }
  html += "</p>\n";

  const auto with_pose = [](const PoseEvent& e, double value) {
    return e.T_world_camera ? std::optional<double>(value) : std::nullopt;
  };
  const std::vector<PlotSeries> counts = {
      over_time(result, "tracks", 0,
                [](const PoseEvent& e) -> std::optional<double> { return e.tracks; }),
      over_time(result, "inliers", 1, [&](const PoseEvent& e) { return with_pose(e, e.inliers); })};
  const std::vector<PlotSeries> error = {over_time(result, "error", 0, [&](const PoseEvent& e) {
    return with_pose(e, std::sqrt(std::max(e.mse_px2, 0.0)));
  })};
  html += pair(svg_plot(time_plot(n, "Tracks and inliers per frame", "count"), counts),
               svg_plot(time_plot(n, "Reprojection error of the inliers", "RMS [px]"), error));

  // Reasons, most frequent first.
  std::vector<std::pair<std::string, std::size_t>> reasons;
  for (const PoseEvent& e : result.events) {
    if (e.reason.empty()) continue;
    const auto it = std::find_if(reasons.begin(), reasons.end(),
                                 [&](const auto& r) { return r.first == e.reason; });
    if (it != reasons.end()) {
      ++it->second;
    } else if (reasons.size() < 200) {  // reasons with numbers in them differ every time
      reasons.emplace_back(e.reason, 1);
    }
  }
  std::stable_sort(reasons.begin(), reasons.end(),
                   [](const auto& a, const auto& b) { return a.second > b.second; });
  if (!reasons.empty()) {
    std::vector<std::vector<TableCell>> rows;
    for (std::size_t i = 0; i < reasons.size() && i < 12; ++i) {
      rows.push_back({{reasons[i].first, {}}, {format_count(reasons[i].second), {}}});
    }
    html += html_table({{"reason given for a state"}, {"frames", true}}, rows);
  }
  return html_section("tracking", "Tracking", html);
}

std::string timing_section(const ReportFacts& facts) {
  const RunResult& result = facts.input.result;
  double longest = 0;
  for (const StageMetrics& s : result.stages) longest = std::max(longest, s.total_s);
  std::vector<std::vector<TableCell>> rows;
  for (const StageMetrics& s : result.stages) {
    const double share = longest > 0 ? s.total_s / longest : 0;
    rows.push_back({{s.name, {}},
                    {format_count(s.count), {}},
                    {format_number(s.median_ms), {}},
                    {format_number(s.p95_ms), {}},
                    {format_number(s.p99_ms), {}},
                    {format_number(s.total_s), {}},
                    {"", fmt::format("<span class=\"bar\" style=\"width:{:.0f}px\"></span>",
                                     120 * std::clamp(share, 0.0, 1.0))}});
  }
  std::string html = rows.empty() ? html_nothing("No stage was measured.")
                                  : html_table({{"stage"},
                                                {"runs", true},
                                                {"median [ms]", true},
                                                {"95 % [ms]", true},
                                                {"99 % [ms]", true},
                                                {"total [s]", true},
                                                {""}},
                                               rows);
  const std::vector<PlotSeries> latency = {
      over_time(result, "latency", 0, [](const PoseEvent& e) -> std::optional<double> {
        return e.latency_ms > 0 ? std::optional(e.latency_ms) : std::nullopt;
      })};
  PlotOptions options =
      time_plot(facts.numbers, "Latency, from a frame's arrival to its pose", "latency [ms]");
  options.width_px = 1140;
  html += "<p></p>" + svg_plot(options, latency);
  return html_section("timing", "Timing", html);
}

std::string frames_section(const ReportFacts& facts) {
  const SourceCounts& counts = facts.input.result.counts;
  std::string html = html_table(
      {{"frames"}, {"", true}},
      {{{"delivered", {}}, {format_count(counts.delivered), {}}},
       {{"skipped (could not be read)", {}}, {format_count(counts.skipped), {}}},
       {{"dropped (came too late)", {}}, {format_count(counts.dropped), {}}},
       {{"lost (counted by the camera, never came)", {}}, {format_count(counts.lost), {}}},
       {{"times that the camera was away", {}}, {format_count(counts.interruptions), {}}}});
  if (!counts.messages.empty()) {
    html += "<p></p>" + html_list(counts.messages);
    if (counts.messages.size() < counts.skipped) {
      html += html_nothing("Only the first messages are kept.");
    }
  }
  return html_section("frames", "Frames that did not come through", html);
}

}  // namespace corvid
