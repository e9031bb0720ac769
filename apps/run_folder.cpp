#include "apps/run_folder.h"

#include <fmt/format.h>

#include <algorithm>
#include <future>
#include <iterator>
#include <nlohmann/json.hpp>
#include <system_error>

#include "apps/report.h"
#include "apps/report_pictures.h"
#include "io/atomic_file.h"
#include "io/colmap_writer.h"
#include "io/image_encode.h"
#include "io/mesh_files.h"
#include "io/options_file.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

constexpr char kMarker[] = "run.json";

/// Rounding of a stored vertex: a sixteenth of a voxel is far below what the surface resolves.
constexpr double kVoxelShare = 1.0 / 16;

std::uintmax_t size_below(const fs::path& path) {
  std::error_code ec;
  if (!fs::is_directory(path, ec)) {
    const std::uintmax_t size = fs::file_size(path, ec);
    return ec ? 0 : size;
  }
  std::uintmax_t sum = 0;
  for (fs::recursive_directory_iterator it(path, ec), end; !ec && it != end; it.increment(ec)) {
    std::error_code fault;
    if (!it->is_regular_file(fault)) continue;
    const std::uintmax_t size = it->file_size(fault);
    if (!fault) sum += size;
  }
  return sum;
}

/// TUM columns, then what a keyframe is beyond its pose.
std::string keyframes_text(const MapSnapshot& map) {
  std::string out =
      "# time [s] tx ty tz qx qy qz qw (T_world_camera), keyframe, frame, segment, landmarks "
      "seen\n";
  for (const auto& k : map.keyframes) {
    const Eigen::Vector3d& t = k->T_world_camera.translation();
    const Eigen::Quaterniond& q = k->T_world_camera.rotation();
    const std::int64_t time_ns = k->frame ? k->frame->time_ns : 0;
    const std::uint32_t frame = k->frame ? k->frame->id.value : FrameId::kInvalid;
    const std::uint64_t size_ns =
        time_ns < 0 ? 0 - static_cast<std::uint64_t>(time_ns) : static_cast<std::uint64_t>(time_ns);
    fmt::format_to(std::back_inserter(out), "{}{}.{:09d} {} {} {} {} {} {} {} {} {} {} {}\n",
                   time_ns < 0 ? "-" : "", size_ns / 1000000000, size_ns % 1000000000, t.x(), t.y(),
                   t.z(), q.x(), q.y(), q.z(), q.w(), k->id.value, frame, k->segment,
                   k->observations.size());
  }
  return out;
}

TriangleMesh landmark_cloud(const MapSnapshot& map) {
  TriangleMesh cloud;
  for (const Landmark& l : map.landmarks) {
    cloud.vertices.push_back(l.p_world.cast<float>());
    cloud.colours.push_back(l.colour);
  }
  return cloud;
}

/// Raw depth, previews, and index.json with cameras and poses.
Expected<void> write_depth(const RunResult& result, const fs::path& dir) {
  std::vector<const StoredDepth*> maps;
  for (const StoredDepth& map : result.depth_maps) {
    if (map.image_bytes() > 0) maps.push_back(&map);
  }
  using Json = nlohmann::ordered_json;
  Json index = Json::array();
  for (const std::size_t i : spread_indices(maps.size(), kMaxDepthFiles)) {
    const DepthMap map = maps[i]->load();
    const std::string stem = fmt::format("keyframe_{:06d}", map.keyframe.value);
    const DepthPicture picture = picture_of_depth(map.depth);
    std::vector<std::pair<std::string, std::string>> files = {
        {stem + ".pfm", encode_pfm(map.depth)},
        {stem + "_depth.png", encode_png(picture.picture.colour, picture.picture.alpha)}};
    if (!map.confidence.empty()) {
      const MeshPicture c = picture_of_confidence(map.confidence);
      files.emplace_back(stem + "_confidence.png", encode_png(c.colour, c.alpha));
    }
    for (const auto& [name, bytes] : files) {
      if (auto ok = write_file_atomically(dir / name, bytes); !ok) return ok;
    }
    const Eigen::Quaterniond& q = map.T_world_camera.rotation();
    const Eigen::Vector3d& t = map.T_world_camera.translation();
    index.push_back({{"keyframe", map.keyframe.value},
                     {"depth", stem + ".pfm"},
                     {"width_px", map.depth.width()},
                     {"height_px", map.depth.height()},
                     {"fx_px", map.camera.fx_px},
                     {"fy_px", map.camera.fy_px},
                     {"cx_px", map.camera.cx_px},
                     {"cy_px", map.camera.cy_px},
                     {"position", {t.x(), t.y(), t.z()}},
                     {"rotation_xyzw", {q.x(), q.y(), q.z(), q.w()}},
                     {"near", picture.near},
                     {"far", picture.far}});
  }
  return write_file_atomically(dir / "index.json", index.dump(2) + "\n");
}

bool has_images(const MapSnapshot& map) {
  return map.camera && std::any_of(map.keyframes.begin(), map.keyframes.end(),
                                   [](const auto& k) { return k->frame != nullptr; });
}

/// Every file but run.json and report.html; what was written, for the report's list.
class FolderWriter {
 public:
  FolderWriter(const RunReportInput& input, fs::path dir)
      : options_yaml(
            fmt::format("# corvid {}\n{}", input.version, options_to_yaml(input.result.options))),
        input_(input),
        dir_(std::move(dir)) {}

  Expected<void> write() {
    const RunResult& result = input_.result;
    if (!done("trajectory.txt", "camera poses of all frames that have one, TUM format",
              write_trajectory((dir_ / "trajectory.txt").string(), result.trajectory))) {
      return fault_;
    }
    if (result.map) {
      if (!done("keyframes.txt", "poses of the keyframes", write_sparse_map(*result.map, dir_)))
        return fault_;
      list("points.ply", "landmarks with colours");
    }
    if (input_.live_surface && !result.mesh.empty() &&
        !write_surface(RunSurface::live, "the surface", result.mesh, result.voxel_size)) {
      return fault_;
    }
    if (const SurfaceCut* cut = input_.cut;
        cut && !cut->mesh.empty() &&
        !write_surface(RunSurface::cut, "the minimal surface", cut->mesh, cut->voxel_size)) {
      return fault_;
    }
    if (!input_.brief && result.map && has_images(*result.map)) {
      auto models = write_colmap(*result.map, dir_ / "colmap");
      if (!models) return tl::unexpected(models.error());
      colmap = std::move(*models);
      list("colmap", "COLMAP text model with undistorted images");
    }
    if (!input_.brief && !result.depth_maps.empty()) {
      if (!done("depth", "depth maps of up to 40 keyframes: raw (.pfm) and as pictures",
                write_depth(result, dir_ / "depth"))) {
        return fault_;
      }
    }
    done("options.yaml", "the resolved options; give it to --options to fly the same way",
         write_file_atomically(dir_ / "options.yaml", options_yaml));
    return fault_;
  }

  std::vector<ReportFile> files;
  std::vector<ColmapModel> colmap;
  const std::string options_yaml;

 private:
  bool write_surface(RunSurface surface, const std::string& what, const TriangleMesh& mesh,
                     double voxel_size) {
    MeshWriteOptions options;
    options.max_step = voxel_size * kVoxelShare;
    options.z_up = input_.result.enu_origin.has_value();
    const std::string drc = std::string(run_mesh_stem(surface)) + ".drc";
    const std::string glb = std::string(run_mesh_stem(surface)) + ".glb";
    if (!done(drc, what + ", Draco", write_mesh(mesh, dir_ / drc, MeshFormat::drc, options)))
      return false;
    return input_.brief || done(glb, what + ", glTF with KHR_draco_mesh_compression, y up",
                                write_mesh(mesh, dir_ / glb, MeshFormat::glb, options));
  }
  void list(const std::string& name, const std::string& about) {
    files.push_back({name, about, size_below(dir_ / name)});
  }
  bool done(const std::string& name, const std::string& about, Expected<void> ok) {
    if (ok) {
      list(name, about);
    } else {
      fault_ = std::move(ok);
    }
    return fault_.has_value();
  }
  const RunReportInput& input_;
  fs::path dir_;
  Expected<void> fault_;
};

/// Whether the folder was written by us.
Expected<void> check_run(const fs::path& dir) {
  std::error_code ec;
  if (fs::is_regular_file(dir / kMarker, ec)) return {};
  return fail(ErrorCode::not_found, "is not the folder of a finished run (it holds no run.json)",
              dir.string(), "give the folder that `corvid replay --out` wrote");
}

}  // namespace

Expected<void> write_sparse_map(const MapSnapshot& map, const fs::path& dir) {
  if (auto ok = write_file_atomically(dir / "keyframes.txt", keyframes_text(map)); !ok) return ok;
  return write_mesh(landmark_cloud(map), dir / "points.ply");
}

Expected<void> check_run_folder(const fs::path& dir) {
  const auto folder = AtomicFolder::create(dir, kMarker);
  if (!folder) return tl::unexpected(folder.error());
  return {};
}

Expected<void> write_run_folder(const RunReportInput& input, const fs::path& dir) {
  auto folder = AtomicFolder::create(dir, kMarker);
  if (!folder) return tl::unexpected(folder.error());
  FolderWriter writer(input, folder->path());
  ReportFacts facts{input, count_run(input.result), machine_info(), writer.options_yaml, {}, {}};
  // A service that is stopped has seconds: draw while the mesh is compressed.
  auto pictures = std::async(std::launch::async, [&facts] { return report_pictures(facts); });
  if (auto ok = writer.write(); !ok) return ok;
  facts.colmap = writer.colmap;
  facts.files = std::move(writer.files);
  facts.files.push_back({"run.json", "every number of this report", 0});
  const std::string json = report_json(facts);
  facts.files.back().bytes = json.size();
  if (auto ok = write_file_atomically(folder->path() / kMarker, json); !ok) return ok;
  if (auto ok =
          write_file_atomically(folder->path() / "report.html", report_html(facts, pictures.get()));
      !ok) {
    return ok;
  }
  return folder->commit();
}

const char* run_mesh_stem(RunSurface surface) {
  return surface == RunSurface::cut ? "mesh-cut" : "mesh";
}

Expected<TriangleMesh> load_run_mesh(const fs::path& dir, RunSurface surface) {
  if (auto ok = check_run(dir); !ok) return tl::unexpected(ok.error());
  std::error_code ec;
  const fs::path file = dir / (std::string(run_mesh_stem(surface)) + ".drc");
  if (!fs::exists(file, ec)) return TriangleMesh{};
  return read_mesh(file);
}

bool run_is_on_earth(const fs::path& dir) {
  const auto text = read_file_bytes(dir / kMarker);
  const auto json = nlohmann::json::parse(text.value_or(""), nullptr, false);
  return json.is_object() && json.contains("world") &&
         json["world"].value("frame", std::string()) == "enu";
}

Expected<void> copy_run_colmap(const fs::path& dir, const fs::path& out) {
  if (auto ok = check_run(dir); !ok) return ok;
  std::error_code ec;
  if (!fs::is_directory(dir / "colmap", ec)) {
    return fail(ErrorCode::not_found, "the run has no COLMAP model: it made no map", dir.string());
  }
  // No file of ours marks a COLMAP folder: an existing one is never replaced unless it is empty.
  auto folder = AtomicFolder::create(out, ".corvid-never-present");
  if (!folder) {
    Error error = folder.error();
    if (error.code == ErrorCode::invalid_argument && fs::is_directory(out, ec)) {
      error.what = "exists and is not empty";
      error.hint = "choose another output folder, or remove this one yourself";
    }
    return tl::unexpected(std::move(error));
  }
  fs::copy(dir / "colmap", folder->path(), fs::copy_options::recursive, ec);
  if (ec) return fail(ErrorCode::io, "cannot be copied: " + ec.message(), out.string());
  return folder->commit();
}

}  // namespace corvid
