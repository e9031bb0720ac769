#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "core/clock.h"
#include "corvid/error.h"
#include "corvid/ports.h"
#include "io/camera/camera_stream.h"

namespace corvid {

struct CameraSourceOptions {
  std::string calibration_path;  ///< empty: assumed, with a note
  /// So many frame intervals without a picture are an interruption, but at least the time [s].
  double stall_intervals = 10, shortest_stall_s = 0.5;
  double reopen_stalled_s = 3;  ///< a stalled stream is closed and opened anew after this [s]
  double first_retry_s = 0.2, longest_retry_s = 5;  ///< back-off of opening: doubled each time [s]
  double blind_interval_s = 1;                      ///< between blind frames [s]
  std::optional<double> duration_s;  ///< after this time it ends; nothing: never by itself
};

/// A camera as a source of the engine, for hours: a camera that is unplugged, stalls or fails is
/// an interruption, reported once in the log and by blind frames, and is opened anew with back-off
/// until it is back. Damaged and lost pictures are counted. It ends when the stream does (a pipe,
/// with an error if it was broken) or when asked to stop.
class CameraSource final : public FrameSource {
 public:
  using Opener = std::function<Expected<std::unique_ptr<CameraStream>>()>;

  /// @param kind, path  for SourceInfo: "V4L2 camera", "/dev/video0".
  /// @param opener  opens the camera, as often as it has to be.
  /// @param clock  outlives the source.
  /// Errors: the opener's (the first time, there must be a camera), the calibration's.
  [[nodiscard]] static Expected<std::unique_ptr<CameraSource>> open(
      std::string kind, std::string path, Opener opener, const CameraSourceOptions& options,
      Clock& clock);

  [[nodiscard]] const SourceInfo& info() const override { return info_; }
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop = {}) override;
  [[nodiscard]] SourceCounts counts() const override;

 private:
  CameraSource(Opener opener, const CameraSourceOptions& options, Clock& clock)
      : opener_(std::move(opener)), options_(options), clock_(clock) {}

  [[nodiscard]] Expected<void> take_camera();
  [[nodiscard]] FramePtr deliver(Capture capture);
  [[nodiscard]] FramePtr blind();
  /// The time without a picture that is an interruption [ns].
  [[nodiscard]] std::int64_t stall_ns() const;
  void interrupt(std::string reason);
  void close();
  void begin();
  void wait_to_retry();
  void reopen();

  Opener opener_;
  CameraSourceOptions options_;
  Clock& clock_;
  SourceInfo info_;
  std::unique_ptr<CameraStream> stream_;  ///< null while the camera is away
  std::string reason_;                    ///< of the interruption; empty if there is none
  std::int64_t opened_ns_ = 0;
  std::optional<std::int64_t> begun_ns_;  ///< when pictures were asked for first
  std::int64_t waiting_since_ns_ = 0;     ///< the last picture's arrival, or the stream's opening
  std::int64_t interrupted_ns_ = 0, blind_due_ns_ = 0, retry_due_ns_ = 0;
  double retry_s_ = 0;  ///< the last wait before opening; 0: pictures came since
  std::uint32_t next_id_ = 0;
  std::optional<std::int64_t> newest_ns_;  ///< time of the last frame
  SourceCounts counts_;                    ///< without those of stream_
};

}  // namespace corvid
