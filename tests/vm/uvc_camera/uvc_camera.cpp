// A USB camera in user space, plugged into the kernel's own vhci-hcd: uvcvideo takes it for a real
// one. Needs the modules vhci-hcd and uvcvideo, and root.
//   uvc_camera PORT
// Sends numbered pictures (numbered_picture.h). Commands come as lines from standard input; each is
// answered by a line with the number of the next picture:
//   count    nothing else happens
//   pause    no more pictures, until: resume
//   cut      the next picture ends in its middle
//   fault    the next picture is marked as faulty
// The end of standard input unplugs it.
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "vm/numbered_picture.h"
#include "vm/uvc_camera/usbip.h"
#include "vm/uvc_camera/uvc_device.h"

#include <jpeglib.h>  // takes FILE as given

namespace corvid::vm {
namespace {

using Bytes = std::vector<std::uint8_t>;
using Time = std::chrono::steady_clock::time_point;

Bytes jpeg_of(Bytes luma, const UvcSize& size) {
  jpeg_error_mgr errors;
  jpeg_compress_struct jpeg{};
  jpeg.err = jpeg_std_error(&errors);
  jpeg_create_compress(&jpeg);
  unsigned char* data = nullptr;
  unsigned long length = 0;
  jpeg_mem_dest(&jpeg, &data, &length);
  jpeg.image_width = size.width_px;
  jpeg.image_height = size.height_px;
  jpeg.input_components = 1;
  jpeg.in_color_space = JCS_GRAYSCALE;
  jpeg_set_defaults(&jpeg);
  jpeg_set_quality(&jpeg, 95, TRUE);
  jpeg_start_compress(&jpeg, TRUE);
  for (std::size_t y = 0; y < size.height_px; ++y) {
    JSAMPROW row = luma.data() + y * size.width_px;
    jpeg_write_scanlines(&jpeg, &row, 1);
  }
  jpeg_finish_compress(&jpeg);
  jpeg_destroy_compress(&jpeg);
  Bytes bytes(data, data + length);
  std::free(data);  // NOLINT: libjpeg's own
  return bytes;
}

Bytes picture(const UvcMode& mode, std::uint32_t number) {
  const UvcSize size = mode.size();
  Bytes luma = numbered_picture(size.width_px, size.height_px, number);
  if (mode.format == UvcFormat::mjpg) return jpeg_of(std::move(luma), size);
  if (mode.format == UvcFormat::grey) return luma;
  Bytes pairs(2 * luma.size(), 128);
  for (std::size_t i = 0; i < luma.size(); ++i) pairs[2 * i] = luma[i];
  return pairs;
}

class UvcCamera {
 public:
  explicit UvcCamera(int port) : device_(port), cable_(port) {}
  void run();

 private:
  [[nodiscard]] int wait_ms() const;
  void serve();
  void serve_control(const UsbRequest& request);
  void serve_unlink(const UsbRequest& request);
  [[nodiscard]] bool obey();
  void stop_stream();
  void begin_picture();
  void send_payloads();

  UvcDevice device_;
  UsbCable cable_;
  std::deque<std::pair<std::uint32_t, std::uint32_t>> waiting_;  ///< transfers: sequence, length
  std::uint32_t newest_ = 0;  ///< sequence of the newest transfer, whatever became of it
  std::map<std::uint32_t, std::uint32_t> early_unlinks_;  ///< by the transfer's sequence
  bool streaming_ = false, paused_ = false, cut_ = false, faulty_ = false;
  Time due_;
  Bytes picture_;  ///< being sent; empty between pictures
  std::size_t sent_ = 0;
  std::uint8_t frame_id_ = 0;
  bool picture_faulty_ = false;
  std::uint32_t number_ = 0;  ///< of the next picture
  std::string typed_;         ///< of a command that is not whole yet
};

// How long nothing will happen by itself.
int UvcCamera::wait_ms() const {
  if (!streaming_ || paused_ || waiting_.empty()) return -1;
  const auto left =
      std::chrono::ceil<std::chrono::milliseconds>(due_ - std::chrono::steady_clock::now());
  return static_cast<int>(std::max<std::int64_t>(left.count(), 0));
}

void UvcCamera::run() {
  while (true) {
    pollfd ready[2] = {{.fd = cable_.fd(), .events = POLLIN, .revents = 0},
                       {.fd = STDIN_FILENO, .events = POLLIN, .revents = 0}};
    if (::poll(ready, 2, wait_ms()) < 0 && errno != EINTR) return;
    if (ready[0].revents != 0) serve();
    if (ready[1].revents != 0 && !obey()) return;
    send_payloads();
  }
}

void UvcCamera::serve() {
  const UsbRequest request = cable_.receive();
  if (request.unlink) {
    serve_unlink(request);
    return;
  }
  newest_ = request.sequence;
  if (const auto early = early_unlinks_.find(request.sequence); early != early_unlinks_.end()) {
    cable_.reply_unlink(early->second, -ECONNRESET);
    early_unlinks_.erase(early);
  } else if (request.endpoint == 0) {
    serve_control(request);
  } else if (request.endpoint == 1 && request.to_host) {
    waiting_.emplace_back(request.sequence, request.length);
  } else {
    cable_.reply(request.sequence, kStall, {}, 0);
  }
}

void UvcCamera::serve_control(const UsbRequest& request) {
  const auto answer = device_.control(request.setup, request.data);
  if (device_.take_stop()) stop_stream();
  if (!answer) return cable_.reply(request.sequence, kStall, {}, 0);
  cable_.reply(request.sequence, 0, *answer,
               request.to_host ? answer->size() : request.data.size());
}

void UvcCamera::serve_unlink(const UsbRequest& request) {
  // The kernel may send this before the transfer itself. An answer before that arrives would make
  // it forget the transfer, and end the connection at the answer to it.
  if (request.victim > newest_) {
    early_unlinks_[request.victim] = request.sequence;
    return;
  }
  const auto at = std::find_if(waiting_.begin(), waiting_.end(), [&](const auto& transfer) {
    return transfer.first == request.victim;
  });
  const bool found = at != waiting_.end();
  if (found) waiting_.erase(at);
  cable_.reply_unlink(request.sequence, found ? -ECONNRESET : 0);
  if (waiting_.empty()) stop_stream();
}

void UvcCamera::stop_stream() {
  streaming_ = false;
  picture_.clear();
}

bool UvcCamera::obey() {
  char bytes[256];
  const ssize_t got = ::read(STDIN_FILENO, bytes, sizeof bytes);
  if (got <= 0) return false;
  typed_.append(bytes, static_cast<std::size_t>(got));
  for (std::size_t end = 0; (end = typed_.find('\n')) != std::string::npos;) {
    const std::string command = typed_.substr(0, end);
    typed_.erase(0, end + 1);
    if (command == "pause") paused_ = true;
    if (command == "resume") paused_ = false;
    if (command == "cut") cut_ = true;
    if (command == "fault") faulty_ = true;
    std::printf("%u\n", number_);
    std::fflush(stdout);
  }
  return true;
}

void UvcCamera::begin_picture() {
  picture_ = picture(device_.mode(), number_++);
  if (std::exchange(cut_, false)) picture_.resize(picture_.size() / 2);
  picture_faulty_ = std::exchange(faulty_, false);
  sent_ = 0;
  frame_id_ ^= 1;
  // A camera that is late does not catch up: numbers go by pictures, not by time.
  const auto now = std::chrono::steady_clock::now();
  due_ = std::max(due_ + std::chrono::nanoseconds(100) * device_.mode().interval, now);
}

// Each payload has a header of two bytes: its length, and the flags end-of-header, error,
// end-of-frame and frame-id.
void UvcCamera::send_payloads() {
  while (!waiting_.empty()) {
    if (picture_.empty()) {
      const auto now = std::chrono::steady_clock::now();
      if (!std::exchange(streaming_, true)) due_ = now;
      if (paused_ || now < due_) return;
      begin_picture();
    }
    const auto [sequence, length] = waiting_.front();
    waiting_.pop_front();
    const std::size_t room = std::min(length, kUvcPayload) - 2;
    const std::size_t size = std::min(room, picture_.size() - sent_);
    const bool last = sent_ + size == picture_.size();
    Bytes payload = {2, static_cast<std::uint8_t>(0x80 | (picture_faulty_ ? 0x40 : 0) |
                                                  (last ? 0x02 : 0) | frame_id_)};
    const auto from = picture_.begin() + static_cast<std::ptrdiff_t>(sent_);
    payload.insert(payload.end(), from, from + static_cast<std::ptrdiff_t>(size));
    sent_ += size;
    cable_.reply(sequence, 0, payload, payload.size());
    if (last) picture_.clear();
  }
}

}  // namespace
}  // namespace corvid::vm

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: uvc_camera PORT\n");
    return 2;
  }
  corvid::vm::UvcCamera(std::atoi(argv[1])).run();
  return 0;
}
