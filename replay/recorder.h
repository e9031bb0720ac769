#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <stop_token>

#include "corvid/error.h"
#include "corvid/ports.h"

namespace corvid {

/// Writes frames as an ASL (EuRoC) folder: mav0/cam0/{sensor.yaml, data.csv, data/<ns>.png} and,
/// where the truth is known, mav0/state_groundtruth_estimate0/data.csv.
///
/// A recording that is killed stays readable: an image gets its name only when it is whole, and
/// its line in data.csv after that. Images are written without loss; colour where there is any.
class Recorder {
 public:
  /// Makes the folder and writes sensor.yaml. Fails if there is a recording already, if nothing
  /// can be written there, or for the fov camera, which the format cannot express (unsupported).
  [[nodiscard]] static Expected<Recorder> open(const std::filesystem::path& folder,
                                               const SourceInfo& info);
  Recorder(Recorder&&) noexcept;
  Recorder& operator=(Recorder&&) noexcept;
  ~Recorder();

  /// Capture times must not be negative and must rise.
  [[nodiscard]] Expected<void> write(const Frame& frame);
  /// Poses of cam0 (body and camera are the same in sensor.yaml). No velocities or biases: zeros.
  [[nodiscard]] Expected<void> write_truth(const Trajectory& truth);

 private:
  struct Impl;
  explicit Recorder(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// Records a source to its end, or until asked to stop, truth first. Returns the frames written.
[[nodiscard]] Expected<std::uint64_t> record(FrameSource& source,
                                             const std::filesystem::path& folder,
                                             const std::stop_token& stop = {});

}  // namespace corvid
