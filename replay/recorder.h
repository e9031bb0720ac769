#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <vector>

#include "corvid/error.h"
#include "corvid/ports.h"
#include "io/recording_writer.h"

namespace corvid {

/// Writes frames as an ASL (EuRoC) folder: mav0/cam0/{sensor.yaml, data.csv, data/<ns>.png} and,
/// where the truth is known, mav0/state_groundtruth_estimate0/data.csv.
///
/// A recording that is killed stays readable: an image gets its name only when it is whole, and
/// its line in data.csv after that. Images are written without loss; colour where there is any.
class Recorder final : public RecordingWriter {
 public:
  /// Makes the folder and writes sensor.yaml, unless the intrinsics are a guess: in a file it would
  /// be taken for a calibration, and not be refined. Fails if there is a recording already, if
  /// nothing can be written there, or for the fov camera, which the format cannot express
  /// (unsupported).
  [[nodiscard]] static Expected<Recorder> open(const std::filesystem::path& folder,
                                               const SourceInfo& info);
  Recorder(Recorder&&) noexcept;
  Recorder& operator=(Recorder&&) noexcept;
  ~Recorder() override;

  /// PNG.
  [[nodiscard]] Expected<std::vector<std::uint8_t>> encode(const Frame& frame) override;
  [[nodiscard]] Expected<void> append(const Frame& frame,
                                      std::span<const std::uint8_t> picture) override;
  /// Poses of cam0 (body and camera are the same in sensor.yaml). No velocities or biases: zeros.
  [[nodiscard]] Expected<bool> write_truth(const Trajectory& truth) override;
  [[nodiscard]] Expected<void> finish() override { return {}; }

 private:
  struct Impl;
  explicit Recorder(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace corvid
