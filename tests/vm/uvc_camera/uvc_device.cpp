#include "vm/uvc_camera/uvc_device.h"

#include <algorithm>
#include <cstddef>
#include <string>

namespace corvid::vm {
namespace {

using Bytes = std::vector<std::uint8_t>;

enum : std::uint8_t {  // requests of the class
  kSetCurrent = 0x01,
  kGetCurrent = 0x81,
  kGetLeast = 0x82,
  kGetMost = 0x83,
  kGetStep = 0x84,
  kGetLength = 0x85,
  kGetInfo = 0x86,
  kGetUsual = 0x87
};
constexpr std::uint8_t kGetAndSet = 3;
constexpr std::size_t kProbeBytes = 34;

/// Little-endian, as all of USB.
template <class T>
void append(Bytes& bytes, T value, std::size_t size = sizeof(T)) {
  for (std::size_t i = 0; i < size; ++i) {
    bytes.push_back(static_cast<std::uint8_t>(static_cast<std::uint64_t>(value) >> (8 * i)));
  }
}

std::uint32_t read(const Bytes& bytes, std::size_t at, std::size_t size) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < size && at + i < bytes.size(); ++i) {
    value |= static_cast<std::uint32_t>(bytes[at + i]) << (8 * i);
  }
  return value;
}

void write16(Bytes& bytes, std::size_t at, std::size_t value) {
  bytes[at] = static_cast<std::uint8_t>(value);
  bytes[at + 1] = static_cast<std::uint8_t>(value >> 8);
}

void append_bytes(Bytes& bytes, std::initializer_list<int> values) {
  for (const int value : values) bytes.push_back(static_cast<std::uint8_t>(value));
}

std::uint32_t frame_bytes(const UvcSize& size, std::uint32_t bytes_per_pixel) {
  return std::uint32_t{size.width_px} * size.height_px * bytes_per_pixel;
}

/// The frame descriptors of a format, and its colour space.
void append_frames(Bytes& bytes, int subtype, std::uint32_t bytes_per_pixel) {
  int index = 0;
  for (const UvcSize& size : kUvcSizes) {
    const std::uint32_t frame = frame_bytes(size, bytes_per_pixel);
    append_bytes(bytes,
                 {26 + 4 * static_cast<int>(kUvcIntervals.size()), 0x24, subtype, ++index, 0});
    append(bytes, size.width_px);
    append(bytes, size.height_px);
    append(bytes, frame * 8 * 15);  // bits per second, least and most
    append(bytes, frame * 8 * 60);
    append(bytes, frame);
    append(bytes, kUvcIntervals[0]);
    bytes.push_back(static_cast<std::uint8_t>(kUvcIntervals.size()));
    for (const std::uint32_t interval : kUvcIntervals) append(bytes, interval);
  }
  append_bytes(bytes, {6, 0x24, 0x0d, 1, 1, 4});
}

void append_uncompressed(Bytes& bytes, UvcFormat format, const char* name, int bits_per_pixel) {
  append_bytes(bytes, {27, 0x24, 4, static_cast<int>(format), static_cast<int>(kUvcSizes.size())});
  // The rest of the format's GUID is the same for all of them.
  append_bytes(bytes,
               {name[0], name[1], name[2], name[3],        0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0,
                0x38,    0x9b,    0x71,    bits_per_pixel, 1, 0, 0,    0, 0});
  append_frames(bytes, 5, static_cast<std::uint32_t>(bits_per_pixel / 8));
}

Bytes configuration() {
  Bytes bytes;
  append_bytes(bytes, {9, 2, 0, 0, 2, 1, 0, 0x80, 50});  // its length follows below
  append_bytes(bytes, {8, 0x0b, 0, 2, 0x0e, 3, 0, 2});   // two interfaces make a camera
  append_bytes(bytes, {9, 4, 0, 0, 0, 0x0e, 1, 0, 2});   // VideoControl
  const std::size_t control = bytes.size();
  append_bytes(bytes, {13, 0x24, 1, 0x10, 0x01, 0, 0});
  append(bytes, std::uint32_t{48'000'000});  // clock [Hz]
  append_bytes(bytes, {1, 1});
  // Camera terminal 1: exposure mode and time.
  append_bytes(bytes, {18, 0x24, 2, 1, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0a, 0, 0});
  // Processing unit 2: brightness and gain. Output terminal 3.
  append_bytes(bytes, {12, 0x24, 5, 2, 1, 0, 0, 2, 0x01, 0x02, 0, 0});
  append_bytes(bytes, {9, 0x24, 3, 3, 0x01, 0x01, 0, 2, 0});
  write16(bytes, control + 5, bytes.size() - control);
  append_bytes(bytes, {9, 4, 1, 0, 1, 0x0e, 2, 0, 0});  // VideoStreaming
  const std::size_t streaming = bytes.size();
  append_bytes(bytes, {16, 0x24, 1, 3, 0, 0, 0x81, 0, 3, 0, 0, 0, 1, 0, 0, 0});
  append_uncompressed(bytes, UvcFormat::grey, "Y800", 8);
  append_uncompressed(bytes, UvcFormat::yuyv, "YUY2", 16);
  append_bytes(bytes, {11, 0x24, 6, static_cast<int>(UvcFormat::mjpg),
                       static_cast<int>(kUvcSizes.size()), 1, 1, 0, 0, 0, 0});
  append_frames(bytes, 7, 2);
  write16(bytes, streaming + 4, bytes.size() - streaming);
  append_bytes(bytes, {7, 5, 0x81, 2, 0x00, 0x02, 0});  // bulk endpoint, packets of 512 bytes
  write16(bytes, 2, bytes.size());
  return bytes;
}

Bytes text_descriptor(const std::string& text) {
  Bytes bytes = {static_cast<std::uint8_t>(2 + 2 * text.size()), 3};
  for (const char letter : text) append(bytes, static_cast<std::uint16_t>(letter));
  return bytes;
}

}  // namespace

Bytes UvcMode::bytes() const {
  const std::uint32_t pixel_bytes = format == UvcFormat::grey ? 1 : 2;
  Bytes bytes(2);
  bytes.push_back(static_cast<std::uint8_t>(format));
  bytes.push_back(frame);
  append(bytes, interval);
  bytes.resize(16);
  append(bytes, std::uint16_t{32});  // delay [ms]
  append(bytes, frame_bytes(size(), pixel_bytes));
  append(bytes, kUvcPayload);
  append(bytes, std::uint32_t{48'000'000});
  bytes.push_back(3);  // frame ids and ends of frames are marked
  bytes.resize(kProbeBytes);
  return bytes;
}

void UvcMode::take(const Bytes& bytes) {
  const std::uint32_t wanted = read(bytes, 2, 1), wanted_frame = read(bytes, 3, 1);
  format = wanted >= 1 && wanted <= 3 ? static_cast<UvcFormat>(wanted) : UvcFormat::grey;
  frame = wanted_frame >= 1 && wanted_frame <= kUvcSizes.size()
              ? static_cast<std::uint8_t>(wanted_frame)
              : std::uint8_t{1};
  const auto* at = std::find(kUvcIntervals.begin(), kUvcIntervals.end(), read(bytes, 4, 4));
  interval = at == kUvcIntervals.end() ? kUvcIntervals[0] : *at;
}

UvcDevice::Answer UvcDevice::control(const std::uint8_t setup[8], const Bytes& data) {
  const std::uint8_t type = setup[0], request = setup[1];
  const auto value = static_cast<std::uint16_t>(setup[2] | setup[3] << 8);
  const auto length = static_cast<std::size_t>(setup[6] | setup[7] << 8);
  Answer answer;
  if ((type & 0x60) != 0x20) {
    answer = standard(request, value);
  } else {
    const std::uint8_t selector = setup[3], interface = setup[4], entity = setup[5];
    if (interface == 1 && (selector == 1 || selector == 2)) {
      answer = of_mode(selector == 1 ? probed_ : committed_, request, data);
    } else if (interface == 0 && entity == 0 && selector == 2) {
      answer = Bytes{6};  // why the last request was refused: not known
    } else {
      for (Control& one : controls_) {
        if (interface == 0 && entity == one.entity && selector == one.selector) {
          answer = of_control(one, request, data);
        }
      }
    }
  }
  if (answer && answer->size() > length) answer->resize(length);
  return answer;
}

UvcDevice::Answer UvcDevice::standard(std::uint8_t request, std::uint16_t value) {
  switch (request) {
    case 0:  // status
      return Bytes{0, 0};
    case 1:  // clear the halt of the endpoint: how a stream from a bulk endpoint is stopped
      stopped_ = true;
      return Bytes{};
    case 6:
      return descriptor(value);
    case 8:  // configuration
      return Bytes{1};
    case 10:  // alternate setting
      return Bytes{0};
    case 3:
    case 5:
    case 9:
    case 11:
      return Bytes{};
    default:
      return std::nullopt;
  }
}

UvcDevice::Answer UvcDevice::descriptor(std::uint16_t value) const {
  const int index = value & 0xff;
  switch (value >> 8) {
    case 1:
      return Bytes{18, 1, 0, 2, 0xef, 2, 1, 64, 0x6b, 0x1d, 0x02, 0x01, 1, 0, 1, 2, 3, 1};
    case 2:
      return configuration();
    case 6:
      return Bytes{10, 6, 0, 2, 0xef, 2, 1, 64, 1, 0};
    case 3:
      if (index == 0) return Bytes{4, 3, 9, 4};
      return text_descriptor(index == 1   ? "emulated"
                             : index == 2 ? "Test UVC Camera"
                                          : "000" + std::to_string(port_ + 1));
    default:
      return std::nullopt;
  }
}

UvcDevice::Answer UvcDevice::of_mode(UvcMode& mode, std::uint8_t request, const Bytes& data) {
  switch (request) {
    case kSetCurrent:
      mode.take(data);
      return Bytes{};
    case kGetCurrent:
    case kGetLeast:
    case kGetMost:
    case kGetUsual:
      return mode.bytes();
    case kGetLength:
      return Bytes{kProbeBytes, 0};
    case kGetInfo:
      return Bytes{kGetAndSet};
    default:
      return std::nullopt;
  }
}

UvcDevice::Answer UvcDevice::of_control(Control& control, std::uint8_t request, const Bytes& data) {
  std::int32_t value = 0;
  switch (request) {
    case kSetCurrent:
      control.now = static_cast<std::int32_t>(read(data, 0, control.size));
      return Bytes{};
    case kGetInfo:
      return Bytes{kGetAndSet};
    case kGetLength:
      return Bytes{control.size, 0};
    case kGetCurrent:
      value = control.now;
      break;
    case kGetLeast:
      value = control.least;
      break;
    case kGetMost:
      value = control.most;
      break;
    case kGetStep:
      value = control.step;
      break;
    case kGetUsual:
      value = control.usual;
      break;
    default:
      return std::nullopt;
  }
  Bytes bytes;
  append(bytes, value, control.size);
  return bytes;
}

}  // namespace corvid::vm
