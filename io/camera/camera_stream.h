#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "corvid/error.h"
#include "corvid/image.h"

namespace corvid {

/// One way in which a camera can deliver pictures.
struct CameraMode {
  std::string format;  ///< V4L2's FourCC ("YUYV", "Y16 "), libcamera's name ("R8", "YUYV")
  int width_px = 0, height_px = 0;
  std::vector<double> rates_hz;  ///< highest first; empty if the driver does not say
  std::string note;              ///< "sizes up to 1920x1080 in steps of 2", "not understood"
};

/// A camera as `corvid cameras` lists it.
struct CameraListing {
  std::string id;    ///< what --camera takes: "v4l2:/dev/video0", "libcamera:platform/vimc.0 ..."
  std::string name;  ///< as the driver calls it
  std::string driver;
  std::vector<CameraMode> modes;
  std::string problem;  ///< why it cannot be used now (in use, no permission); empty if it can
};

/// What is asked of a camera. Zero and nothing: what the camera does by itself.
struct CameraRequest {
  std::string device;  ///< "/dev/video0", libcamera's id
  std::string format;  ///< as in CameraMode; empty: the best for grey pictures that there is
  int width_px = 0, height_px = 0;
  double rate_hz = 0;
  std::optional<double> exposure_s;  ///< manual exposure; nothing: left as it is
  std::optional<double> gain;        ///< analogue gain: V4L2: the driver's units; libcamera: factor
  bool colour = false;               ///< keep colour where the format has it
};

/// What the camera was really set to, read back from it.
struct StreamSettings {
  std::string format;
  int width_px = 0, height_px = 0;
  double rate_hz = 0;   ///< 0: the driver does not say
  bool colour = false;  ///< pictures come with colour
  /// What the user should know, one sentence each: a request that the driver changed, times that
  /// are those of arrival.
  std::vector<std::string> notes;
};

/// One picture as it came from a camera.
struct Capture {
  GreyImage grey;
  ColourImage colour;        ///< empty unless asked for and there is any
  std::int64_t time_ns = 0;  ///< capture, CLOCK_MONOTONIC
  std::uint64_t sequence =
      0;  ///< the camera's own count; rises by more than 1 where some were lost
};

/// What a stream did not deliver.
struct StreamCounts {
  std::uint64_t lost = 0;     ///< numbers that the camera counted, but that never came
  std::uint64_t damaged = 0;  ///< flagged as faulty by the driver, cut short, or not to be decoded;
                              ///< of the numbers that came
  std::vector<std::string> messages;  ///< one per damaged picture, at most 100
};

/// Port: a camera that streams. One owner; not thread-safe. Streaming ends with its destruction,
/// which never blocks for longer than the driver does.
class CameraStream {
 public:
  virtual ~CameraStream() = default;
  [[nodiscard]] virtual const StreamSettings& settings() const = 0;
  /// The next picture; nothing if none came within `timeout`, or when asked to stop (answered
  /// within 100 ms). Damaged pictures are counted and waited over. An error means that the stream
  /// is over (unplugged, format changed, the driver failed): code io, and it must be opened
  /// anew.
  [[nodiscard]] virtual Expected<std::optional<Capture>> next(std::chrono::milliseconds timeout,
                                                              const std::stop_token& stop) = 0;
  [[nodiscard]] virtual StreamCounts counts() const = 0;
  /// The stream is over for good, and opening it anew is of no use: the end of a pipe. next() has
  /// given nothing, or an error that says why it ended too early.
  [[nodiscard]] virtual bool ended() const { return false; }
  /// Whether it can be opened anew: a camera can, a pipe that has begun cannot.
  [[nodiscard]] virtual bool reopens() const { return true; }
};

}  // namespace corvid
