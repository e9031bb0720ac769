#include <fmt/chrono.h>
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <ctime>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "apps/camera_arguments.h"
#include "apps/command_flight.h"
#include "apps/command_list.h"
#include "apps/engine_options.h"
#include "apps/live_folder.h"
#include "apps/opencl_trouble.h"
#include "apps/option_checks.h"
#include "apps/program_source.h"
#include "apps/run_folder.h"
#include "apps/service_notifier.h"
#include "apps/signal_guard.h"
#include "core/log.h"
#include "core/source_decorator.h"
#include "io/mavlink/mavlink_link.h"
#include "io/options_file.h"
#include "replay/async_recorder.h"
#include "replay/recording.h"

namespace corvid {
namespace {

struct Arguments {
  CameraArguments camera;
  EngineArguments engine;
  std::string out, record, mavlink;
  std::optional<int> threads;
  int buffer_mb = 1024;
  bool no_mapping = false, json = false, full = false;
};

Expected<Options> resolve(const Arguments& arguments) {
  auto options = arguments.engine.read();
  if (!options) return options;
  if (arguments.threads) options->threads = *arguments.threads;
  if (arguments.no_mapping) options->mapping.enabled = false;
  if (auto checked = check_options(*options, "options"); !checked)
    return tl::unexpected(checked.error());
  return options;
}

/// "live-20260131-154500" in the working folder, unless there is a name.
std::string folder_name(const std::string& out) {
  if (!out.empty()) return out;
  return fmt::format("live-{:%Y%m%d-%H%M%S}", fmt::localtime(std::time(nullptr)));
}

/// What hangs on a live run besides the engine. Opened before it, closed after it.
struct Attached {
  SteadyClock clock;
  ServiceNotifier notifier{clock};
  PositionFeed feed;
  std::unique_ptr<MavlinkLink> mavlink;
  std::unique_ptr<LiveFolder> folder;
  std::unique_ptr<AsyncRecorder> recorder;
  std::string recording;
};

std::string describe(const MavlinkStatistics& s) {
  std::string text = fmt::format(
      "MAVLink: {} packets sent, {} dropped by the line; {} measured poses, {} extrapolated, {} "
      "overtaken, {} stale; {} packets received, {} positions.",
      s.sent, s.dropped, s.odometry.measured, s.odometry.extrapolated, s.odometry.late,
      s.odometry.stale, s.parser.packets, s.received.positions);
  if (s.failures > 0)
    text += fmt::format(" The line broke {} times, the last time: {}.", s.failures, s.last_failure);
  return text;
}

/// What the report says of them.
std::vector<std::string> notes_of(const Attached& attached) {
  std::vector<std::string> notes;
  if (attached.mavlink) notes.push_back(describe(attached.mavlink->statistics()));
  if (attached.recorder) {
    const RecorderCounts counts = attached.recorder->counts();
    notes.push_back(
        fmt::format("Recording {}: {} frames, {} dropped, {} refused{}.", attached.recording,
                    counts.written + counts.waiting, counts.dropped, counts.refused,
                    attached.recorder->failure()
                        ? "; it ended early: " + attached.recorder->failure()->to_string()
                        : ""));
  }
  return notes;
}

Expected<void> attach(const Arguments& arguments, FlightPlan& plan, Attached& attached) {
  if (!arguments.mavlink.empty()) {
    auto options = mavlink_options(arguments.mavlink);
    if (!options) return tl::unexpected(options.error());
    auto link = MavlinkLink::open(*options, attached.clock, &attached.feed);
    if (!link) return tl::unexpected(link.error());
    attached.mavlink = std::move(*link);
    plan.listeners.push_back(attached.mavlink.get());
  }
  auto folder = LiveFolder::create(
      plan.out, fmt::format("corvid {} live, {}", CORVID_VERSION, describe(plan.source->info())));
  if (!folder) return tl::unexpected(folder.error());
  attached.folder = std::move(*folder);
  if (!arguments.record.empty()) {
    auto writer = open_recording(arguments.record, std::nullopt, plan.source->info());
    if (!writer) return tl::unexpected(writer.error());
    RecorderOptions options;
    options.buffer_bytes = static_cast<std::size_t>(arguments.buffer_mb) << 20;
    options.threads = recorder_threads();
    attached.recorder = std::make_unique<AsyncRecorder>(std::move(*writer), options);
    attached.recording = arguments.record;
    plan.source = std::make_unique<RecordedSource>(std::move(plan.source), *attached.recorder);
  }
  plan.listeners.push_back(attached.folder.get());
  plan.map = attached.folder.get();
  plan.listeners.push_back(&attached.notifier);
  plan.feed = &attached.feed;
  plan.closing_notes = [&attached] { return notes_of(attached); };
  return {};
}

/// Says when a source has ended.
class EndingSource final : public SourceDecorator {
 public:
  EndingSource(std::unique_ptr<FrameSource> source, std::function<void()> ended)
      : SourceDecorator(std::move(source)), ended_(std::move(ended)) {}
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop) override {
    auto frame = SourceDecorator::next(stop);
    if (!frame || !*frame) ended_();
    return frame;
  }

 private:
  std::function<void()> ended_;
};

Expected<ExitCode> run(const Arguments& arguments, Context& context) {
  const SignalGuard signals;
  Attached attached;  // outlives the source, which asks its clock
  FlightPlan plan;
  plan.live = true;
  plan.brief = !arguments.full;
  plan.json = arguments.json;
  plan.out = folder_name(arguments.out);
  auto options = resolve(arguments);
  if (!options) return tl::unexpected(options.error());
  plan.options = *options;
  // Before anything is made that would lie about.
  if (auto free = check_run_folder(plan.out); !free) return tl::unexpected(free.error());
  auto engine = open_explained([&] { return Engine::create(plan.options); });
  if (!engine) return tl::unexpected(engine.error());
  plan.engine = std::move(*engine);
  auto camera = arguments.camera.open(attached.clock, signals.token());
  if (!camera) return tl::unexpected(camera.error());
  plan.source = std::move(*camera);
  if (auto done = attach(arguments, plan, attached); !done) {
    if (attached.folder) attached.folder->remove();
    return tl::unexpected(done.error());
  }
  plan.source = std::make_unique<EndingSource>(std::move(plan.source),
                                               [&] { attached.notifier.finishing(); });
  const std::stop_callback stopping(signals.token(), [&] {
    attached.notifier.stopping();
    attached.folder->hurry();
  });

  auto code = fly(std::move(plan), signals, context);
  if ((code && *code != ExitCode::failure) || attached.folder->empty()) {
    attached.folder->remove();
  } else {
    log().warn("what was written while it flew is in {}", attached.folder->path().string());
  }
  if (attached.recorder) {
    log().info("recording: writing what waits");
    if (auto finished = attached.recorder->finish(); !finished)
      return tl::unexpected(finished.error());
  }
  return code;
}

}  // namespace

Action add_live_command(CLI::App& app) {
  auto a = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand(
      "live", "Fly with a camera: poses while it flies, map, mesh and report at the end");
  a->camera.add_to(*command)->required();
  command->add_option("--calibration", a->camera.source.calibration_path,
                      "Camera calibration file (docs/formats.md); without one the focal length is "
                      "guessed and estimated");
  command->add_flag("--grey", a->camera.grey, "Do not keep the pictures' colour");
  command->add_option("--out", a->out,
                      "Folder to write at the end; while it flies OUT.live has the poses and the "
                      "sparse map. Default: live-DATE-TIME");
  command->add_option("--record", a->record,
                      "Also record the pictures: a folder, or a video .mkv (without loss) or .avi");
  command
      ->add_option("--buffer-mb", a->buffer_mb,
                   "Memory for pictures of the recording that wait for the disk [MB]")
      ->capture_default_str()
      ->check(at_least(1));
  command->add_option("--mavlink", a->mavlink, kMavlinkHelp);
  a->engine.add_to(*command);
  command->add_option("--threads", a->threads, "CPU budget; 0: all cores");
  command->add_flag("--no-mapping", a->no_mapping, "No depth maps, voxels and mesh");
  command->add_flag("--full", a->full,
                    "Also write mesh.glb, the COLMAP model and depth maps at the end, which takes "
                    "long after a long flight");
  command->add_flag("--json", a->json,
                    "One line of JSON per event on the standard output (docs/user-guide.md)");
  command->footer(R"(
Ctrl-C or SIGTERM ends the flight: the folder is saved within seconds, and the exit code is 0. A
camera that is unplugged or stands still makes the engine lost; it is opened anew when it is back.

Examples:
  corvid live --camera v4l2:/dev/video0 --calibration cam.yaml --out flight
  corvid live --camera libcamera:/base/soc/i2c0mux/i2c@1/imx219@10 --camera-rate 30 --exposure 4
  corvid live --camera v4l2:/dev/video0 --mavlink serial:/dev/ttyS0:921600 --record flight.mkv
  ffmpeg -re -i video.mp4 -f yuv4mpegpipe - | corvid live --camera y4m:- --out flight
)");
  return [a](Context& context) { return run(*a, context); };
}

}  // namespace corvid
