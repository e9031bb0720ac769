#pragma once

#include <functional>

#include "apps/program.h"
#include "corvid/error.h"

namespace CLI {
class App;
}

namespace corvid {

/// What runs when its subcommand was chosen and its arguments are parsed.
using Action = std::function<Expected<ExitCode>(Context&)>;

/// Each adds one subcommand with its arguments, help and examples (one file per command).
Action add_replay_command(CLI::App& app);
Action add_info_command(CLI::App& app);
Action add_export_command(CLI::App& app);
Action add_eval_command(CLI::App& app);
Action add_record_command(CLI::App& app);
Action add_doctor_command(CLI::App& app);
Action add_demo_command(CLI::App& app);
Action add_options_command(CLI::App& app);
Action add_match_command(CLI::App& app);
Action add_mvs_command(CLI::App& app);
Action add_bench_command(CLI::App& app);
Action add_live_command(CLI::App& app);
Action add_cameras_command(CLI::App& app);

/// A subcommand of `bench` in a file of its own.
Action add_bench_tracking(CLI::App& group);
Action add_bench_mapping(CLI::App& group);

}  // namespace corvid
