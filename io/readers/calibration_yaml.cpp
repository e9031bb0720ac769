#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <opencv2/core/persistence.hpp>

#include "io/nearest_name.h"
#include "io/readers/calibration_formats.h"
#include "io/readers/text.h"

namespace corvid {
namespace {

constexpr double kMaxSide_px = 1 << 20;

// One calibration value under the names that the formats give it, the usual one first.
struct Key {
  std::vector<std::string> names;
  bool required = true;
};

// A read-only view of a YAML mapping that explains what is missing.
class Section {
 public:
  Section(const YAML::Node& node, std::string where) : node_(node), where_(std::move(where)) {
    for (const auto& item : node_) {
      if (item.first.IsScalar()) present_.push_back(item.first.Scalar());
    }
  }

  [[nodiscard]] const std::string& where() const { return where_; }

  [[nodiscard]] YAML::Node find(const Key& key) const {
    for (const std::string& name : key.names) {
      for (const auto& item : node_) {
        if (item.first.IsScalar() && item.first.Scalar() == name) return item.second;
      }
    }
    return YAML::Node(YAML::NodeType::Undefined);
  }

  /// Fails for a key that is required and absent, and for one that is optional and absent while
  /// something very like it is there: a misspelt key must not silently mean its default.
  /// @param others  names that may stand there too and are of no use here.
  [[nodiscard]] Expected<void> check(const std::vector<Key>& keys,
                                     const std::vector<std::string>& others) const {
    std::vector<std::string> strangers;
    for (const std::string& name : present_) {
      bool known = std::find(others.begin(), others.end(), name) != others.end();
      for (const Key& key : keys) {
        for (const std::string& n : key.names) known |= n == name;
      }
      if (!known) strangers.push_back(name);
    }
    for (const Key& key : keys) {
      if (find(key).IsDefined()) continue;
      for (const std::string& stranger : strangers) {
        const std::string meant = nearest_name(stranger, key.names);
        if (meant.empty()) continue;
        return fail(ErrorCode::corrupt,
                    fmt::format("unknown key \"{}\", and \"{}\" is missing", stranger, meant),
                    where_, fmt::format("did you mean {}?", meant));
      }
      if (key.required) {
        return fail(ErrorCode::corrupt, fmt::format("key \"{}\" is missing", key.names.front()),
                    where_, "keys found: " + fmt::format("{}", fmt::join(present_, ", ")));
      }
    }
    return {};
  }

  [[nodiscard]] Expected<std::vector<double>> numbers(const Key& key) const {
    return numbers_of(find(key), key.names.front());
  }
  [[nodiscard]] Expected<double> number(const Key& key) const {
    const Expected<std::vector<double>> list = numbers(key);
    if (!list) return tl::unexpected(list.error());
    if (list->size() != 1) return wrong(key.names.front(), "one number is expected");
    return list->front();
  }
  [[nodiscard]] std::string word(const Key& key) const {
    const YAML::Node value = find(key);
    return value.IsDefined() && value.IsScalar() ? lower_case(trim(value.Scalar())) : "";
  }

 private:
  [[nodiscard]] tl::unexpected<Error> wrong(const std::string& name, const std::string& why) const {
    return fail(ErrorCode::corrupt, fmt::format("key \"{}\": {}", name, why), where_);
  }

  // A scalar, a list, a list of rows, or a matrix with rows, cols and data.
  [[nodiscard]] Expected<std::vector<double>> numbers_of(const YAML::Node& value,
                                                         const std::string& name,
                                                         int depth = 0) const {
    std::vector<double> result;
    if (!value.IsDefined() || value.IsNull()) return result;
    if (depth > 3) return wrong(name, "lists are nested too deeply");
    if (value.IsMap()) {
      for (const auto& item : value) {
        if (item.first.IsScalar() && item.first.Scalar() == "data") {
          return numbers_of(item.second, name, depth + 1);
        }
      }
      return wrong(name, "the matrix has no \"data\"");
    }
    if (value.IsScalar()) {
      const std::optional<double> number = to_number(trim(value.Scalar()));
      if (!number) return wrong(name, fmt::format("\"{}\" is not a finite number", value.Scalar()));
      result.push_back(*number);
      return result;
    }
    for (const YAML::Node& element : value) {
      const Expected<std::vector<double>> inner = numbers_of(element, name, depth + 1);
      if (!inner) return inner;
      result.insert(result.end(), inner->begin(), inner->end());
      if (result.size() > 64) return wrong(name, "too many numbers");  // aliases may nest endlessly
    }
    return result;
  }

  YAML::Node node_;
  std::string where_;
  std::vector<std::string> present_;
};

Expected<void> set_size(Camera& camera, double width, double height, const std::string& where) {
  if (!(width >= 1 && height >= 1 && width <= kMaxSide_px && height <= kMaxSide_px)) {
    return fail(ErrorCode::corrupt, fmt::format("image size {} x {}", width, height), where);
  }
  camera.width_px = static_cast<int>(width);
  camera.height_px = static_cast<int>(height);
  return {};
}

// Distortion by the name that a file gives to the model.
Expected<void> set_distortion(Camera& camera, const std::string& model,
                              const std::vector<double>& values, const std::string& where) {
  static const std::vector<std::string> kNames = {"radtan",      "radial-tangential",
                                                  "plumb_bob",   "rational_polynomial",
                                                  "equidistant", "equi",
                                                  "fisheye",     "fov",
                                                  "none",        "kannala_brandt"};
  const auto count = [&](std::size_t n) {
    return fail(ErrorCode::corrupt,
                fmt::format("the {} model has {} coefficients, not {}", model, n, values.size()),
                where);
  };
  if (model.empty() || model == "radtan" || model == "radial-tangential" || model == "plumb_bob" ||
      model == "rational_polynomial") {
    return set_radtan(camera, values, where);
  }
  if (model == "equidistant" || model == "equi" || model == "fisheye" ||
      model == "kannala_brandt") {
    if (values.size() != 4) return count(4);
    camera.model = CameraModel::equidistant;
  } else if (model == "fov") {
    if (values.size() != 1) return count(1);
    camera.model = CameraModel::fov;
  } else if (model == "none") {
    camera.model = CameraModel::pinhole;
    return {};
  } else {
    return fail(ErrorCode::unsupported, fmt::format("unknown distortion model \"{}\"", model),
                where, nearest_hint(model, kNames));
  }
  std::copy(values.begin(), values.end(), camera.distortion.begin());
  return {};
}

Expected<Pose> pose_from_matrix(const std::vector<double>& m, const std::string& where) {
  if (m.size() != 16) return fail(ErrorCode::corrupt, "a pose needs 16 numbers", where);
  const Eigen::Matrix4d T =
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(m.data());
  const Eigen::Matrix3d R = T.topLeftCorner<3, 3>();
  if ((R * R.transpose() - Eigen::Matrix3d::Identity()).norm() > 1e-3 || R.determinant() < 0) {
    return fail(ErrorCode::corrupt, "the extrinsic pose holds no rotation", where);
  }
  return Pose(R, T.topRightCorner<3, 1>());
}

// Kalibr's camchain (a section per camera) and EuRoC's sensor.yaml: intrinsics in one list.
Expected<Calibration> read_chain(const Section& section, bool kalibr) {
  const Key intrinsics{{"intrinsics"}}, resolution{{"resolution"}};
  const Key model{{"distortion_model"}}, camera_model{{"camera_model"}, false};
  const Key coefficients{{"distortion_coeffs", "distortion_coefficients"}};
  const Key body{{"T_BS"}, false}, imu{{"T_cam_imu"}, false};
  if (auto ok =
          section.check({intrinsics, resolution, model, camera_model, coefficients, body, imu},
                        {"T_cn_cnm1", "rostopic", "cam_overlaps", "timeshift_cam_imu", "T_imu_cam",
                         "sensor_type", "comment", "rate_hz"});
      !ok) {
    return tl::unexpected(ok.error());
  }
  const std::string projection = section.word(camera_model);
  if (!projection.empty() && projection != "pinhole") {
    return fail(ErrorCode::unsupported, fmt::format("camera model \"{}\"", projection),
                section.where(), "pinhole with a distortion model is supported");
  }
  const auto k = section.numbers(intrinsics), size = section.numbers(resolution),
             d = section.numbers(coefficients);
  for (const auto* list : {&k, &size, &d}) {
    if (!*list) return tl::unexpected(list->error());
  }
  if (k->size() != 4) {
    return fail(ErrorCode::corrupt, "key \"intrinsics\" needs fx, fy, cx, cy", section.where());
  }
  if (size->size() != 2) {
    return fail(ErrorCode::corrupt, "key \"resolution\" needs width and height", section.where());
  }
  Calibration result;
  result.format = kalibr ? "Kalibr camchain" : "EuRoC sensor.yaml";
  Camera& camera = result.camera;
  camera.fx_px = (*k)[0], camera.fy_px = (*k)[1], camera.cx_px = (*k)[2], camera.cy_px = (*k)[3];
  if (auto ok = set_size(camera, (*size)[0], (*size)[1], section.where()); !ok) {
    return tl::unexpected(ok.error());
  }
  if (auto ok = set_distortion(camera, section.word(model), *d, section.where()); !ok) {
    return tl::unexpected(ok.error());
  }
  for (const Key* key : {&body, &imu}) {
    if (!section.find(*key).IsDefined()) continue;
    const auto m = section.numbers(*key);
    if (!m) return tl::unexpected(m.error());
    const Expected<Pose> T = pose_from_matrix(*m, section.where());
    if (!T) return tl::unexpected(T.error());
    result.T_body_camera = key == &body ? *T : T->inverse();
  }
  return result;
}

const Key kWidth{{"image_width", "width", "image_Width"}, false};
const Key kHeight{{"image_height", "height", "image_Height"}, false};
const Key kMatrix{
    {"camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M1", "intrinsic_matrix"}};
const Key kCoefficients{{"distortion_coefficients", "Distortion_Coefficients", "distCoeffs",
                         "dist_coeffs", "distortion_coeffs", "D", "D1"}};
const Key kModel{{"distortion_model"}, false};
const Key kFisheye{{"fisheye_model"}, false};

// What OpenCV and ROS files have in common.
struct MatrixCamera {
  std::vector<double> k, d;
  double width = 0, height = 0, fisheye = 0;
  std::string model, format;
};

Expected<Calibration> from_matrix(const MatrixCamera& m, const std::string& where) {
  if (m.k.size() != 9 || m.k[3] != 0 || m.k[6] != 0 || m.k[7] != 0 || m.k[8] != 1) {
    return fail(ErrorCode::corrupt, "the camera matrix is not (fx 0 cx; 0 fy cy; 0 0 1)", where);
  }
  Calibration result;
  result.format = m.format;
  Camera& camera = result.camera;
  camera.fx_px = m.k[0], camera.fy_px = m.k[4], camera.cx_px = m.k[2], camera.cy_px = m.k[5];
  if (m.k[1] != 0) result.notes.push_back(fmt::format("the skew of {} px is ignored", m.k[1]));
  if (m.width != 0 || m.height != 0) {
    if (auto ok = set_size(camera, m.width, m.height, where); !ok)
      return tl::unexpected(ok.error());
  }
  const std::string model = m.model.empty() && m.fisheye != 0 ? "fisheye" : m.model;
  if (auto ok = set_distortion(camera, model, m.d, where); !ok) return tl::unexpected(ok.error());
  return result;
}

Expected<Calibration> read_matrix(const Section& section, bool opencv) {
  const std::vector<std::string> others = {"calibration_time",
                                           "nframes",
                                           "board_width",
                                           "board_height",
                                           "board_size",
                                           "square_size",
                                           "marker_size",
                                           "flags",
                                           "avg_reprojection_error",
                                           "per_view_reprojection_errors",
                                           "extrinsic_parameters",
                                           "image_points",
                                           "grid_points",
                                           "fix_aspect_ratio",
                                           "aspectRatio",
                                           "nr_of_frames",
                                           "camera_name",
                                           "rectification_matrix",
                                           "projection_matrix",
                                           "header",
                                           "R",
                                           "P",
                                           "binning_x",
                                           "binning_y",
                                           "roi"};
  if (auto ok = section.check({kWidth, kHeight, kMatrix, kCoefficients, kModel, kFisheye}, others);
      !ok) {
    return tl::unexpected(ok.error());
  }
  MatrixCamera m;
  const auto k = section.numbers(kMatrix), d = section.numbers(kCoefficients);
  for (const auto* list : {&k, &d}) {
    if (!*list) return tl::unexpected(list->error());
  }
  m.k = *k;
  m.d = *d;
  for (const auto& [key, value] : {std::pair(&kWidth, &m.width), std::pair(&kHeight, &m.height),
                                   std::pair(&kFisheye, &m.fisheye)}) {
    if (!section.find(*key).IsDefined()) continue;
    const auto number = section.number(*key);
    if (!number) return tl::unexpected(number.error());
    *value = *number;
  }
  m.model = section.word(kModel);
  m.format = opencv ? "OpenCV" : "ROS camera_info";
  return from_matrix(m, section.where());
}

// OpenCV starts its files with "%YAML:1.0", which is no YAML directive; yaml-cpp refuses it.
std::string without_opencv_header(const std::string& text, bool& opencv) {
  const std::size_t at = text.find("%YAML:1.0");
  opencv = at != std::string::npos && at < 4;
  if (!opencv) return text;
  std::string result = text;
  result.replace(at, 9, "         ");
  return result;
}

}  // namespace

Expected<Calibration> parse_yaml_calibration(const std::string& text, const std::string& path) {
  try {
    bool opencv = false;
    const YAML::Node root = YAML::Load(without_opencv_header(text, opencv));
    if (!root.IsMap() || root.size() == 0) {
      return fail(ErrorCode::corrupt, "the calibration file has no keys", path);
    }
    const Section section(root, path);
    const YAML::Node cam0 = section.find({{"cam0"}});
    if (cam0.IsDefined() && cam0.IsMap()) {
      Expected<Calibration> result = read_chain(Section(cam0, path + ": cam0"), true);
      if (result && section.find({{"cam1"}}).IsDefined()) {
        result->notes.push_back(path + " has several cameras; cam0 is used");
      }
      return result;
    }
    // One misspelt key must not turn one format into another: the family with more known keys.
    int chain = 0, matrix = opencv ? 10 : 0;
    for (const char* name :
         {"intrinsics", "resolution", "T_BS", "sensor_type", "distortion_coeffs"})
      chain += section.find({{name}}).IsDefined();
    for (const Key* key : {&kMatrix, &kWidth, &kHeight, &kFisheye}) {
      matrix += section.find(*key).IsDefined();
    }
    for (const char* name : {"camera_name", "projection_matrix", "rectification_matrix"}) {
      matrix += section.find({{name}}).IsDefined();
    }
    if (chain == 0 && matrix == 0) {
      std::vector<std::string> names;
      for (const auto& item : root) {
        if (item.first.IsScalar()) names.push_back(item.first.Scalar());
      }
      return fail(ErrorCode::corrupt,
                  fmt::format("no calibration keys; the file has: {}", fmt::join(names, ", ")),
                  path,
                  "expected \"cam0\" (Kalibr), \"intrinsics\" (EuRoC) or \"camera_matrix\" "
                  "(OpenCV, ROS)");
    }
    return chain > matrix ? read_chain(section, false) : read_matrix(section, opencv);
  } catch (const YAML::Exception& e) {
    return fail(ErrorCode::corrupt, "this is not valid YAML: " + e.msg,
                e.mark.is_null() ? path : at_line(path, e.mark.line + 1));
  } catch (const std::exception& e) {
    return fail(ErrorCode::corrupt, std::string("this is not valid YAML: ") + e.what(), path);
  }
}

Expected<Calibration> parse_opencv_xml(const std::string& text, const std::string& path) {
  MatrixCamera m;
  m.format = "OpenCV";
  try {
    const cv::FileStorage file(
        text, cv::FileStorage::READ | cv::FileStorage::MEMORY | cv::FileStorage::FORMAT_XML);
    const auto find = [&](const Key& key) {
      for (const std::string& name : key.names) {
        const cv::FileNode node = file[name];
        if (!node.empty()) return node;
      }
      return cv::FileNode();
    };
    const cv::FileNode top = file.root();
    const std::vector<std::string> present = top.isMap() ? top.keys() : std::vector<std::string>();
    for (const Key* key : {&kMatrix, &kCoefficients}) {
      if (!find(*key).empty()) continue;
      std::string meant;
      for (const std::string& name : key->names) {
        if (meant.empty()) meant = nearest_name(name, present);
      }
      return fail(ErrorCode::corrupt, fmt::format("key \"{}\" is missing", key->names.front()),
                  path,
                  meant.empty() ? fmt::format("keys found: {}", fmt::join(present, ", "))
                                : fmt::format("the nearest that the file has is \"{}\"", meant));
    }
    for (const auto& [key, list] : {std::pair(&kMatrix, &m.k), std::pair(&kCoefficients, &m.d)}) {
      for (const cv::FileNode data = find(*key)["data"]; const cv::FileNode value : data) {
        if (!value.isInt() && !value.isReal()) {
          return fail(
              ErrorCode::corrupt,
              fmt::format("key \"{}\" holds something that is no number", key->names.front()),
              path);
        }
        list->push_back(value.real());
      }
    }
    for (const auto& [key, value] : {std::pair(&kWidth, &m.width), std::pair(&kHeight, &m.height),
                                     std::pair(&kFisheye, &m.fisheye)}) {
      const cv::FileNode node = find(*key);
      if (node.isInt() || node.isReal()) *value = node.real();
    }
  } catch (const std::exception&) {
    return fail(ErrorCode::corrupt, "this is not a valid OpenCV XML file", path);
  }
  for (const auto* list : {&m.k, &m.d}) {
    for (const double value : *list) {
      if (!std::isfinite(value)) return fail(ErrorCode::corrupt, "a number is not finite", path);
    }
  }
  return from_matrix(m, path);
}

}  // namespace corvid
