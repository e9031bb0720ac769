#include "apps/report.h"

#include <fmt/format.h>

#include <cmath>

#include "apps/plot.h"
#include "apps/report_page.h"
#include "apps/report_style.h"

namespace corvid {
namespace {

bool has_truth(const ReportFacts& facts) {
  return facts.input.trajectory_errors && facts.input.trajectory_errors->problem.empty();
}

std::string length_unit(const ReportFacts& facts) {
  return has_truth(facts) ? "m" : unit_of(facts.input.result);
}

std::string title_of(const RunResult& result) {
  std::string path = result.source.path;
  while (path.size() > 1 && path.back() == '/') path.pop_back();
  const std::size_t slash = path.rfind('/');
  if (slash != std::string::npos && slash + 1 < path.size()) path = path.substr(slash + 1);
  return path.empty() ? "Corvid run" : "Corvid run: " + path;
}

std::string tiles(const ReportFacts& facts) {
  const RunNumbers& n = facts.numbers;
  const RunResult& result = facts.input.result;
  std::string out = "<div class=\"tiles\">\n";
  const double share =
      n.events > 0 ? static_cast<double>(n.poses) / static_cast<double>(n.events) : 0;
  out += html_tile("Frames with a pose", n.events > 0 ? format_percent(share) : "–", "",
                   fmt::format("{} of {}, {} of them at once; {} untracked after the start",
                               format_count(n.poses), format_count(n.events),
                               format_count(n.with_pose), format_count(n.untracked_after_start)));
  if (const auto& e = facts.input.trajectory_errors; e && e->problem.empty()) {
    out += html_tile("Trajectory error (ATE)", format_number(e->position_m.rmse), "m RMSE",
                     fmt::format("max {} m, over {} m of path", format_number(e->position_m.max),
                                 format_number(e->path_length_m)));
  }
  if (const auto& e = facts.input.surface_errors; e && e->problem.empty()) {
    out += html_tile("Mesh error", format_number(e->median_m), "m median",
                     fmt::format("90 % within {} m", format_number(e->accuracy90_m)));
  }
  const double scale =
      has_truth(facts) ? facts.input.trajectory_errors->T_truth_estimate.scale() : 1;
  out +=
      html_tile("Path", format_number(n.path_length * scale), length_unit(facts),
                fmt::format("{} poses in {} s", format_count(n.poses), format_number(n.capture_s)));
  out += html_tile("Keyframes", format_count(n.keyframes), "",
                   fmt::format("{} landmarks, {} segment{}", format_count(n.landmarks), n.segments,
                               n.segments == 1 ? "" : "s"));
  out += html_tile("Mesh", format_count(n.triangles), "triangles",
                   fmt::format("from {} depth maps", format_count(n.depth_maps)));
  const std::string realtime =
      n.realtime_factor > 0 ? fmt::format(", {}× real time", format_number(n.realtime_factor)) : "";
  out += html_tile("Speed", format_number(n.frames_per_s), "frames/s",
                   fmt::format("{} s of wall time{}", format_number(result.wall_s), realtime));
  out += html_tile("Latency", format_number(n.latency_ms.median), "ms median",
                   fmt::format("95 % {} ms, 99 % {} ms", format_number(n.latency_ms.p95),
                               format_number(n.latency_ms.p99)));
  out += html_tile("Peak memory",
                   result.peak_memory_bytes > 0
                       ? format_bytes(static_cast<double>(result.peak_memory_bytes))
                       : "–",
                   "",
                   facts.machine.memory_bytes > 0
                       ? "of " + format_bytes(static_cast<double>(facts.machine.memory_bytes))
                       : "");
  return out + "</div>\n";
}

std::string notes_section(const ReportFacts& facts) {
  std::vector<std::string> notes = facts.input.result.notes;
  for (const std::string& note : facts.input.result.source.notes) notes.push_back(note);
  if (const auto& e = facts.input.trajectory_errors) {
    notes.insert(notes.end(), e->notes.begin(), e->notes.end());
  }
  return html_section("notes", "Notes", notes.empty() ? html_nothing("None.") : html_list(notes));
}

std::string files_section(const ReportFacts& facts) {
  std::vector<std::vector<TableCell>> rows;
  for (const ReportFile& file : facts.files) {
    rows.push_back(
        {{file.name, {}}, {file.about, {}}, {format_bytes(static_cast<double>(file.bytes)), {}}});
  }
  return html_section("files", "Files",
                      html_table({{"in this folder"}, {"what it is"}, {"size", true}}, rows));
}

std::string run_section(const ReportFacts& facts) {
  const RunResult& result = facts.input.result;
  const SourceInfo& source = result.source;
  std::vector<std::vector<TableCell>> rows;
  const auto add = [&](const char* name, std::string value) {
    if (!value.empty()) rows.push_back({{name, {}}, {std::move(value), {}}});
  };
  add("version", facts.input.version);
  add("command", facts.input.command_line);
  add("source", source.path);
  std::string kind = source.kind;
  if (source.frames) kind += fmt::format(", {} frames", format_count(*source.frames));
  if (source.rate_hz > 0) kind += fmt::format(", {} Hz", format_number(source.rate_hz));
  if (source.stills) kind += ", stills";
  add("kind", kind);
  if (const Camera* camera = source.camera.get()) {
    const char* origin = source.intrinsics == IntrinsicsOrigin::calibration ? "calibrated"
                         : source.intrinsics == IntrinsicsOrigin::exif      ? "from EXIF"
                         : source.intrinsics == IntrinsicsOrigin::nominal   ? "nominal"
                                                                            : "guessed";
    add("camera",
        fmt::format("{} × {} px, {}, fx {} fy {} cx {} cy {} px, {}", camera->width_px,
                    camera->height_px, to_string(camera->model), format_number(camera->fx_px, 5),
                    format_number(camera->fy_px, 5), format_number(camera->cx_px, 5),
                    format_number(camera->cy_px, 5), origin));
  }
  if (result.map && result.map->camera && source.camera && *result.map->camera != *source.camera) {
    add("camera, refined",
        fmt::format("fx {} fy {} px", format_number(result.map->camera->fx_px, 5),
                    format_number(result.map->camera->fy_px, 5)));
  }
  add("OpenCL device", result.device);
  add("processor", facts.machine.cores > 0 ? fmt::format("{} ({} threads)", facts.machine.processor,
                                                         facts.machine.cores)
                                           : facts.machine.processor);
  add("system", facts.machine.system);
  return html_section("machine", "Run and machine", html_table({{""}, {""}}, rows));
}

}  // namespace

std::string report_pictures(const ReportFacts& facts) {
  return mesh_section(facts) + depth_section(facts);
}

std::string report_html(const ReportFacts& facts, const std::string& pictures) {
  const RunResult& result = facts.input.result;
  const std::string title = html_escape(title_of(result));
  std::string body;
  body += fmt::format("<h1>{}</h1>\n<p class=\"sub\">{}{}{}</p>\n", title,
                      html_escape(result.source.kind), result.source.kind.empty() ? "" : " · ",
                      html_escape("corvid " + facts.input.version));
  if (result.interrupted) {
    body +=
        "<p class=\"banner\" id=\"interrupted\">This run was interrupted before its end: "
        "the results are partial.</p>\n";
  }
  if (facts.numbers.poses == 0) {
    body +=
        "<p class=\"banner\" id=\"no-estimate\">No frame has a pose. The states and reasons under "
        "Tracking say why.</p>\n";
  }
  body +=
      "<nav><a href=\"#trajectory\">Trajectory</a>"
      "<a href=\"#truth\">Errors against truth</a><a href=\"#tracking\">Tracking</a>"
      "<a href=\"#mesh\">Mesh</a><a href=\"#depth\">Depth maps</a>"
      "<a href=\"#map\">Sparse map</a><a href=\"#timing\">Timing</a>"
      "<a href=\"#frames\">Frames</a><a href=\"#files\">Files</a>"
      "<a href=\"#options\">Options</a><a href=\"#notes\">Notes</a>"
      "<a href=\"#machine\">Run and machine</a></nav>\n";
  body += tiles(facts);
  body += trajectory_section(facts);
  body += truth_section(facts);
  body += tracking_section(facts);
  body += pictures;
  body += map_section(facts);
  body += timing_section(facts);
  body += frames_section(facts);
  body += files_section(facts);
  body += html_section("options", "Options",
                       fmt::format("<pre>{}</pre>\n", html_escape(facts.options_yaml)));
  body += notes_section(facts);
  body += run_section(facts);
  return fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n"
      "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; "
      "style-src 'unsafe-inline'; img-src data:\"/>\n"
      "<title>{}</title>\n<style>{}</style>\n</head>\n<body>\n<main>\n{}"
      "<footer>The same numbers are in run.json.</footer>\n</main>\n</body>\n</html>\n",
      title, kReportStyle, body);
}

}  // namespace corvid
