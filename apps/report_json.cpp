#include <cmath>
#include <nlohmann/json.hpp>

#include "apps/progress.h"
#include "apps/report.h"
#include "io/options_file.h"

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;

Json of(const Spread& s) {
  return {{"count", s.count}, {"mean", s.mean}, {"median", s.median},
          {"p95", s.p95},     {"p99", s.p99},   {"max", s.max}};
}

Json of(const Statistics& s) {
  return {{"count", s.count},   {"rmse", s.rmse}, {"mean", s.mean},
          {"median", s.median}, {"p90", s.p90},   {"max", s.max}};
}

Json trajectory_errors_of(const TrajectoryErrors& e) {
  Json out;
  out["problem"] = e.problem.empty() ? Json(nullptr) : Json(e.problem);
  out["matched"] = e.matched;
  out["unmatched"] = e.unmatched;
  out["path_length_m"] = e.path_length_m;
  out["alignment_scale"] = e.T_truth_estimate.scale();
  out["scale_m_per_unit"] = e.scale;
  out["scale_drift"] = e.scale_drift ? Json(*e.scale_drift) : Json(nullptr);
  out["ate_m"] = of(e.position_m);
  out["orientation_deg"] = of(e.orientation_deg);
  out["orientation_constant_deg"] = e.orientation_constant_deg;
  out["orientation_rest_deg"] = e.orientation_rest_deg;
  out["rpe_translation_m"] = of(e.rpe_translation_m);
  out["rpe_rotation_deg"] = of(e.rpe_rotation_deg);
  out["kitti"] = {{"segments", e.kitti.segments},
                  {"lengths_m", e.kitti.lengths_m},
                  {"t_rel_percent", e.kitti.t_rel_percent},
                  {"r_rel_deg_per_100m", e.kitti.r_rel_deg_per_100m},
                  {"short_segments", e.kitti.short_segments}};
  out["notes"] = e.notes;
  return out;
}

Json surface_errors_of(const SurfaceErrors& e) {
  return {{"problem", e.problem.empty() ? Json(nullptr) : Json(e.problem)},
          {"median_m", e.median_m},
          {"mean_m", e.mean_m},
          {"rmse_m", e.rmse_m},
          {"accuracy90_m", e.accuracy90_m},
          {"estimate_area_m2", e.estimate_area_m2},
          {"truth_area_m2", e.truth_area_m2},
          {"completeness_distances_m", e.completeness_distances_m},
          {"completeness", e.completeness}};
}

}  // namespace

std::string report_json(const ReportFacts& facts) {
  const RunResult& result = facts.input.result;
  const RunNumbers& n = facts.numbers;
  Json out;
  out["schema"] = "corvid-run";
  out["schema_version"] = kRunSchemaVersion;
  out["version"] = facts.input.version;
  out["command_line"] = facts.input.command_line;
  out["interrupted"] = result.interrupted;
  out["device"] = result.device;
  out["machine"] = {{"processor", facts.machine.processor},
                    {"system", facts.machine.system},
                    {"cores", facts.machine.cores},
                    {"memory_bytes", facts.machine.memory_bytes}};
  out["source"] = to_json(result.source);
  out["wall_s"] = result.wall_s;
  out["peak_memory_bytes"] = result.peak_memory_bytes;
  out["frames"] = {{"delivered", n.delivered},
                   {"skipped", n.skipped},
                   {"dropped", n.dropped},
                   {"lost", n.lost},
                   {"interruptions", n.interruptions},
                   {"events", n.events},
                   {"with_pose", n.with_pose},
                   {"untracked_after_start", n.untracked_after_start},
                   {"capture_s", n.capture_s},
                   {"start_s", n.start_s},
                   {"frames_per_s", n.frames_per_s},
                   {"realtime_factor", n.realtime_factor},
                   {"messages", result.counts.messages}};
  for (std::size_t i = 0; i < n.states.size(); ++i) {
    out["states"][std::string(to_string(static_cast<TrackingState>(i)))] = n.states[i];
  }
  out["trajectory"] = {{"poses", n.poses}, {"path_length", n.path_length}};
  out["world"] = {{"frame", result.enu_origin ? "enu" : "map"},
                  {"unit", result.enu_origin ? "m" : "arbitrary"},
                  {"origin", nullptr},
                  {"segments", Json::array()}};
  if (result.enu_origin) out["world"]["origin"] = to_json(*result.enu_origin);
  for (const MapPlacement& p : result.placements) out["world"]["segments"].push_back(to_json(p));
  out["tracking"] = {{"tracks", of(n.tracks)},
                     {"inliers", of(n.inliers)},
                     {"reprojection_rms_px", of(n.rms_px)},
                     {"latency_ms", of(n.latency_ms)}};
  out["map"] = {{"keyframes", n.keyframes},
                {"landmarks", n.landmarks},
                {"observations", n.observations},
                {"segments", n.segments},
                {"camera", nullptr}};
  out["places"] = {{"relocalizations", result.places.relocalizations},
                   {"loops", result.places.loops},
                   {"merges", result.places.merges},
                   {"connections", result.places.connections},
                   {"refused", result.places.refused}};
  if (result.map && result.map->camera) out["map"]["camera"] = to_json(*result.map->camera);
  out["depth"] = {
      {"maps", n.depth_maps}, {"coverage", n.depth_coverage}, {"confidence", n.depth_confidence}};
  out["mesh"] = {{"vertices", n.vertices},
                 {"triangles", n.triangles},
                 {"area", n.mesh_area},
                 {"voxel_size", result.voxel_size}};
  out["cut"] = nullptr;
  if (const SurfaceCut* cut = facts.input.cut) {
    const SurfaceCutStatistics& s = cut->statistics;
    out["cut"] = {{"vertices", cut->mesh.vertices.size()},
                  {"triangles", cut->mesh.triangles.size()},
                  {"voxel_size", cut->voxel_size},
                  {"voxels", s.voxels},
                  {"crust_voxels", s.crust_voxels},
                  {"points", s.points},
                  {"graph_s", s.graph_s},
                  {"maxflow_s", s.maxflow_s},
                  {"mesh_s", s.mesh_s},
                  {"peak_bytes", s.peak_bytes}};
  }
  out["stream"] = nullptr;
  if (const auto& s = facts.input.stream)
    out["stream"] = {{"changed_blocks", s->changes},
                     {"changed_blocks_per_s", s->changes_per_s},
                     {"blocks", s->blocks},
                     {"bytes", s->bytes},
                     {"bytes_per_triangle", s->bytes_per_triangle},
                     {"encode_ms_per_block", s->encode_ms},
                     {"send_s", s->send_s}};
  out["colmap"] = Json::array();
  for (const ColmapModel& model : facts.colmap) {
    out["colmap"].push_back({{"folder", "colmap/" + model.sparse_dir.filename().string()},
                             {"segment", model.segment},
                             {"images", model.images},
                             {"points", model.points},
                             {"observations", model.observations},
                             {"mean_error_px", model.mean_error_px}});
  }
  out["errors"] = {{"trajectory", nullptr}, {"surface", nullptr}, {"cut", nullptr}};
  if (facts.input.trajectory_errors) {
    out["errors"]["trajectory"] = trajectory_errors_of(*facts.input.trajectory_errors);
  }
  if (facts.input.surface_errors) {
    out["errors"]["surface"] = surface_errors_of(*facts.input.surface_errors);
  }
  if (facts.input.cut_errors) out["errors"]["cut"] = surface_errors_of(*facts.input.cut_errors);
  out["stages"] = Json::array();
  for (const StageMetrics& s : result.stages) {
    out["stages"].push_back({{"name", s.name},
                             {"count", s.count},
                             {"median_ms", s.median_ms},
                             {"p95_ms", s.p95_ms},
                             {"p99_ms", s.p99_ms},
                             {"total_s", s.total_s}});
  }
  out["options"] = Json::object();
  for (const OptionField& field : option_fields()) {
    out["options"][std::string(field.key)] = field.text(result.options);
  }
  out["notes"] = result.notes;
  out["files"] = Json::array();
  for (const ReportFile& file : facts.files) out["files"].push_back(file.name);
  // Bytes of a file name that are no UTF-8 are replaced; what is not finite becomes null.
  return out.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace corvid
