#include "apps/mvs_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <vector>

#include "apps/render_mesh.h"
#include "apps/report_page.h"
#include "apps/report_pictures.h"
#include "apps/report_style.h"
#include "mapping/cut_mesh.h"

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;
constexpr std::size_t kPictures = 8;
constexpr int kPictureWidth_px = 360;

double agreed_share(const StillDepth& depth) {
  if (depth.seen_by.size() == 0) return 0;
  const std::uint8_t* const data = depth.seen_by.data();
  return static_cast<double>(std::count_if(data, data + depth.seen_by.size(),
                                           [](std::uint8_t n) { return n >= 3; })) /
         static_cast<double>(depth.seen_by.size());
}

std::string table(const MvsRun& run) {
  std::vector<std::vector<TableCell>> rows;
  for (std::size_t i = 0; i < run.depths.size(); ++i) {
    const StillDepth& d = run.depths[i];
    rows.push_back(
        {{run.views[i].frame->name, {}},
         {std::to_string(d.neighbours), {}},
         {d.refusal.empty() ? std::to_string(d.samples) : "", {}},
         {d.refusal.empty() ? fmt::format("{:.4g} to {:.4g}", d.interval.near, d.interval.far) : "",
          {}},
         {d.refusal.empty() ? format_percent(d.answered) : d.refusal, {}},
         {d.refusal.empty() ? format_percent(agreed_share(d)) : "", {}}});
  }
  return html_table({{"view"},
                     {"neighbours", true},
                     {"depths", true},
                     {"interval [map units]", true},
                     {"answered", true},
                     {"agreed by 3 views", true}},
                    rows);
}

std::string pictures(const MvsRun& run) {
  std::vector<std::size_t> with_depth;
  for (std::size_t i = 0; i < run.depths.size(); ++i)
    if (run.depths[i].refusal.empty()) with_depth.push_back(i);
  if (with_depth.empty()) return html_nothing("No view has depth.");
  std::string html;
  for (const std::size_t k : spread_indices(with_depth.size(), kPictures)) {
    const std::size_t i = with_depth[k];
    const Frame& frame = *run.views[i].frame;
    const DepthPicture depth = picture_of_depth(run.depths[i].map.depth);
    html += html_photo(
        frame.name, "",
        shrink(frame.colour.empty() ? grey_as_colour(frame.grey) : frame.colour, kPictureWidth_px));
    html +=
        html_picture("depth", fmt::format("{:.4g} (red) to {:.4g} (blue)", depth.near, depth.far),
                     shrink(depth.picture, kPictureWidth_px));
    html +=
        html_picture("confidence", "0 (dark) to 1 (yellow)",
                     shrink(picture_of_confidence(run.depths[i].map.confidence), kPictureWidth_px));
  }
  return html;
}

std::string surface(const MvsRun& run) {
  if (!run.surface) {
    return html_nothing(run.no_surface.empty() ? "None was asked for." : run.no_surface);
  }
  const SurfaceCut& cut = *run.surface;
  const SurfaceCutStatistics& s = cut.statistics;
  const std::size_t unpaired = unpaired_sides(cut.mesh);
  std::string html = html_table(
      {{"what"}, {"value", true}},
      {{{"triangles", {}}, {format_count(cut.mesh.triangles.size()), {}}},
       {{"closed", {}},
        {unpaired == 0 ? "yes" : fmt::format("no: {} sides without partner", unpaired), {}}},
       {{"voxel [map units]", {}}, {format_number(cut.voxel_size), {}}},
       {{"voxels of the volume", {}}, {format_count(s.voxels), {}}},
       {{"near points", {}}, {format_count(s.crust_voxels), {}}},
       {{"graph [s]", {}}, {fmt::format("{:.2f}", s.graph_s), {}}},
       {{"maximum flow [s]", {}}, {fmt::format("{:.2f}", s.maxflow_s), {}}},
       {{"peak memory of both", {}}, {format_bytes(static_cast<double>(s.peak_bytes)), {}}}});
  std::vector<Pose> cameras;
  for (const StillView& view : run.views) cameras.push_back(view.T_world_camera);
  html += "<div class=\"pair\">";
  for (const MeshView& view : outside_views(cut.mesh, guess_axes(cameras), cameras, 800, 540)) {
    html += html_picture(view.name, "", render_mesh(cut.mesh, view.camera, view.T_world_camera));
  }
  const StillDepth* seen = nullptr;
  for (const StillDepth& d : run.depths) {
    if (d.refusal.empty() && !seen) seen = &d;
  }
  if (seen) {
    html += html_picture("As the first view with depth saw it", "rendered",
                         render_mesh(cut.mesh, seen->map.camera, seen->map.T_world_camera));
  }
  return html + "</div>\n";
}

}  // namespace

std::string mvs_html(const MvsRun& run) {
  const auto maps = static_cast<std::size_t>(std::count_if(
      run.depths.begin(), run.depths.end(), [](const StillDepth& d) { return d.refusal.empty(); }));
  return fmt::format(
      "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">"
      "<title>Depth of stills</title><style>{}</style></head><body><main><h1>Depth of stills</h1>"
      "{}{}{}{}</main></body></html>\n",
      kReportStyle,
      html_section(
          "numbers", "Numbers",
          html_table({{"what"}, {"value", true}},
                     {{{"source", {}}, {run.source, {}}},
                      {{"device", {}}, {run.device, {}}},
                      {{"version", {}}, {run.version, {}}},
                      {{"views", {}}, {format_count(run.depths.size()), {}}},
                      {{"with depth", {}}, {format_count(maps), {}}},
                      {{"points that 3 views agree on", {}}, {format_count(run.points), {}}},
                      {{"seconds", {}}, {fmt::format("{:.1f}", run.seconds), {}}}})),
      html_section("surface", "Surface", surface(run)), html_section("views", "Views", table(run)),
      html_section("pictures", "Pictures", pictures(run)));
}

std::string mvs_json(const MvsRun& run) {
  Json views = Json::array();
  for (std::size_t i = 0; i < run.depths.size(); ++i) {
    const StillDepth& d = run.depths[i];
    Json view = {{"name", run.views[i].frame->name}, {"neighbours", d.neighbours}};
    if (d.refusal.empty()) {
      view.update({{"depths", d.samples},
                   {"near", d.interval.near},
                   {"far", d.interval.far},
                   {"answered", d.answered},
                   {"agreed", agreed_share(d)}});
    } else {
      view["refusal"] = d.refusal;
    }
    views.push_back(std::move(view));
  }
  Json surface;
  if (run.surface) {
    const SurfaceCutStatistics& s = run.surface->statistics;
    surface = {{"triangles", run.surface->mesh.triangles.size()},
               {"unpaired_sides", unpaired_sides(run.surface->mesh)},
               {"voxel_size", run.surface->voxel_size},
               {"voxels", s.voxels},
               {"crust_voxels", s.crust_voxels},
               {"graph_s", s.graph_s},
               {"maxflow_s", s.maxflow_s},
               {"peak_mb", 1e-6 * static_cast<double>(s.peak_bytes)}};
  } else if (!run.no_surface.empty()) {
    surface = {{"refusal", run.no_surface}};
  }
  const Json json = {{"source", run.source},     {"version", run.version},
                     {"device", run.device},     {"seconds", run.seconds},
                     {"points", run.points},     {"surface", std::move(surface)},
                     {"views", std::move(views)}};
  return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace corvid
