// place_on_earth() of corvid/run_result.h.
#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <set>

#include "core/check.h"
#include "corvid/run_result.h"

namespace corvid {
namespace {

void place_mesh(TriangleMesh& mesh, const Sim3& T) {
  for (Eigen::Vector3f& v : mesh.vertices) v = (T * v.cast<double>()).cast<float>();
  const Eigen::Quaternionf R = T.rotation().cast<float>();
  for (Eigen::Vector3f& n : mesh.normals) n = R * n;
}

std::shared_ptr<const MapSnapshot> placed(const MapSnapshot& map, const std::vector<Sim3>& T) {
  auto out = std::make_shared<MapSnapshot>(map);
  std::map<LandmarkId, int> segment_of;
  for (auto& keyframe : out->keyframes) {
    auto copy = std::make_shared<Keyframe>(*keyframe);
    copy->T_world_camera = T[static_cast<std::size_t>(copy->segment)] * copy->T_world_camera;
    for (const Observation& o : copy->observations) segment_of[o.landmark] = copy->segment;
    keyframe = std::move(copy);
  }
  std::vector<Landmark> landmarks(map.landmarks.begin(), map.landmarks.end());
  for (Landmark& l : landmarks) {
    const auto it = segment_of.find(l.id);
    l.p_world = T[it == segment_of.end() ? 0 : static_cast<std::size_t>(it->second)] * l.p_world;
  }
  out->landmarks = Landmarks(std::move(landmarks));
  return out;
}

}  // namespace

bool place_on_earth(RunResult& result) {
  CORVID_CHECK(result.trajectory_segments.size() == result.trajectory.size(),
               "a segment for every pose");
  if (!result.map || result.enu_origin) return false;
  std::map<int, int> keyframes;  // of metric segments
  std::set<int> all;
  for (const auto& keyframe : result.map->keyframes) {
    all.insert(keyframe->segment);
    const auto s = static_cast<std::size_t>(keyframe->segment);
    if (s < result.placements.size() && result.placements[s].scale == MapScale::metric)
      ++keyframes[keyframe->segment];
  }
  if (keyframes.empty()) return false;
  const auto main =
      std::max_element(keyframes.begin(), keyframes.end(),
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  const Sim3& T_main = result.placements[static_cast<std::size_t>(main->first)].T_enu_map;
  std::vector<Sim3> T(static_cast<std::size_t>(*all.rbegin() + 1), T_main);
  for (const auto& [segment, count] : keyframes) {
    const auto s = static_cast<std::size_t>(segment);
    T[s] = result.placements[s].T_enu_map;
  }
  if (keyframes.size() < all.size()) {
    result.notes.push_back(fmt::format(
        "{} of {} map segments have no scale of their own: they were placed like segment {}.",
        all.size() - keyframes.size(), all.size(), main->first));
  }
  if (all.size() > 1 && !result.mesh.empty()) {
    result.notes.push_back(
        fmt::format("The mesh of all segments was placed like segment {}.", main->first));
  }

  for (std::size_t i = 0; i < result.trajectory.size(); ++i) {
    Pose& T_world_camera = result.trajectory[i].T_world_camera;
    T_world_camera = T[static_cast<std::size_t>(result.trajectory_segments[i])] * T_world_camera;
  }
  for (StoredDepth& d : result.depth_maps) {
    const auto of = std::find_if(result.map->keyframes.begin(), result.map->keyframes.end(),
                                 [&](const auto& k) { return k->id == d.keyframe; });
    const Sim3& S =
        of == result.map->keyframes.end() ? T_main : T[static_cast<std::size_t>((*of)->segment)];
    d.T_world_camera = S * d.T_world_camera;
    d.scale *= S.scale();
  }
  place_mesh(result.mesh, T_main);
  result.voxel_size *= T_main.scale();
  result.map = placed(*result.map, T);
  result.enu_origin = result.placements[static_cast<std::size_t>(main->first)].origin;
  return true;
}

}  // namespace corvid
