#pragma once

#include <cstdint>
#include <deque>
#include <optional>

namespace corvid {

/// How far another's clock is ahead of ours, from questions and answers (TIMESYNC): of the last
/// ones, the answer that came back quickest is off by half of its way's duration at most.
class ClockOffset {
 public:
  static constexpr std::size_t kAnswers = 16;
  /// @param theirs_ns  between asked_ns and answered_ns, which are ours. No time is negative; an
  ///                   answer with one is left out.
  void add(std::int64_t asked_ns, std::int64_t theirs_ns, std::int64_t answered_ns);
  /// Theirs minus ours; nothing before the first answer.
  [[nodiscard]] std::optional<std::int64_t> offset_ns() const;

 private:
  struct Answer {
    std::int64_t way_ns = 0, offset_ns = 0;
  };
  std::deque<Answer> answers_;
};

}  // namespace corvid
