#include "replay/recorder.h"

#include <fmt/format.h>

#include <cerrno>
#include <fstream>
#include <iterator>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "core/check.h"
#include "io/io_fault.h"

namespace corvid {
namespace {
namespace fs = std::filesystem;

/// The file has its name only when it is whole.
Expected<void> write_whole(const fs::path& path, std::span<const std::uint8_t> bytes) {
  const fs::path part = path.parent_path() / ("." + path.filename().string() + ".part");
  errno = 0;
  std::ofstream out(part, std::ios::binary | std::ios::trunc);
  out.write(reinterpret_cast<const char*>(bytes.data()), std::ssize(bytes));
  out.close();
  int code = out ? 0 : errno;
  std::error_code trouble;
  if (out) fs::rename(part, path, trouble);
  if (out && !trouble) return {};
  if (trouble) code = trouble.value();
  fs::remove(part, trouble);
  return io_fault("cannot be written", path, code);
}
Expected<void> write_whole(const fs::path& path, const std::string& text) {
  return write_whole(path, {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
}

/// ASL's sensor.yaml; the camera is the body, so T_BS is the identity.
Expected<std::string> sensor_yaml(const SourceInfo& info) {
  const Camera& c = *info.camera;
  std::size_t coefficients = 4;
  const char* model = "radial-tangential";
  switch (c.model) {
    case CameraModel::pinhole:
      break;
    case CameraModel::radtan:
      coefficients = c.distortion[4] == 0 ? 4 : 5;
      break;
    case CameraModel::equidistant:
      model = "equidistant";
      break;
    case CameraModel::fov:
      return fail(ErrorCode::unsupported, "an ASL folder cannot hold a camera of the fov model",
                  info.path, "undistort the images, or choose another lens model");
  }
  const std::vector<double> values(
      c.distortion.begin(), c.distortion.begin() + static_cast<std::ptrdiff_t>(coefficients));
  // A rate of 0 means that the source did not say.
  return fmt::format(
      "# A camera as in the ASL (EuRoC) format.\n"
      "sensor_type: camera\n"
      "T_BS:\n  cols: 4\n  rows: 4\n"
      "  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]\n"
      "rate_hz: {}\n"
      "resolution: [{}, {}]\n"
      "camera_model: pinhole\n"
      "intrinsics: [{}, {}, {}, {}]\n"
      "distortion_model: {}\n"
      "distortion_coefficients: [{}]\n",
      info.rate_hz, c.width_px, c.height_px, c.fx_px, c.fy_px, c.cx_px, c.cy_px, model,
      fmt::join(values, ", "));
}

}  // namespace

struct Recorder::Impl {
  fs::path folder, images;
  fs::path list_path;
  std::ofstream list;
  std::int64_t last_ns = -1;
};

Recorder::Recorder(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Recorder::Recorder(Recorder&&) noexcept = default;
Recorder& Recorder::operator=(Recorder&&) noexcept = default;
Recorder::~Recorder() = default;

Expected<Recorder> Recorder::open(const fs::path& folder, const SourceInfo& info) {
  CORVID_CHECK(info.camera != nullptr, "a source without a camera cannot be recorded");
  const auto yaml = sensor_yaml(info);
  if (!yaml) return tl::unexpected(yaml.error());
  if (folder.empty())
    return fail(ErrorCode::invalid_argument, "the output folder's name is empty", "",
                "name a folder to record into");
  auto impl = std::make_unique<Impl>();
  impl->folder = folder;
  const fs::path camera = folder / "mav0" / "cam0";
  impl->images = camera / "data";
  impl->list_path = camera / "data.csv";
  std::error_code trouble;
  if (fs::exists(impl->list_path, trouble))
    return fail(ErrorCode::invalid_argument, "there is a recording already",
                impl->list_path.string(), "record into a new folder");
  fs::create_directories(impl->images, trouble);
  if (trouble == std::errc::not_a_directory || trouble == std::errc::file_exists)
    return fail(ErrorCode::invalid_argument, "is or lies below a file, where a folder must be",
                folder.string(), "record into a new folder");
  if (trouble) return io_fault("cannot be made", impl->images, trouble.value());
  if (info.intrinsics != IntrinsicsOrigin::guess) {
    if (auto written = write_whole(camera / "sensor.yaml", *yaml); !written)
      return tl::unexpected(written.error());
  }
  errno = 0;
  impl->list.open(impl->list_path, std::ios::binary | std::ios::trunc);
  impl->list << "#timestamp [ns],filename\n" << std::flush;
  if (!impl->list) return io_fault("cannot be written", impl->list_path, errno);
  return Recorder(std::move(impl));
}

Expected<std::vector<std::uint8_t>> Recorder::encode(const Frame& frame) {
  cv::Mat image;
  if (frame.colour.empty()) {
    image = cv::Mat(frame.grey.height(), frame.grey.width(), CV_8UC1,
                    const_cast<std::uint8_t*>(frame.grey.data()));  // only read
  } else {
    const cv::Mat rgb(frame.colour.height(), frame.colour.width(), CV_8UC3,
                      const_cast<Rgb8*>(frame.colour.data()));
    cv::cvtColor(rgb, image, cv::COLOR_RGB2BGR);
  }
  std::vector<unsigned char> bytes;
  bool good = false;
  try {
    // Level 1: noise does not pack any better by working longer.
    good = cv::imencode(".png", image, bytes, {cv::IMWRITE_PNG_COMPRESSION, 1});
  } catch (const cv::Exception&) {
  }
  if (!good) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("frame {} cannot be encoded as PNG", frame.id.value),
                impl_->folder.string());
  }
  return bytes;
}

Expected<void> Recorder::append(const Frame& frame, std::span<const std::uint8_t> picture) {
  if (frame.time_ns <= impl_->last_ns)
    return fail(
        ErrorCode::invalid_argument,
        fmt::format("capture time {} ns does not follow {} ns", frame.time_ns, impl_->last_ns),
        frame.name.empty() ? fmt::format("frame {}", frame.id.value) : frame.name);
  const std::string name = fmt::format("{}.png", frame.time_ns);
  if (auto written = write_whole(impl_->images / name, picture); !written) return written;
  errno = 0;
  impl_->list << fmt::format("{},{}\n", frame.time_ns, name) << std::flush;
  if (!impl_->list) return io_fault("cannot be written", impl_->list_path, errno);
  impl_->last_ns = frame.time_ns;
  return {};
}

Expected<bool> Recorder::write_truth(const Trajectory& truth) {
  const fs::path sensor = impl_->folder / "mav0" / "state_groundtruth_estimate0";
  std::error_code trouble;
  fs::create_directories(sensor, trouble);
  if (trouble) return io_fault("cannot be made", sensor, trouble.value());
  std::string text =
      "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
      "q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], "
      "b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], "
      "b_a_RS_S_z [m s^-2]\n";
  for (const StampedPose& stamped : truth) {
    const Eigen::Vector3d& t = stamped.T_world_camera.translation();
    const Eigen::Quaterniond& q = stamped.T_world_camera.rotation();
    fmt::format_to(std::back_inserter(text), "{},{},{},{},{},{},{},{},0,0,0,0,0,0,0,0,0\n",
                   stamped.time_ns, t.x(), t.y(), t.z(), q.w(), q.x(), q.y(), q.z());
  }
  if (auto written = write_whole(sensor / "data.csv", text); !written)
    return tl::unexpected(written.error());
  return true;
}

}  // namespace corvid
