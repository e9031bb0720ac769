#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "apps/evaluation.h"
#include "apps/stream_numbers.h"
#include "apps/surface_errors.h"
#include "corvid/error.h"
#include "corvid/run_result.h"
#include "mapping/surface_cut.h"

namespace corvid {

/// What a run's folder is written from.
struct RunReportInput {
  const RunResult& result;
  std::optional<TrajectoryErrors> trajectory_errors;  ///< if there is a true trajectory
  std::optional<SurfaceErrors> surface_errors;        ///< if there is a true surface
  std::string version;
  std::string command_line;
  bool live_surface = true;                            ///< whether the fused surface is written
  const SurfaceCut* cut = nullptr;                     ///< written if there is one
  std::optional<SurfaceErrors> cut_errors{};           ///< of it, if there is a true surface
  std::optional<StreamNumbers> stream = std::nullopt;  ///< if there was a mesh to stream
  bool brief = false;  ///< without colmap/, depth/ and .glb, which take long for a long flight
};

/// Which of a run's surfaces.
enum class RunSurface { live, cut };

/// Raw depth maps and previews are written for at most so many keyframes, evenly spread.
inline constexpr std::size_t kMaxDepthFiles = 40;

/// Writes keyframes.txt and points.ply, each whole or not at all. Errors: io.
[[nodiscard]] Expected<void> write_sparse_map(const MapSnapshot& map,
                                              const std::filesystem::path& dir);

/// Whether a run may write its folder there: asked before a long run. Errors as write_run_folder().
[[nodiscard]] Expected<void> check_run_folder(const std::filesystem::path& dir);

/// Writes trajectory.txt, keyframes.txt, points.ply, mesh.drc, mesh.glb, mesh-cut.drc,
/// mesh-cut.glb, colmap/, depth/, options.yaml, run.json and report.html (docs/formats.md). What
/// the run did not produce (no mesh, no map) is left out. The folder appears whole or not at all;
/// one that an earlier run wrote (known by its run.json) is replaced. Errors: invalid_argument if
/// `dir` holds somebody else's things; io.
[[nodiscard]] Expected<void> write_run_folder(const RunReportInput& input,
                                              const std::filesystem::path& dir);

/// "mesh" or "mesh-cut": the names of the files without what follows the dot.
[[nodiscard]] const char* run_mesh_stem(RunSurface surface);

/// The mesh of a finished run's folder; empty if the run made none.
/// Errors: not_found if this is no run's folder; io, corrupt.
[[nodiscard]] Expected<TriangleMesh> load_run_mesh(const std::filesystem::path& dir,
                                                   RunSurface surface = RunSurface::live);

/// Whether the run's files are east, north, up in metres; otherwise they are in the map's own
/// frame.
[[nodiscard]] bool run_is_on_earth(const std::filesystem::path& dir);

/// Copies a finished run's COLMAP model and images to `out` (a new or empty folder).
/// Errors: not_found if this is no run's folder or it has no COLMAP model; invalid_argument if
/// `out` holds anything; io.
[[nodiscard]] Expected<void> copy_run_colmap(const std::filesystem::path& dir,
                                             const std::filesystem::path& out);

}  // namespace corvid
