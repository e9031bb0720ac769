#include "apps/progress.h"

#include <fmt/format.h>

#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>

#include "apps/program_source.h"
#include "apps/talk.h"
#include "core/log.h"

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;
}  // namespace

void draw_progress(const std::string& line) {
  // The program's sink of the library's logger; there is none where a library's user replaced it.
  for (const auto& sink : log().sinks()) {
    if (auto* talk = dynamic_cast<Talk*>(sink.get())) return talk->progress(line);
  }
}

void write_json_line(std::ostream& out, const Json& json) {
  out << json.dump(-1, ' ', false, Json::error_handler_t::replace) << std::endl;
}

Json to_json(const Camera& camera) {
  return {{"model", to_string(camera.model)},
          {"width_px", camera.width_px},
          {"height_px", camera.height_px},
          {"fx_px", camera.fx_px},
          {"fy_px", camera.fy_px},
          {"cx_px", camera.cx_px},
          {"cy_px", camera.cy_px},
          {"distortion", camera.distortion}};
}

Json to_json(const SourceInfo& info) {
  Json json = {{"kind", info.kind}, {"path", info.path}};
  json["frames"] = info.frames ? Json(*info.frames) : Json();
  json["rate_hz"] = info.rate_hz > 0 ? Json(info.rate_hz) : Json();
  json["stills"] = info.stills;
  json["paced"] = info.paced;
  json["colour"] = info.colour;
  json["camera"] = info.camera ? to_json(*info.camera) : Json();
  json["intrinsics"] = name_of(info.intrinsics);
  json["has_depth"] = info.has_depth;
  json["notes"] = info.notes;
  return json;
}

Json to_json(const SourceCounts& counts) {
  return {{"delivered", counts.delivered},
          {"skipped", counts.skipped},
          {"dropped", counts.dropped},
          {"lost", counts.lost},
          {"interruptions", counts.interruptions},
          {"messages", counts.messages}};
}

Json to_json(const GeodeticPosition& position) {
  return {{"latitude_deg", position.latitude_deg},
          {"longitude_deg", position.longitude_deg},
          {"altitude_m", position.altitude_m}};
}

Json to_json(const MapPlacement& placement) {
  Json json = {{"scale", to_string(placement.scale)}};
  if (!placement.reason.empty()) json["reason"] = placement.reason;
  json["positions"] = placement.positions;
  if (placement.scale != MapScale::metric) return json;
  const Sim3& T = placement.T_enu_map;
  const Eigen::Quaterniond& q = T.rotation();
  json["inliers"] = placement.inliers;
  json["rmse_m"] = placement.rmse_m;
  json["metres_per_unit"] = T.scale();
  json["metres_per_unit_sigma"] = T.scale() * std::sqrt(placement.covariance(6, 6));
  json["rotation_xyzw"] = {q.x(), q.y(), q.z(), q.w()};
  json["translation_m"] = {T.translation().x(), T.translation().y(), T.translation().z()};
  json["origin"] = to_json(placement.origin);
  return json;
}

Json to_json(const PoseEvent& event) {
  Json json = {{"event", "pose"},
               {"frame", event.frame.value},
               {"time_ns", event.time_ns},
               {"state", to_string(event.state)}};
  if (!event.reason.empty()) json["reason"] = event.reason;
  if (event.T_world_camera) {
    const Eigen::Vector3d& t = event.T_world_camera->translation();
    const Eigen::Quaterniond& q = event.T_world_camera->rotation();
    json["position"] = {t.x(), t.y(), t.z()};
    json["rotation_xyzw"] = {q.x(), q.y(), q.z(), q.w()};
    Json upper = Json::array();
    for (int row = 0; row < 6; ++row) {
      for (int column = row; column < 6; ++column) upper.push_back(event.covariance(row, column));
    }
    json["covariance_upper"] = std::move(upper);
  }
  json["scale"] = to_string(event.scale);
  if (event.T_world_camera && event.scale == MapScale::metric) {
    const Pose T = event.placement->T_enu_map * *event.T_world_camera;
    const Eigen::Quaterniond& q = T.rotation();
    json["position_enu_m"] = {T.translation().x(), T.translation().y(), T.translation().z()};
    json["rotation_enu_xyzw"] = {q.x(), q.y(), q.z(), q.w()};
  }
  json["tracks"] = event.tracks;
  json["inliers"] = event.inliers;
  json["mse_px2"] = event.mse_px2;
  json["keyframe"] = event.keyframe;
  json["segment"] = event.segment;
  json["resets"] = event.resets;
  json["latency_ms"] = event.latency_ms;
  return json;
}

Json to_json(const MeshBlock& block) {
  return {{"event", "mesh"},
          {"block", block.index},
          {"version", block.version},
          {"vertices", block.mesh.vertices.size()},
          {"triangles", block.mesh.triangles.size()}};
}

void JsonEvents::write(const Json& json) {
  const std::scoped_lock lock(mutex_);
  write_json_line(out_, json);
}
void JsonEvents::on_pose(const PoseEvent& event) { write(to_json(event)); }
void JsonEvents::on_block(const MeshBlock& block) { write(to_json(block)); }

ProgressLine::ProgressLine(std::optional<std::size_t> frames, Clock& clock)
    : frames_(frames), clock_(clock), start_ns_(clock.now_ns()) {}

ProgressLine::~ProgressLine() { draw_progress(""); }

void ProgressLine::on_block(const MeshBlock&) {
  const std::scoped_lock lock(mutex_);
  ++blocks_;
}

void ProgressLine::on_pose(const PoseEvent& event) {
  ++seen_;
  keyframes_ += event.keyframe ? 1 : 0;
  const std::int64_t now_ns = clock_.now_ns();
  if (seen_ > 1 && now_ns - drawn_ns_ < 100'000'000) return;
  drawn_ns_ = now_ns;
  const double elapsed_s = static_cast<double>(now_ns - start_ns_) * 1e-9;
  const double rate_hz = elapsed_s > 0 ? static_cast<double>(seen_) / elapsed_s : 0;
  std::string line = fmt::format("frame {}", event.frame.value + 1);
  if (frames_) line += fmt::format("/{}", *frames_);
  line += fmt::format("  {}  {} tracks  {} keyframes", to_string(event.state), event.tracks,
                      keyframes_);
  {
    const std::scoped_lock lock(mutex_);
    if (blocks_ > 0) line += fmt::format("  {} mesh updates", blocks_);
  }
  line += fmt::format("  {:.1f} frames/s", rate_hz);
  if (frames_ && *frames_ > seen_ && rate_hz > 0) {
    const auto left_s = static_cast<long>(static_cast<double>(*frames_ - seen_) / rate_hz + 0.5);
    line += fmt::format("  {}:{:02} left", left_s / 60, left_s % 60);
  }
  draw_progress(line);
}

}  // namespace corvid
