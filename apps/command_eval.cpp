#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <ostream>
#include <string>

#include "apps/command_list.h"
#include "apps/evaluation.h"
#include "apps/option_checks.h"
#include "apps/program_source.h"
#include "apps/progress.h"
#include "core/log.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr char kRunMarkerFile[] = "run.json", kRunTrajectoryFile[] = "trajectory.txt";

struct Arguments {
  std::string estimate, truth, times;
  std::string align = "sim3";
  EvaluationOptions options;
  double rate_hz = TrajectoryReadOptions{}.rate_hz;
  bool json = false;
};

// A folder is a run: nothing else that is a folder holds an estimate.
fs::path estimate_file(const std::string& name) {
  std::error_code ignored;
  return fs::is_directory(name, ignored) ? fs::path(name) / kRunTrajectoryFile : fs::path(name);
}

// A folder is a run if it says so: a data set may hold a file of that name too.
fs::path truth_file(const std::string& name) {
  std::error_code ignored;
  const bool run = fs::is_regular_file(fs::path(name) / kRunMarkerFile, ignored);
  return run ? fs::path(name) / kRunTrajectoryFile : fs::path(name);
}

Expected<Trajectory> read_truth(const Arguments& arguments, const TrajectoryReadOptions& reading) {
  std::error_code ignored;
  const fs::path file = truth_file(arguments.truth);
  if (file != arguments.truth || fs::is_regular_file(file, ignored)) {
    if (file.extension() == ".csv") {
      log().info(
          "{}: the body's poses, if it is EuRoC's; name the sequence's folder to compare "
          "with the camera's",
          arguments.truth);
    }
    return read_trajectory(file.string(), reading);
  }
  SourceArguments source;
  source.spec = arguments.truth;
  auto opened = source.open();
  if (!opened) return tl::unexpected(opened.error());
  Trajectory truth = (*opened)->truth();
  if (truth.empty()) {
    return fail(ErrorCode::unsupported, "the source has no true trajectory", arguments.truth,
                "name a trajectory file: TUM, KITTI or EuRoC");
  }
  return truth;
}

Json statistics_json(const Statistics& s) {
  if (s.count == 0) return nullptr;
  return {{"count", s.count},   {"rmse", s.rmse}, {"mean", s.mean},
          {"median", s.median}, {"p90", s.p90},   {"max", s.max}};
}

void print_json(const Arguments& arguments, const TrajectoryErrors& e, std::ostream& out) {
  Json kitti = {{"segments", e.kitti.segments},
                {"lengths_m", e.kitti.lengths_m},
                {"t_rel_percent", e.kitti.t_rel_percent},
                {"r_rel_deg_per_100m", e.kitti.r_rel_deg_per_100m},
                {"short_segments", e.kitti.short_segments}};
  write_json_line(out, {{"align", arguments.align},
                        {"matched", e.matched},
                        {"unmatched", e.unmatched},
                        {"interpolated", e.interpolated},
                        {"path_length_m", e.path_length_m},
                        {"scale", e.scale},
                        {"scale_drift", e.scale_drift ? Json(*e.scale_drift) : Json()},
                        {"ate_m", statistics_json(e.position_m)},
                        {"orientation_deg", statistics_json(e.orientation_deg)},
                        {"orientation_constant_deg", e.orientation_constant_deg},
                        {"orientation_rest_deg", e.orientation_rest_deg},
                        {"rpe_delta_frames", arguments.options.rpe_delta_frames},
                        {"rpe_translation_m", statistics_json(e.rpe_translation_m)},
                        {"rpe_rotation_deg", statistics_json(e.rpe_rotation_deg)},
                        {"kitti", kitti},
                        {"notes", e.notes}});
}

void print_text(const Arguments& arguments, const TrajectoryErrors& e, std::ostream& out) {
  const auto row = [&out](std::string_view name, const Statistics& s, std::string_view unit) {
    if (s.count == 0) {
      out << fmt::format("{:<16} none: the trajectory is too short for it\n", name);
      return;
    }
    out << fmt::format("{:<16} {:>10.4f} {:>10.4f} {:>10.4f} {:>10.4f} {:>10.4f}  {}\n", name,
                       s.rmse, s.mean, s.median, s.p90, s.max, unit);
  };
  out << fmt::format("matched          {} poses, {} without truth, {} against interpolated truth\n",
                     e.matched, e.unmatched, e.interpolated);
  out << fmt::format("length           {:.3f} m\n", e.path_length_m);
  out << fmt::format("aligned by       {}, scale {:.6g} m per unit", arguments.align, e.scale);
  if (e.scale_drift) out << fmt::format(", scale drift {:.4f}", *e.scale_drift);
  out << fmt::format("\n{:<16} {:>10} {:>10} {:>10} {:>10} {:>10}\n", "", "rmse", "mean", "median",
                     "90 %", "largest");
  row("ATE", e.position_m, "m");
  row("orientation", e.orientation_deg, "deg");
  out << fmt::format("  of which       {:.4f} deg never change, without them the rmse is {:.4f}\n",
                     e.orientation_constant_deg, e.orientation_rest_deg);
  const int delta = arguments.options.rpe_delta_frames;
  const std::string per = delta == 1 ? "pose" : fmt::format("{} poses", delta);
  row("RPE translation", e.rpe_translation_m, "m per " + per);
  row("RPE rotation", e.rpe_rotation_deg, "deg per " + per);
  if (e.path_length_m > 0) {
    out << fmt::format("ATE of length    {:.3f} %\n", 100 * e.position_m.rmse / e.path_length_m);
  }
  if (e.kitti.segments > 0) {
    out << fmt::format(
        "KITTI            t_rel {:.3f} %, r_rel {:.3f} deg per 100 m, {} segments{}\n",
        e.kitti.t_rel_percent, e.kitti.r_rel_deg_per_100m, e.kitti.segments,
        e.kitti.short_segments ? " of 10 to 80 m: the path is short" : "");
  } else {
    out << "KITTI            the path is too short\n";
  }
  for (const std::string& note : e.notes) out << fmt::format("note             {}\n", note);
}

Expected<ExitCode> run(const Arguments& arguments, Context& context) {
  TrajectoryReadOptions reading;
  reading.times_path = arguments.times;
  reading.rate_hz = arguments.rate_hz;
  const fs::path estimate_path = estimate_file(arguments.estimate);
  const auto estimate = read_trajectory(estimate_path.string(), reading);
  if (!estimate) return tl::unexpected(estimate.error());
  const auto truth = read_truth(arguments, reading);
  if (!truth) return tl::unexpected(truth.error());

  EvaluationOptions options = arguments.options;
  options.alignment = arguments.align == "sim3"  ? AlignmentMode::sim3
                      : arguments.align == "se3" ? AlignmentMode::se3
                                                 : AlignmentMode::none;
  const TrajectoryErrors errors = evaluate(*estimate, *truth, options);
  if (!errors.problem.empty()) {
    return fail(
        ErrorCode::unsupported, errors.problem,
        fmt::format("{} against {}", estimate_path.string(), arguments.truth),
        errors.matched > 0
            ? ""
            : "times must be in the same clock; --max-dt widens what counts as the same time");
  }
  if (arguments.json) {
    print_json(arguments, errors, context.out);
  } else {
    print_text(arguments, errors, context.out);
  }
  return ExitCode::ok;
}

}  // namespace

Action add_eval_command(CLI::App& app) {
  auto a = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand("eval", "Compare a trajectory with the truth");
  command->add_option("ESTIMATE", a->estimate, "Trajectory (TUM, KITTI, EuRoC), or a run's folder")
      ->required();
  command
      ->add_option("TRUTH", a->truth,
                   "Trajectory, a run's folder, or a source that knows its truth")
      ->required();
  command->add_option("--align", a->align, "sim3, se3 or none")
      ->check(CLI::IsMember({"sim3", "se3", "none"}))
      ->capture_default_str();
  command
      ->add_option("--max-dt", a->options.max_time_difference_s,
                   "Largest difference of times that still match [s]")
      ->check(at_least(0))
      ->capture_default_str();
  command->add_option("--delta", a->options.rpe_delta_frames, "Poses apart, for the RPE")
      ->check(at_least(1))
      ->capture_default_str();
  command->add_option("--times", a->times, "One time per row, for KITTI files");
  command->add_option("--frame-rate", a->rate_hz, "Rate of KITTI rows without times [Hz]")
      ->check(above(0))
      ->capture_default_str();
  command->add_flag("--json", a->json, "One JSON object on the standard output");
  command->footer(R"(
Examples:
  corvid eval run ~/data/MH_05
  corvid eval run other-run                   one run against another
  corvid eval run/trajectory.txt truth.txt --align se3 --max-dt 0.02
)");
  return [a](Context& context) { return run(*a, context); };
}

}  // namespace corvid
