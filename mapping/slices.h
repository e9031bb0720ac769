#pragma once

#include <functional>
#include <utility>

namespace corvid {

/// Called between slices of a few milliseconds of long work on the host; may wait, so that others
/// get the processor. May be empty.
using SliceEnd = std::function<void()>;

/// Ends a slice after every so many pieces of work.
class Slicer {
 public:
  Slicer(SliceEnd end, int pieces) : end_(std::move(end)), pieces_(pieces) {}
  void piece() {
    if (++done_ < pieces_) return;
    done_ = 0;
    if (end_) end_();
  }

 private:
  SliceEnd end_;
  int pieces_, done_ = 0;
};

}  // namespace corvid
