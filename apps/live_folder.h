#pragma once

#include <condition_variable>
#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "corvid/error.h"
#include "corvid/ports.h"
#include "io/descriptor.h"

namespace corvid {

/// What is on the disk of a live run before its folder appears, for the case that it is killed or
/// the power fails: `poses.txt`, a line for each pose as it was published (TUM format), and every
/// half a minute the sparse map, `points.ply` and `keyframes.txt`. Lines are appended whole, files
/// replaced whole. Removed when the run's folder is there; one that a killed run left is never
/// touched.
///
/// Writes on a thread of its own: a slow disk holds up nobody. What cannot be written is said once
/// in the log, and the run goes on.
class LiveFolder final : public PoseSink, public MapSink {
 public:
  /// Makes "<run>.live", or "<run>.live-2" and so on where there is one already.
  /// Errors: those of making a folder.
  [[nodiscard]] static Expected<std::unique_ptr<LiveFolder>> create(
      const std::filesystem::path& run, const std::string& about);
  ~LiveFolder() override;

  void on_pose(const PoseEvent& event) override;
  void on_map(const std::shared_ptr<const MapSnapshot>& map) override;
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  /// Writes what there is at once: the end is near. From any thread; does not wait.
  void hurry();
  /// Whether no pose has come.
  [[nodiscard]] bool empty() const;
  /// Ends writing and removes the folder.
  void remove();

 private:
  LiveFolder(std::filesystem::path path, int fd, std::string first_lines);
  void run(const std::stop_token& stop);
  void write_lines(const std::string& lines);
  void write_map(const MapSnapshot& map);
  void trouble(const std::string& what);

  const std::filesystem::path path_;
  Descriptor fd_;  ///< poses.txt, appended to
  int segment_ = -1;
  std::uint64_t resets_ = 0;
  bool in_trouble_ = false;

  mutable std::mutex mutex_;
  std::condition_variable_any changed_;
  bool hurried_ = false;
  std::string lines_;                       // not yet written
  std::shared_ptr<const MapSnapshot> map_;  // the newest, until it is written
  std::jthread thread_;
};

}  // namespace corvid
