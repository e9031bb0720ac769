#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <map>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <utility>

#include "apps/camera_arguments.h"
#include "apps/command_list.h"
#include "apps/option_checks.h"
#include "apps/program_source.h"
#include "apps/progress.h"
#include "apps/signal_guard.h"
#include "core/clock.h"
#include "core/log.h"
#include "replay/async_recorder.h"
#include "replay/recording.h"

namespace corvid {
namespace {

struct Arguments {
  SourceArguments source;
  CameraArguments camera;
  std::string out;
  std::optional<RecordingFormat> format;
  int buffer_mb = 1024, threads = 0;
};

double megabytes(std::uint64_t bytes) { return static_cast<double>(bytes) / (1 << 20); }

/// "1234 frames  20.0 frames/s  512 MB on disk  3 of 1024 MB waiting  0 dropped", ten times a
/// second.
class RecordingLine {
 public:
  RecordingLine(bool drawn, int buffer_mb) : drawn_(drawn), buffer_mb_(buffer_mb) {}
  ~RecordingLine() {
    if (drawn_) draw_progress("");
  }
  RecordingLine(const RecordingLine&) = delete;
  RecordingLine& operator=(const RecordingLine&) = delete;

  void draw(const RecorderCounts& counts) {
    const std::int64_t now_ns = clock_.now_ns();
    if (!drawn_ || now_ns - drawn_ns_ < 100'000'000) return;
    drawn_ns_ = now_ns;
    const double elapsed_s = static_cast<double>(now_ns - start_ns_) * 1e-9;
    draw_progress(fmt::format(
        "{} frames  {:.1f} frames/s  {:.0f} MB on disk  {:.0f} of {} MB waiting  {} dropped",
        counts.written, static_cast<double>(counts.written) / std::max(elapsed_s, 1e-3),
        megabytes(counts.bytes), megabytes(counts.waiting_bytes), buffer_mb_, counts.dropped));
  }

 private:
  const bool drawn_;
  const int buffer_mb_;
  SteadyClock clock_;
  const std::int64_t start_ns_ = clock_.now_ns();
  std::int64_t drawn_ns_ = 0;
};

RecorderOptions recorder_options(const Arguments& arguments) {
  RecorderOptions options;
  options.buffer_bytes = static_cast<std::size_t>(arguments.buffer_mb) << 20;
  options.threads = arguments.threads > 0 ? arguments.threads : recorder_threads();
  return options;
}

/// All frames of the source into the recording. An error is the source's or the recording's own;
/// what was recorded until then is complete all the same.
Expected<void> record(RecordedSource& source, AsyncRecorder& recorder, RecordingLine& line,
                      const std::stop_token& stop) {
  Expected<void> result;
  while (!stop.stop_requested() && !recorder.failure()) {
    const auto frame = source.next(stop);
    if (!frame) result = tl::unexpected(frame.error());
    if (!frame || !*frame) break;
    line.draw(recorder.counts());
  }
  log_skipped(source.counts());
  auto finished = recorder.finish([&](const RecorderCounts& counts) { line.draw(counts); });
  return finished ? result : finished;
}

Expected<std::unique_ptr<FrameSource>> open(const Arguments& arguments, Clock& clock,
                                            const std::stop_token& stop) {
  if (arguments.camera.spec.empty() && arguments.source.spec.empty()) {
    return fail(ErrorCode::invalid_argument, "there is nothing to record", "",
                "name a SOURCE or a --camera");
  }
  if (arguments.camera.spec.empty()) return arguments.source.open();
  CameraArguments camera = arguments.camera;
  camera.source.calibration_path = arguments.source.options.calibration_path;
  camera.grey = !arguments.source.options.colour;
  return camera.open(clock, stop);
}

Expected<ExitCode> run(const Arguments& arguments, Context& context) {
  const SignalGuard signals;
  SteadyClock clock;
  auto source = open(arguments, clock, signals.token());
  if (!source) return tl::unexpected(source.error());
  const SourceInfo info = (*source)->info();
  log().info("recording {}", describe(info));
  auto writer = open_recording(arguments.out, arguments.format, info);
  if (!writer) return tl::unexpected(writer.error());
  if (const Trajectory truth = (*source)->truth(); !truth.empty()) {
    const auto kept = (*writer)->write_truth(truth);
    if (!kept) return tl::unexpected(kept.error());
    if (!*kept) log().info("the true trajectory is not recorded: only a folder has a place for it");
  }
  AsyncRecorder recorder(std::move(*writer), recorder_options(arguments));
  RecordingLine line(context.terminal && !context.quiet, arguments.buffer_mb);
  RecordedSource recorded(std::move(*source), recorder);
  const auto result = record(recorded, recorder, line, signals.token());
  const RecorderCounts counts = recorder.counts();
  const SourceCounts seen = recorded.counts();
  context.out << fmt::format("{} frames, {} skipped, {} dropped{}: {}\n", counts.written,
                             seen.skipped + counts.refused, counts.dropped,
                             info.paced ? fmt::format(", {} lost by the camera, {} times away",
                                                      seen.lost, seen.interruptions)
                                        : "",
                             arguments.out);
  if (!result) return tl::unexpected(result.error());
  // A camera has no other end than being stopped.
  const bool endless = info.paced && !info.frames;
  if (signals.token().stop_requested()) return endless ? ExitCode::ok : ExitCode::interrupted;
  if (counts.written == 0) {
    return fail(ErrorCode::corrupt, "not one frame could be read", info.path,
                "`corvid info --check` says why");
  }
  return ExitCode::ok;
}

}  // namespace

Action add_record_command(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand(
      "record", "Write a source as an ASL (EuRoC) folder or a video, with its capture times");
  arguments->source.add_to(*command);
  CLI::Option* source = command->get_option("SOURCE")->required(false);
  arguments->camera.add_to(*command)->excludes(source);
  command
      ->add_option(
          "--out", arguments->out,
          "Folder (ASL, PNG), .mkv (FFV1, without loss) or .avi (MJPEG) to write; there must "
          "be no recording of that name yet")
      ->required();
  static const std::map<std::string, RecordingFormat> kFormats = {
      {"asl", RecordingFormat::asl},
      {"ffv1", RecordingFormat::ffv1},
      {"mjpeg", RecordingFormat::mjpeg}};
  command
      ->add_option_function<std::string>(
          "--format",
          [arguments](const std::string& name) { arguments->format = kFormats.at(name); },
          "asl, ffv1 or mjpeg, instead of what the name of --out says")
      ->check(CLI::IsMember({"asl", "ffv1", "mjpeg"}));
  command
      ->add_option(
          "--buffer-mb", arguments->buffer_mb,
          "Memory for pictures that wait for the disk [MB]; when it is full a camera's frames "
          "are dropped and counted, a file waits")
      ->capture_default_str()
      ->check(at_least(1));
  command
      ->add_option("--threads", arguments->threads,
                   "Threads that encode; 0: one per core, at most 4")
      ->capture_default_str()
      ->check(at_least(0));
  command->footer(R"(
Ctrl-C writes what waits and completes the recording: exit code 130, or 0 for a camera, which has no
other end.

Examples:
  corvid record video.mp4 --calibration cam.yaml --out recording
  corvid record --camera v4l2:/dev/video0 --size 640x480 --out flight.mkv
  corvid record synthetic:seed=3,duration=10 --out town.mkv
)");
  return [arguments](Context& context) { return run(*arguments, context); };
}

}  // namespace corvid
