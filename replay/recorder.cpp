#include "replay/recorder.h"

#include <fmt/format.h>

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

namespace corvid {
namespace {
namespace fs = std::filesystem;

tl::unexpected<Error> cannot_write(const fs::path& path) {
  return fail(ErrorCode::io, "cannot be written", path.string(),
              "check the folder's permissions and the free space");
}

/// The file has its name only when it is whole.
Expected<void> write_whole(const fs::path& path, const char* bytes, std::size_t size) {
  const fs::path part = path.parent_path() / ("." + path.filename().string() + ".part");
  std::ofstream out(part, std::ios::binary | std::ios::trunc);
  out.write(bytes, static_cast<std::streamsize>(size));
  out.close();
  std::error_code trouble;
  if (out) fs::rename(part, path, trouble);
  if (!out || trouble) {
    fs::remove(part, trouble);
    return cannot_write(path);
  }
  return {};
}
Expected<void> write_whole(const fs::path& path, const std::string& text) {
  return write_whole(path, text.data(), text.size());
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

Expected<std::vector<unsigned char>> encode(const Frame& frame, const fs::path& path) {
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
  if (!good) return fail(ErrorCode::io, "the image cannot be encoded as PNG", path.string());
  return bytes;
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
  if (trouble)
    return fail(ErrorCode::io, "cannot be made: " + trouble.message(), impl->images.string(),
                "check the folder's permissions and the free space");
  if (auto written = write_whole(camera / "sensor.yaml", *yaml); !written)
    return tl::unexpected(written.error());
  impl->list.open(impl->list_path, std::ios::binary | std::ios::trunc);
  impl->list << "#timestamp [ns],filename\n" << std::flush;
  if (!impl->list) return cannot_write(impl->list_path);
  return Recorder(std::move(impl));
}

Expected<void> Recorder::write(const Frame& frame) {
  if (frame.time_ns <= impl_->last_ns)
    return fail(
        ErrorCode::invalid_argument,
        fmt::format("capture time {} ns does not follow {} ns", frame.time_ns, impl_->last_ns),
        frame.name.empty() ? fmt::format("frame {}", frame.id.value) : frame.name);
  const std::string name = fmt::format("{}.png", frame.time_ns);
  const fs::path path = impl_->images / name;
  const auto bytes = encode(frame, path);
  if (!bytes) return tl::unexpected(bytes.error());
  if (auto written = write_whole(path, reinterpret_cast<const char*>(bytes->data()), bytes->size());
      !written)
    return written;
  impl_->list << fmt::format("{},{}\n", frame.time_ns, name) << std::flush;
  if (!impl_->list) return cannot_write(impl_->list_path);
  impl_->last_ns = frame.time_ns;
  return {};
}

Expected<void> Recorder::write_truth(const Trajectory& truth) {
  const fs::path sensor = impl_->folder / "mav0" / "state_groundtruth_estimate0";
  std::error_code trouble;
  fs::create_directories(sensor, trouble);
  if (trouble) return cannot_write(sensor);
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
  return write_whole(sensor / "data.csv", text);
}

Expected<std::uint64_t> record(FrameSource& source, const fs::path& folder,
                               const std::stop_token& stop) {
  auto recorder = Recorder::open(folder, source.info());
  if (!recorder) return tl::unexpected(recorder.error());
  if (const Trajectory truth = source.truth(); !truth.empty())
    if (auto written = recorder->write_truth(truth); !written)
      return tl::unexpected(written.error());
  std::uint64_t frames = 0;
  while (!stop.stop_requested()) {
    const auto frame = source.next(stop);
    if (!frame) return tl::unexpected(frame.error());
    if (!*frame) break;
    if (auto written = recorder->write(**frame); !written) return tl::unexpected(written.error());
    ++frames;
  }
  return frames;
}

}  // namespace corvid
