#pragma once

#include <iosfwd>
#include <optional>
#include <string>
#include <vector>

#include "bench/machine.h"

namespace corvid {

/// What one side made of some pairs.
struct PairFigures {
  int pairs = 0;
  long matches = 0;                               ///< sum over the pairs
  std::optional<double> truth_px, wrong_percent;  ///< median distance; share beyond kWrong_px
  double ms = 0, slowest_ms = 0;                  ///< median over the pairs; largest
};

/// One side on one set.
struct SideFigures {
  PairFigures all, gap1, gap2;    ///< all pairs; images that follow each other; every second one
  int points = 0;                 ///< 3-d
  int posed_images = 0;           ///< that the bundle adjustment has
  std::optional<double> mse_px2;  ///< (3.15)
  std::optional<double> images_per_point;  ///< mean
  std::optional<double> used_percent;      ///< matches that are part of a 3-d point
};

/// One set of images.
struct MatchingRow {
  std::string set;
  int width_px = 0, height_px = 0, images = 0;
  SideFigures sift, corvid;

  /// Corvid's matches, 3-d points and error over SIFT's, and SIFT's time over Corvid's.
  [[nodiscard]] std::optional<double> matches_ratio() const, points_ratio() const,
      mse_ratio() const, time_ratio() const;
};

struct MatchingReport {
  BenchMachine machine;
  int runs = 0;
  std::vector<MatchingRow> rows;
  bool interrupted = false;
};

/// The tables as text.
void print(const MatchingReport& report, std::ostream& out);
/// A JSON array with one object per set (docs/formats.md).
[[nodiscard]] std::string json_rows(const MatchingReport& report);

}  // namespace corvid
