#pragma once

#include <memory>
#include <utility>

#include "core/check.h"
#include "corvid/ports.h"

namespace corvid {

/// A source that hands on another one as it is; what is derived from it changes a part of that.
class SourceDecorator : public FrameSource {
 public:
  explicit SourceDecorator(std::unique_ptr<FrameSource> source) : source_(std::move(source)) {
    CORVID_CHECK(source_ != nullptr, "there is no source");
  }
  [[nodiscard]] const SourceInfo& info() const override { return source_->info(); }
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop = {}) override {
    return source_->next(stop);
  }
  [[nodiscard]] SourceCounts counts() const override { return source_->counts(); }
  [[nodiscard]] Trajectory truth() const override { return source_->truth(); }
  [[nodiscard]] std::vector<PositionFix> positions() const override { return source_->positions(); }
  [[nodiscard]] std::optional<TriangleMesh> true_surface() const override {
    return source_->true_surface();
  }

 private:
  std::unique_ptr<FrameSource> source_;
};

}  // namespace corvid
