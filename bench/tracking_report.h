#pragma once

#include <array>
#include <iosfwd>
#include <optional>
#include <string>
#include <vector>

#include "bench/machine.h"

namespace corvid {

/// Frames after which tracks are looked at again.
inline constexpr std::array<int, 3> kTrackAges = {10, 30, 60};

/// What became of tracks some frames after their birth, over all frames of birth.
struct TrackAge {
  int frames = 0;
  int born = 0;   ///< tracks born at least `frames` before the recording's end
  int alive = 0;  ///< of them, those seen in exactly that frame
  int left = 0;   ///< of those not alive, the ones whose true point has been out of the image
  /// Median distance [px] of the place to the true epipolar line of the birth's place (the angle
  /// between ray and epipolar plane times the focal length). Absent without truth.
  std::optional<double> epipolar_px;
  /// Median distance [px] to the projection of the point that all of the track's places and the
  /// true poses give. Absent without truth.
  std::optional<double> reprojection_px;

  /// Of all that were born; absent if none was.
  [[nodiscard]] std::optional<double> share_alive() const;
  /// Of those that did not leave the image.
  [[nodiscard]] std::optional<double> share_alive_visible() const;
};

/// One step of the frontend (the names of Frontend::last_timings_ms()).
struct TrackingStep {
  std::string name;
  int runs = 0;          ///< frames that had it
  double median_ms = 0;  ///< of these
  double mean_ms = 0;    ///< over all frames
};

/// One recording.
struct TrackingRow {
  std::string set;
  int width_px = 0, height_px = 0;
  int frames = 0, keyframes = 0;
  int max_tracks = 0;
  double tracks = 0;                 ///< median per frame
  double median_ms = 0, p95_ms = 0;  ///< of Frontend::process(), wall time
  double cpu_ms = 0;                 ///< median processor time of it, the device's threads included
  std::vector<TrackingStep> steps;
  /// Tracks per frame, mean: looked for, found near the prediction, found by the wide search after
  /// it, thrown out as against the epipolar geometry, ended as following the same as another, new.
  double sought = 0, found = 0, recovered = 0, outliers = 0, merged = 0, added = 0;
  bool has_truth = false;
  std::array<TrackAge, kTrackAges.size()> ages;
};

struct TrackingReport {
  BenchMachine machine;
  std::vector<TrackingRow> rows;
  bool interrupted = false;
};

/// The tables as text.
void print(const TrackingReport& report, std::ostream& out);
/// A JSON array with one object per row (docs/formats.md).
[[nodiscard]] std::string json_rows(const TrackingReport& report);

}  // namespace corvid
