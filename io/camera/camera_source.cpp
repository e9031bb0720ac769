#include "io/camera/camera_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "core/log.h"
#include "core/messages.h"
#include "io/source_images.h"

namespace corvid {
namespace {

constexpr std::chrono::milliseconds kSlice(100);  // waited at once, so that all else has its turn
constexpr double kFresh_s = 0.3;                  // between opening and the first picture taken
constexpr double kUnknownRate_hz = 5;             // when the driver says none

std::int64_t ns(double seconds) { return std::llround(1e9 * seconds); }

void add(SourceCounts& sum, const StreamCounts& stream) {
  sum.lost += stream.lost;
  sum.skipped += stream.damaged;
  for (const std::string& message : stream.messages) add_message(sum.messages, message);
}

}  // namespace

Expected<std::unique_ptr<CameraSource>> CameraSource::open(std::string kind, std::string path,
                                                           Opener opener,
                                                           const CameraSourceOptions& options,
                                                           Clock& clock) {
  CORVID_CHECK(opener != nullptr, "a camera needs something that opens it");
  std::unique_ptr<CameraSource> source(new CameraSource(std::move(opener), options, clock));
  source->info_.kind = std::move(kind);
  source->info_.path = std::move(path);
  auto stream = source->opener_();
  if (!stream) return tl::unexpected(stream.error());
  source->stream_ = std::move(*stream);
  source->opened_ns_ = source->waiting_since_ns_ = clock.now_ns();
  if (auto taken = source->take_camera(); !taken) return tl::unexpected(taken.error());
  return source;
}

Expected<void> CameraSource::take_camera() {
  const StreamSettings& set = stream_->settings();
  info_.rate_hz = set.rate_hz;
  info_.paced = true;
  info_.colour = set.colour;
  info_.notes = set.notes;
  info_.notes.insert(info_.notes.begin(), fmt::format("format {}", set.format));
  return take_calibration(options_.calibration_path, set.width_px, set.height_px, info_);
}

std::int64_t CameraSource::stall_ns() const {
  const double rate_hz = info_.rate_hz > 0 ? info_.rate_hz : kUnknownRate_hz;
  return ns(std::max(options_.shortest_stall_s, options_.stall_intervals / rate_hz));
}

Expected<FramePtr> CameraSource::next(const std::stop_token& stop) {
  if (!begun_ns_) begin();
  while (!stop.stop_requested()) {
    if (options_.duration_s && clock_.now_ns() - *begun_ns_ >= ns(*options_.duration_s)) break;
    if (!stream_) {
      const std::int64_t now_ns = clock_.now_ns();
      if (now_ns >= blind_due_ns_) return blind();
      if (now_ns >= retry_due_ns_) {
        reopen();
      } else {
        clock_.sleep_until(std::min(blind_due_ns_, retry_due_ns_), stop);
      }
      continue;
    }
    auto capture = stream_->next(kSlice, stop);
    if (!capture) {
      if (stream_->ended()) return tl::unexpected(capture.error());
      interrupt(capture.error().to_string());
      close();
      continue;
    }
    if (*capture) return deliver(std::move(**capture));
    if (stream_->ended()) return nullptr;
    const std::int64_t now_ns = clock_.now_ns();
    const std::int64_t still_ns = now_ns - waiting_since_ns_;
    if (still_ns >= stall_ns())
      interrupt(fmt::format("{}: no pictures come any more: the camera stands still", info_.path));
    if (still_ns >= stall_ns() + ns(options_.reopen_stalled_s) && stream_->reopens()) close();
    if (!reason_.empty() && now_ns >= blind_due_ns_) return blind();
  }
  return nullptr;
}

void CameraSource::interrupt(std::string reason) {
  if (reason == reason_) return;
  if (reason_.empty()) {
    ++counts_.interruptions;
    interrupted_ns_ = clock_.now_ns();
    blind_due_ns_ = interrupted_ns_;
  }
  reason_ = std::move(reason);
  log().warn("{}", reason_);
}

void CameraSource::close() {
  add(counts_, stream_->counts());
  stream_.reset();
  wait_to_retry();
}

/// Twice as long as before, until a picture comes.
void CameraSource::wait_to_retry() {
  retry_s_ =
      retry_s_ > 0 ? std::min(2 * retry_s_, options_.longest_retry_s) : options_.first_retry_s;
  retry_due_ns_ = clock_.now_ns() + ns(retry_s_);
}

/// What was opened long before anybody takes pictures would give old ones first.
void CameraSource::begin() {
  const std::int64_t now_ns = clock_.now_ns();
  begun_ns_ = waiting_since_ns_ = now_ns;
  if (now_ns - opened_ns_ < ns(kFresh_s) || !stream_->reopens()) return;
  stream_.reset();
  reopen();
}

void CameraSource::reopen() {
  auto stream = opener_();
  std::string why;
  if (!stream) {
    why = stream.error().to_string();
  } else if (const StreamSettings& set = (*stream)->settings();
             set.width_px != info_.camera->width_px || set.height_px != info_.camera->height_px) {
    why = fmt::format("{}: the camera now gives {} x {} pixels, not {} x {}", info_.path,
                      set.width_px, set.height_px, info_.camera->width_px, info_.camera->height_px);
  } else {
    stream_ = std::move(*stream);
    waiting_since_ns_ = clock_.now_ns();
    return;
  }
  interrupt(std::move(why));
  wait_to_retry();
}

FramePtr CameraSource::deliver(Capture capture) {
  waiting_since_ns_ = clock_.now_ns();
  retry_s_ = 0;
  if (!reason_.empty()) {
    log().info("{}: the camera is back after {:.1f} s", info_.path,
               1e-9 * static_cast<double>(waiting_since_ns_ - interrupted_ns_));
    reason_.clear();
  }
  auto frame = std::make_shared<Frame>();
  frame->id = FrameId(next_id_++);
  frame->time_ns = capture.time_ns;
  frame->camera = info_.camera;
  frame->grey = std::move(capture.grey);
  frame->colour = std::move(capture.colour);
  newest_ns_ = capture.time_ns;
  ++counts_.delivered;
  return frame;
}

/// Its time is older than that of any picture that may still come, and later than the last one's.
FramePtr CameraSource::blind() {
  const std::int64_t now_ns = clock_.now_ns();
  blind_due_ns_ = now_ns + ns(options_.blind_interval_s);
  auto frame = std::make_shared<Frame>();
  frame->id = FrameId(next_id_++);
  frame->time_ns = now_ns - stall_ns();
  if (newest_ns_) frame->time_ns = std::max(frame->time_ns, *newest_ns_ + 1);
  newest_ns_ = frame->time_ns;
  frame->camera = info_.camera;
  frame->blind = reason_;
  return frame;
}

SourceCounts CameraSource::counts() const {
  SourceCounts counts = counts_;
  if (stream_) add(counts, stream_->counts());
  return counts;
}

}  // namespace corvid
