#pragma once

#include <memory>
#include <span>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "bench/matching/matching_report.h"
#include "corvid/error.h"
#include "corvid/options.h"
#include "corvid/ports.h"
#include "kernels/device.h"

namespace corvid {

struct MatchingBenchOptions {
  int pairs = 30;  ///< of a set at most; >= 3
  int runs = 1;    ///< of each piece of work, of which the median time counts; > 0
  MatchingOptions matching;
};

/// A source of images under the name that its row gets.
struct MatchingSet {
  std::string name;
  std::unique_ptr<FrameSource> source;
};

/// Images that are matched with one another, as positions in the source: each with the next one
/// and the next but one. A video gives runs of three (three pairs) spread over its whole length,
/// stills give their first images as one run. What fits into `pairs` >= 3.
/// @param frames  of the source; nothing: unknown, and the runs follow one another from its start.
/// @return (first, count) of each run, ascending, without overlap; empty if frames < 2.
[[nodiscard]] std::vector<std::pair<std::size_t, std::size_t>> choose_runs(
    std::optional<std::size_t> frames, bool stills, int pairs);

/// Measures OpenCV's SIFT and Corvid's pair matching on each set: the same pairs in turn, the same
/// bundle adjustment of each run, the same truth. Kernels are built before anything is timed.
/// Progress goes to log(), a line per pair.
/// @param report  gets each row as it is finished; after a stop also the row of what there is of
///                the set that was cut off.
/// Errors: invalid_argument (options; a set with fewer than two images); device; the source's.
[[nodiscard]] Expected<void> run_matching_bench(const std::shared_ptr<Device>& device,
                                                std::span<const MatchingSet> sets,
                                                const MatchingBenchOptions& options,
                                                const std::stop_token& stop,
                                                MatchingReport& report);

}  // namespace corvid
