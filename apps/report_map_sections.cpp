// The report's sections about the map: landmarks, depth maps, mesh.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "apps/plot.h"
#include "apps/report.h"
#include "apps/report_page.h"
#include "apps/report_pictures.h"
#include "io/undistort.h"

namespace corvid {
namespace {

constexpr int kPictureWidth = 560;         ///< of depth maps and photographs [px]
constexpr std::size_t kDepthPictures = 4;  ///< depth maps shown

std::vector<Pose> camera_poses(const RunResult& result) {
  std::vector<Pose> out;
  if (result.map) {
    for (const auto& keyframe : result.map->keyframes) out.push_back(keyframe->T_world_camera);
  }
  if (out.empty()) {
    for (const StampedPose& p : result.trajectory) out.push_back(p.T_world_camera);
  }
  return out;
}

std::vector<Pose> path_poses(const RunResult& result) {
  std::vector<Pose> out;
  for (const StampedPose& p : result.trajectory) out.push_back(p.T_world_camera);
  return out;
}

const Keyframe* find_keyframe(const RunResult& result, KeyframeId id) {
  if (!result.map) return nullptr;
  for (const auto& keyframe : result.map->keyframes) {
    if (keyframe->id == id) return keyframe.get();
  }
  return nullptr;
}

/// The keyframe's photograph, undistorted as renders and depth maps are.
std::string photo_of(const Keyframe& keyframe, const Undistorter& undistort) {
  const FramePtr frame = keyframe.frame ? keyframe.frame->load() : nullptr;
  const Camera& camera = undistort.camera();
  if (!frame || frame->grey.width() != camera.width_px ||
      frame->grey.height() != camera.height_px) {
    return {};
  }
  const ColourImage image =
      frame->colour.empty() ? grey_as_colour(undistort(frame->grey)) : undistort(frame->colour);
  return html_photo(fmt::format("Keyframe {}", keyframe.id.value), frame->name,
                    shrink(image, kPictureWidth));
}

/// The same view with a picture `width_px` wide.
Camera resized(const Camera& camera, int width_px) {
  const double scale = static_cast<double>(width_px) / camera.width_px;
  Camera out = camera;
  out.width_px = width_px;
  out.height_px = std::max(1, static_cast<int>(std::lround(camera.height_px * scale)));
  out.fx_px *= scale;
  out.fy_px *= scale;
  out.cx_px = (camera.cx_px + 0.5) * scale - 0.5;
  out.cy_px = (camera.cy_px + 0.5) * scale - 0.5;
  return out;
}

}  // namespace

std::string map_section(const ReportFacts& facts) {
  const RunResult& result = facts.input.result;
  const RunNumbers& n = facts.numbers;
  if (!result.map || result.map->landmarks.empty()) {
    return html_section("map", "Sparse map", html_nothing("There are no landmarks."));
  }
  const ViewAxes axes = guess_axes(path_poses(result));
  std::vector<PlotSeries> series(2);
  series[0] = {"camera", {}, 0, PlotSeries::Style::line};
  series[1] = {"keyframes", {}, 1, PlotSeries::Style::points};
  for (const StampedPose& p : result.trajectory) {
    series[0].points.push_back(axes.top(p.T_world_camera.translation()));
  }
  for (const auto& keyframe : result.map->keyframes) {
    series[1].points.push_back(axes.top(keyframe->T_world_camera.translation()));
  }
  std::vector<Eigen::Vector2d> path = series[0].points;
  path.insert(path.end(), series[1].points.begin(), series[1].points.end());
  const auto picture = picture_of_landmarks(result.map->landmarks, path, axes);
  PlotOptions options;
  options.title = "Landmarks from above";
  options.x_label = fmt::format("{} [{}]", axes.right_name, unit_of(result));
  options.y_label = fmt::format("{} [{}]", axes.forward_name, unit_of(result));
  options.width_px = 1140;
  options.equal_axes = true;
  std::string html = svg_plot(options, series, {}, picture ? &*picture : nullptr);
  html += fmt::format(
      "<p class=\"note\">{} landmarks in {} keyframes, {} observations ({} per landmark). The "
      "middle "
      "98 % are shown.</p>\n",
      format_count(n.landmarks), format_count(n.keyframes), format_count(n.observations),
      format_number(static_cast<double>(n.observations) / static_cast<double>(n.landmarks)));
  return html_section("map", "Sparse map", html);
}

std::string depth_section(const ReportFacts& facts) {
  const RunResult& result = facts.input.result;
  const RunNumbers& n = facts.numbers;
  std::vector<const StoredDepth*> maps, answered;
  for (const StoredDepth& stored : result.depth_maps) {
    const auto map = stored.scaled();
    if (map->depth.empty()) continue;
    maps.push_back(&stored);
    const float* end = map->depth.data() + map->depth.size();
    if (std::any_of(map->depth.data(), end, [](float z) { return z > 0; }))
      answered.push_back(&stored);
  }
  if (!answered.empty()) maps = answered;  // empty ones are counted, but there is nothing to see
  if (maps.empty()) return html_section("depth", "Depth maps", html_nothing("There are none."));
  std::string html = fmt::format(
      "<p>{} depth maps; {} of the pixels have an answer, with a mean confidence of {}.</p>\n"
      "<p class=\"note\">Depth: near <span class=\"ramp turbo\"></span> far. Confidence: 0 "
      "<span class=\"ramp viridis\"></span> 1. Empty pixels have no answer.</p>\n",
      format_count(n.depth_maps), html_escape(format_percent(n.depth_coverage)),
      format_number(n.depth_confidence));
  std::optional<Undistorter> undistort;
  if (result.map && result.map->camera) undistort.emplace(*result.map->camera);
  for (const std::size_t i : spread_indices(maps.size(), kDepthPictures)) {
    const DepthMap map = maps[i]->load();
    const DepthPicture depth = picture_of_depth(map.depth);
    const std::string name = fmt::format("Keyframe {}", map.keyframe.value);
    html += "<div class=\"trio\">";
    const Keyframe* keyframe = find_keyframe(result, map.keyframe);
    if (keyframe && undistort) html += photo_of(*keyframe, *undistort);
    html += html_picture(name + ", depth",
                         depth.far > 0 ? fmt::format("{} to {} {}", format_number(depth.near),
                                                     format_number(depth.far), unit_of(result))
                                       : std::string("no pixel has an answer"),
                         shrink(depth.picture, kPictureWidth));
    if (!map.confidence.empty()) {
      html += html_picture(name + ", confidence", "",
                           shrink(picture_of_confidence(map.confidence), kPictureWidth));
    }
    html += "</div>\n";
  }
  return html_section("depth", "Depth maps", html);
}

namespace {

/// The surface by graph cut; nothing if there is none.
std::string cut_pictures(const ReportFacts& facts) {
  const SurfaceCut* cut = facts.input.cut;
  if (!cut || cut->mesh.empty()) return {};
  const RunResult& result = facts.input.result;
  std::string html = "<div class=\"pair\">";
  for (const MeshView& view :
       outside_views(cut->mesh, guess_axes(path_poses(result)), camera_poses(result), 800, 540)) {
    html += html_picture("Minimal surface, " + view.name, "",
                         render_mesh(cut->mesh, view.camera, view.T_world_camera));
  }
  return html + fmt::format(
                    "</div>\n<p class=\"note\">By graph cut: {} triangles, {} vertices, voxels "
                    "of {} {}.</p>\n",
                    format_count(cut->mesh.triangles.size()),
                    format_count(cut->mesh.vertices.size()), format_number(cut->voxel_size),
                    unit_of(result));
}

}  // namespace

std::string mesh_section(const ReportFacts& facts) {
  const RunResult& result = facts.input.result;
  const RunNumbers& n = facts.numbers;
  if (result.mesh.empty()) {
    return html_section("mesh", "Mesh", html_nothing("There is no mesh.") + cut_pictures(facts));
  }
  const std::vector<Pose> cameras = camera_poses(result);
  const ViewAxes axes = guess_axes(path_poses(result));
  std::string html = "<div class=\"pair\">";
  for (const MeshView& view : outside_views(result.mesh, axes, cameras, 800, 540)) {
    html += html_picture(view.name, "", render_mesh(result.mesh, view.camera, view.T_world_camera));
  }
  // The middle keyframe's own view beside its photograph: what the mesh should look like.
  if (result.map && result.map->camera && !result.map->keyframes.empty()) {
    const Keyframe& keyframe = *result.map->keyframes[result.map->keyframes.size() / 2];
    const Undistorter undistort(*result.map->camera);
    const Camera camera = resized(undistort.camera(), 800);
    html += html_picture(fmt::format("As keyframe {} saw it", keyframe.id.value), "rendered",
                         render_mesh(result.mesh, camera, keyframe.T_world_camera));
    html += photo_of(keyframe, undistort);
  }
  html += "</div>\n";
  std::string text =
      fmt::format("{} triangles, {} vertices, area {} square {}", format_count(n.triangles),
                  format_count(n.vertices), format_number(n.mesh_area), unit_of(result));
  if (result.voxel_size > 0) {
    text += fmt::format(", voxels of {} {}", format_number(result.voxel_size), unit_of(result));
  }
  html += fmt::format("<p class=\"note\">{}. Backs of triangles are drawn dark and bluish.</p>\n",
                      html_escape(text));
  if (const auto& s = facts.input.stream) {
    html += fmt::format(
        "<p class=\"note\">As a stream: {} blocks changed over the run ({} per second). The whole "
        "surface is {} blocks and {}, {} bytes per triangle, {} ms to compress a block; a receiver "
        "that joins late has it after {} s.</p>\n",
        format_count(s->changes), format_number(s->changes_per_s), format_count(s->blocks),
        format_bytes(static_cast<double>(s->bytes)), format_number(s->bytes_per_triangle),
        format_number(s->encode_ms), format_number(s->send_s));
  }
  return html_section("mesh", "Mesh", html + cut_pictures(facts));
}

}  // namespace corvid
