#include "io/mavlink/mavlink_link.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <utility>

#include "core/log.h"

namespace corvid {
namespace {

constexpr std::int64_t kLeastPause_ns = 250'000'000, kMostPause_ns = 5'000'000'000;
constexpr std::int64_t kMostWait_ns = 1'000'000'000;

}  // namespace

Expected<std::unique_ptr<MavlinkLink>> MavlinkLink::open(const MavlinkOptions& options,
                                                         Clock& clock, PositionFeed* positions) {
  std::unique_ptr<MavlinkLine> line =
      options.carrier == MavlinkCarrier::serial ? serial_line(options) : udp_line(options);
  if (auto opened = line->open(); !opened) return tl::unexpected(opened.error());
  std::unique_ptr<MavlinkLink> link(new MavlinkLink(std::move(line), options, clock, positions));
  if (link->wake_.get() < 0) return fail(ErrorCode::io, "no event descriptor is left");
  link->thread_ = std::jthread([raw = link.get()](const std::stop_token& stop) { raw->run(stop); });
  return link;
}

MavlinkLink::MavlinkLink(std::unique_ptr<MavlinkLine> line, const MavlinkOptions& options,
                         Clock& clock, PositionFeed* positions)
    : line_(std::move(line)),
      clock_(clock),
      wake_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)),
      local_port_(line_->local_port()),
      node_(options.node, positions) {}

MavlinkLink::~MavlinkLink() {
  thread_.request_stop();
  wake();
}

void MavlinkLink::wake() const {
  const std::uint64_t one = 1;
  // A full counter wakes as well.
  [[maybe_unused]] const ssize_t written = ::write(wake_.get(), &one, sizeof one);
}

void MavlinkLink::on_pose(const PoseEvent& event) {
  const std::int64_t arrival_ns = clock_.now_ns();
  {
    const std::lock_guard lock(mutex_);
    if (newest_) ++replaced_;
    newest_ = Waiting{event, arrival_ns};
  }
  wake();
}

MavlinkStatistics MavlinkLink::statistics() const {
  const std::lock_guard lock(mutex_);
  MavlinkStatistics statistics = published_;
  statistics.replaced = replaced_;
  return statistics;
}

void MavlinkLink::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    if (line_->descriptor() < 0) reopen(clock_.now_ns());
    if (line_->descriptor() >= 0) read();
    take_event();
    node_.tick(clock_.now_ns());
    write();
    publish();
    wait();
  }
}

void MavlinkLink::wait() {
  std::array<pollfd, 2> fds{pollfd{wake_.get(), POLLIN, 0}, pollfd{line_->descriptor(), POLLIN, 0}};
  const std::int64_t now_ns = clock_.now_ns();
  std::int64_t until_ns = std::min(node_.next_due_ns(), now_ns + kMostWait_ns);
  if (line_->descriptor() < 0) until_ns = std::min(until_ns, retry_ns_);
  const std::int64_t left_ns = std::max(until_ns, now_ns) - now_ns;
  const timespec left{left_ns / 1'000'000'000, left_ns % 1'000'000'000};
  // poll(2) leaves out a descriptor of -1.
  if (::ppoll(fds.data(), fds.size(), &left, nullptr) <= 0) return;
  std::uint64_t count = 0;
  [[maybe_unused]] const ssize_t got = ::read(wake_.get(), &count, sizeof count);
}

void MavlinkLink::read() {
  std::array<std::uint8_t, 2048> bytes{};
  // A flood must not keep the link from sending.
  for (int reads = 0; reads < 16; ++reads) {
    const auto n = line_->read(bytes);
    if (!n) return broke(n.error());
    if (*n == 0) return;
    works();
    const std::uint64_t before = node_.good_packets();
    const std::int64_t now_ns = clock_.now_ns();
    node_.on_bytes({bytes.data(), *n}, line_->datagrams(), now_ns);
    if (node_.good_packets() > before) line_->partner_speaks(now_ns);
  }
}

void MavlinkLink::take_event() {
  std::optional<Waiting> waiting;
  {
    const std::lock_guard lock(mutex_);
    waiting = std::exchange(newest_, std::nullopt);
  }
  if (waiting) node_.on_pose(waiting->event, waiting->arrival_ns);
}

void MavlinkLink::write() {
  std::deque<MavlinkOutgoing> packets = std::exchange(kept_, {});
  for (MavlinkOutgoing& packet : node_.take_outgoing()) packets.push_back(std::move(packet));
  for (MavlinkOutgoing& packet : packets) {
    if (line_->descriptor() >= 0) {
      const auto sent = line_->write(packet.bytes);
      if (sent && *sent) {
        works();
        ++now_.sent;
        continue;
      }
      if (!sent) broke(sent.error());
    }
    if (packet.lasting()) {
      now_.dropped += std::erase_if(kept_, [&](const auto& k) { return k.id == packet.id; });
      kept_.push_back(std::move(packet));
    } else {
      ++now_.dropped;
    }
  }
}

void MavlinkLink::reopen(std::int64_t now_ns) {
  if (now_ns < retry_ns_) return;
  if (const auto opened = line_->open(); !opened) return broke(opened.error());
  ++now_.reconnections;
  kept_.clear();
  node_.on_line_opened();
}

// A line that can be opened but breaks at once must not be opened all the time.
void MavlinkLink::works() {
  if (std::exchange(pause_ns_, 0) > 0) log().info("MAVLink: the line is open again");
}

void MavlinkLink::broke(const Error& error) {
  if (pause_ns_ == 0) log().warn("MAVLink: {}; trying again", error.to_string());
  line_->close();
  ++now_.failures;
  now_.last_failure = error.to_string();
  pause_ns_ = std::clamp(2 * pause_ns_, kLeastPause_ns, kMostPause_ns);
  retry_ns_ = clock_.now_ns() + pause_ns_;
}

void MavlinkLink::publish() {
  now_.odometry = node_.odometry();
  now_.received = node_.received();
  now_.parser = node_.parser();
  if (const auto offset_ns = node_.autopilot_offset_ns()) {
    now_.autopilot_clock_ahead_s = 1e-9 * static_cast<double>(*offset_ns);
  }
  const std::lock_guard lock(mutex_);
  published_ = now_;
}

}  // namespace corvid
