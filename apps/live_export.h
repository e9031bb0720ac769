#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <thread>

#include "corvid/error.h"
#include "corvid/mesh_stream.h"
#include "io/descriptor.h"
#include "io/mesh_stream.h"

namespace corvid {

/// Hands the live surface of a running engine to `corvid export`, over a local socket without a
/// file (Linux's abstract namespace, named after the run's folder and the user): nothing is left
/// behind, however the program ends. Other users are turned away. Tracking and mapping do not wait
/// for whoever asks.
class LiveExportServer {
 public:
  /// Serves until it is destroyed. nullptr, with a note in the log, if another run to that folder
  /// serves already or the system has no such sockets: the run goes on without.
  /// @param stream  outlives the server; null: the run maps nothing, and whoever asks is told so.
  [[nodiscard]] static std::unique_ptr<LiveExportServer> start(const std::filesystem::path& run_dir,
                                                               const MeshStream* stream);
  ~LiveExportServer();
  LiveExportServer(const LiveExportServer&) = delete;
  LiveExportServer& operator=(const LiveExportServer&) = delete;

 private:
  LiveExportServer(int fd, const MeshStream* stream);
  Descriptor fd_;
  std::jthread thread_;
};

/// The surface of the run that is writing to that folder right now, as it was at one moment, in map
/// units in the frame of the first keyframe; nothing if none is running. Vertices where blocks meet
/// are welded.
/// Errors: io (it ended meanwhile, or does not answer), not_found (it maps nothing), corrupt.
[[nodiscard]] Expected<std::optional<TriangleMesh>> fetch_live_surface(
    const std::filesystem::path& run_dir);

}  // namespace corvid
