#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

/// What a USB Video Class camera says about itself, and its controls (USB Device Class Definition
/// for Video Devices, revision 1.1).
namespace corvid::vm {

enum class UvcFormat : std::uint8_t { grey = 1, yuyv = 2, mjpg = 3 };

struct UvcSize {
  std::uint16_t width_px, height_px;
};

constexpr std::array<UvcSize, 3> kUvcSizes = {{{640, 480}, {320, 240}, {1280, 720}}};
constexpr std::array<std::uint32_t, 3> kUvcIntervals = {333'333, 666'666, 166'666};  // [100 ns]
/// Bytes of a payload with its header: what uvcvideo takes in one transfer from a bulk endpoint.
constexpr std::uint32_t kUvcPayload = 16384;

/// What the host has agreed on: the fields of the probe and commit controls.
struct UvcMode {
  UvcFormat format = UvcFormat::grey;
  std::uint8_t frame = 1;  ///< index from 1 into kUvcSizes
  std::uint32_t interval = kUvcIntervals[0];

  [[nodiscard]] UvcSize size() const { return kUvcSizes[frame - 1u]; }
  [[nodiscard]] std::vector<std::uint8_t> bytes() const;
  void take(const std::vector<std::uint8_t>& bytes);
};

/// The control endpoint of the camera.
class UvcDevice {
 public:
  explicit UvcDevice(int port) : port_(port) {}
  /// Answers a control transfer: the bytes for the host (empty for one to the device), or nothing
  /// to refuse it.
  [[nodiscard]] std::optional<std::vector<std::uint8_t>> control(
      const std::uint8_t setup[8], const std::vector<std::uint8_t>& data);
  [[nodiscard]] const UvcMode& mode() const { return committed_; }
  /// True once after the host has stopped the stream (it clears the endpoint's halt).
  [[nodiscard]] bool take_stop() { return std::exchange(stopped_, false); }

 private:
  struct Control {
    std::uint8_t entity, selector;
    std::uint8_t size;  ///< bytes
    std::int32_t least, most, step, usual, now;
  };
  using Answer = std::optional<std::vector<std::uint8_t>>;

  [[nodiscard]] Answer standard(std::uint8_t request, std::uint16_t value);
  [[nodiscard]] Answer descriptor(std::uint16_t value) const;
  [[nodiscard]] Answer of_mode(UvcMode& mode, std::uint8_t request,
                               const std::vector<std::uint8_t>& data);
  [[nodiscard]] static Answer of_control(Control& control, std::uint8_t request,
                                         const std::vector<std::uint8_t>& data);

  int port_;
  bool stopped_ = false;
  UvcMode probed_, committed_;
  std::array<Control, 4> controls_ = {{
      {1, 0x02, 1, 0, 0, 0x03, 2, 2},        // exposure mode: manual (1) and automatic (2)
      {1, 0x04, 4, 1, 10'000, 1, 333, 333},  // exposure time [100 us]
      {2, 0x02, 2, 0, 255, 1, 128, 128},     // brightness
      {2, 0x04, 2, 0, 100, 1, 10, 10},       // gain
  }};
};

}  // namespace corvid::vm
