#pragma once

#include <string>
#include <vector>

#include "apps/report_numbers.h"
#include "apps/run_folder.h"
#include "io/colmap_writer.h"

namespace corvid {

/// A file or subfolder of the run's folder, for the report's list.
struct ReportFile {
  std::string name;
  std::string about;
  std::uintmax_t bytes = 0;
};

/// Everything that report.html and run.json say.
struct ReportFacts {
  const RunReportInput& input;
  RunNumbers numbers;
  MachineInfo machine;
  std::string options_yaml;
  std::vector<ColmapModel> colmap;
  std::vector<ReportFile> files;
};

/// Mesh and depth maps with their pictures, for report_html(). Needs no `colmap` and no `files`, so
/// that it can be drawn while these are written.
[[nodiscard]] std::string report_pictures(const ReportFacts& facts);
/// One self-contained page: inline style, SVG plots, pictures as data; no script, no request.
/// @param pictures  report_pictures().
[[nodiscard]] std::string report_html(const ReportFacts& facts, const std::string& pictures);

/// The same numbers, schema in docs/formats.md.
[[nodiscard]] std::string report_json(const ReportFacts& facts);
/// Unit of length of the run's results.
[[nodiscard]] inline const char* unit_of(const RunResult& result) {
  return result.enu_origin ? "m" : "map units";
}

inline constexpr int kRunSchemaVersion = 1;

// Parts of the page, each one <section> (report_sections.cpp, report_map_sections.cpp).
[[nodiscard]] std::string trajectory_section(const ReportFacts& facts);
[[nodiscard]] std::string truth_section(const ReportFacts& facts);
[[nodiscard]] std::string tracking_section(const ReportFacts& facts);
[[nodiscard]] std::string timing_section(const ReportFacts& facts);
[[nodiscard]] std::string frames_section(const ReportFacts& facts);
[[nodiscard]] std::string map_section(const ReportFacts& facts);
[[nodiscard]] std::string depth_section(const ReportFacts& facts);
[[nodiscard]] std::string mesh_section(const ReportFacts& facts);

}  // namespace corvid
