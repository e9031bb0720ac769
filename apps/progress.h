#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <mutex>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <ostream>
#include <string>

#include "core/clock.h"
#include "corvid/ports.h"

namespace corvid {

/// The program's only way to write JSON: one line, invalid UTF-8 (file names) replaced.
void write_json_line(std::ostream& out, const nlohmann::ordered_json& json);
[[nodiscard]] nlohmann::ordered_json to_json(const Camera& camera);
[[nodiscard]] nlohmann::ordered_json to_json(const SourceInfo& info);
[[nodiscard]] nlohmann::ordered_json to_json(const SourceCounts& counts);
[[nodiscard]] nlohmann::ordered_json to_json(const PoseEvent& event);
[[nodiscard]] nlohmann::ordered_json to_json(const MapPlacement& placement);
[[nodiscard]] nlohmann::ordered_json to_json(const GeodeticPosition& position);
[[nodiscard]] nlohmann::ordered_json to_json(const MeshBlock& block);

/// One JSON object per pose and mesh block, one per line. Thread-safe.
class JsonEvents final : public PoseSink, public MeshSink {
 public:
  explicit JsonEvents(std::ostream& out) : out_(out) {}
  void on_pose(const PoseEvent& event) override;
  void on_block(const MeshBlock& block) override;
  void write(const nlohmann::ordered_json& json);

 private:
  std::ostream& out_;
  std::mutex mutex_;
};

/// Replaces the progress line below the program's log; an empty one removes it.
void draw_progress(const std::string& line);

/// Draws a progress line below the log, at most ten times a second. Thread-safe for one PoseSink
/// and one MeshSink thread.
class ProgressLine final : public PoseSink, public MeshSink {
 public:
  /// @param frames  of the whole source, if known.
  ProgressLine(std::optional<std::size_t> frames, Clock& clock);
  ~ProgressLine() override;
  void on_pose(const PoseEvent& event) override;
  void on_block(const MeshBlock& block) override;

 private:
  const std::optional<std::size_t> frames_;
  Clock& clock_;
  const std::int64_t start_ns_;
  std::int64_t drawn_ns_ = 0;
  std::size_t seen_ = 0, keyframes_ = 0;
  std::mutex mutex_;
  std::size_t blocks_ = 0;
};

}  // namespace corvid
