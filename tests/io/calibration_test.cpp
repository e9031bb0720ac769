#include "io/calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/core/persistence.hpp>

#include "io/source_test_files.h"

namespace corvid {
namespace {

using test::has_note;
using test::TempFolder;
using test::write_text;
using testing::HasSubstr;

Calibration read_as(const std::string& name, const std::string& text) {
  TempFolder t;
  write_text(t / name, text);
  const auto read = read_calibration(t / name);
  EXPECT_TRUE(read) << read.error().to_string();
  return read ? *read : Calibration{};
}

std::string error_of(const std::string& name, const std::string& text) {
  TempFolder t;
  write_text(t / name, text);
  const auto read = read_calibration(t / name);
  EXPECT_FALSE(read) << text;
  return read ? "" : read.error().to_string();
}

Camera camera_of(CameraModel model, std::array<double, 5> distortion) {
  return {model, 752, 480, 458.654, 457.296, 367.215, 1.0 / 3, distortion};
}

TEST(Calibration, RoundTrips) {
  const std::array cameras = {
      camera_of(CameraModel::pinhole, {}),
      camera_of(CameraModel::radtan, {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0}),
      camera_of(CameraModel::radtan, {-0.1, 0.2, 0.3e-3, 4e-19, 0.5}),
      camera_of(CameraModel::equidistant, {0.01, -0.02, 0.03, -1.0 / 3, 0}),
      camera_of(CameraModel::fov, {0.93, 0, 0, 0, 0})};
  int written = 0;
  for (const Camera& camera : cameras) {
    for (const auto format : {CalibrationFormat::opencv, CalibrationFormat::kalibr}) {
      TempFolder t;
      const auto ok = write_calibration(t / "c.yaml", camera, format);
      const bool impossible =
          format == CalibrationFormat::opencv
              ? camera.model == CameraModel::fov
              : camera.model == CameraModel::radtan && camera.distortion[4] != 0;
      ASSERT_EQ(ok.has_value(), !impossible);
      if (!ok) {
        EXPECT_EQ(ok.error().code, ErrorCode::unsupported);
        continue;
      }
      const auto read = read_calibration(t / "c.yaml");
      ASSERT_TRUE(read) << read.error().to_string();
      EXPECT_EQ(read->camera, camera);
      ++written;
    }
  }
  EXPECT_EQ(written, 8);
}

TEST(Calibration, OpenCvReadsWhatIsWritten) {
  TempFolder t;
  ASSERT_TRUE(write_calibration(t / "c.yaml", camera_of(CameraModel::radtan, {0.1, 0, 0, 0, 0}),
                                CalibrationFormat::opencv));
  const cv::FileStorage file(t / "c.yaml", cv::FileStorage::READ);
  cv::Mat K, d;
  file["camera_matrix"] >> K;
  file["distortion_coefficients"] >> d;
  EXPECT_EQ(K.at<double>(0, 0), 458.654);
  EXPECT_EQ(d.at<double>(0, 0), 0.1);
  EXPECT_EQ(static_cast<int>(file["image_width"]), 752);
}

TEST(Calibration, ReadsOpenCvsOwnYamlAndXml) {
  for (const char* name : {"c.yml", "c.xml"}) {
    TempFolder t;
    {
      cv::FileStorage file(t / name, cv::FileStorage::WRITE);
      file << "calibration_time"
           << "Tue Nov  1"
           << "image_width" << 640 << "image_height" << 480;
      file << "camera_matrix" << (cv::Mat_<double>(3, 3) << 600, 0, 320.5, 0, 610, 240.5, 0, 0, 1);
      file << "distortion_coefficients" << (cv::Mat_<double>(5, 1) << -0.2, 0.1, 0, 1e-3, 0);
    }
    const auto read = read_calibration(t / name);
    ASSERT_TRUE(read) << read.error().to_string();
    EXPECT_EQ(read->format, "OpenCV");
    const Camera expected{CameraModel::radtan,    640, 480, 600, 610, 320.5, 240.5,
                          {-0.2, 0.1, 0, 1e-3, 0}};
    EXPECT_EQ(read->camera, expected);
  }
}

TEST(Calibration, KalibrCamchain) {
  const Calibration c = read_as("camchain.yaml",
                                "cam0:\n  cam_overlaps: [1]\n  camera_model: pinhole\n"
                                "  distortion_coeffs: [-0.01, 0.02, -0.03, 0.04]\n"
                                "  distortion_model: equidistant\n"
                                "  intrinsics: [190.97, 190.98, 254.93, 256.89]\n"
                                "  resolution: [512, 512]\n  rostopic: /cam0/image_raw\n"
                                "  T_cam_imu:\n  - [1.0, 0.0, 0.0, 0.5]\n  - [0.0, 1.0, 0.0, 0.0]\n"
                                "  - [0.0, 0.0, 1.0, 0.0]\n  - [0.0, 0.0, 0.0, 1.0]\n"
                                "cam1:\n  camera_model: pinhole\n");
  EXPECT_EQ(c.format, "Kalibr camchain");
  EXPECT_EQ(c.camera.model, CameraModel::equidistant);
  EXPECT_EQ(c.camera.distortion[3], 0.04);
  EXPECT_EQ(c.camera.fx_px, 190.97);
  EXPECT_TRUE(has_note(c.notes, "cam0 is used"));
  ASSERT_TRUE(c.T_body_camera);
  EXPECT_NEAR(c.T_body_camera->translation().x(), -0.5, 1e-12);
}

TEST(Calibration, RosCameraInfo) {
  const std::string head =
      "image_width: 640\nimage_height: 480\ncamera_name: narrow\ncamera_matrix:\n  rows: 3\n"
      "  cols: 3\n  data: [438.7, 0, 305.6, 0, 437.3, 243.7, 0, 0, 1]\n";
  const std::string tail =
      "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n";
  Calibration c = read_as("ost.yaml", head +
                                          "distortion_model: plumb_bob\ndistortion_coefficients:\n"
                                          "  rows: 1\n  cols: 5\n  data: [-0.36, 0.11, 0.001, "
                                          "-0.002, 0]\n" +
                                          tail);
  EXPECT_EQ(c.format, "ROS camera_info");
  EXPECT_EQ(c.camera.model, CameraModel::radtan);
  EXPECT_EQ(c.camera.cy_px, 243.7);
  c = read_as("ost.yaml", head +
                              "distortion_model: rational_polynomial\ndistortion_coefficients:\n"
                              "  data: [0.1, 0, 0, 0, 0, 0, 0, 0]\n" +
                              tail);
  EXPECT_EQ(c.camera.distortion[0], 0.1);
  EXPECT_THAT(error_of("ost.yaml", head + "distortion_model: rational_polynomial\n"
                                          "distortion_coefficients:\n"
                                          "  data: [0.1, 0, 0, 0, 0, 0.5, 0, 0]\n"),
              HasSubstr("rational"));
  // As `rostopic echo` prints it.
  c = read_as("camera_info.yaml",
              "header:\n  seq: 1\nheight: 480\nwidth: 640\ndistortion_model: equidistant\n"
              "D: [0.1, 0.2, 0.3, 0.4]\nK: [400, 0, 320, 0, 401, 240, 0, 0, 1]\n"
              "R: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nP: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]\n");
  EXPECT_EQ(c.camera.model, CameraModel::equidistant);
  EXPECT_EQ(c.camera.fy_px, 401);
}

TEST(Calibration, ColmapModels) {
  struct Case {
    const char* row;
    Camera expected;
  };
  // COLMAP's (0, 0) is the corner of the first pixel, ours its centre: half a pixel less.
  for (const Case& c : {
           Case{"1 SIMPLE_PINHOLE 640 480 500 320 240",
                {CameraModel::pinhole, 640, 480, 500, 500, 319.5, 239.5, {}}},
           Case{"1 PINHOLE 640 480 500 501 320 240",
                {CameraModel::pinhole, 640, 480, 500, 501, 319.5, 239.5, {}}},
           Case{"1 SIMPLE_RADIAL 640 480 500 320 240 0.1",
                {CameraModel::radtan, 640, 480, 500, 500, 319.5, 239.5, {0.1}}},
           Case{"1 RADIAL 640 480 500 320 240 0.1 0.2",
                {CameraModel::radtan, 640, 480, 500, 500, 319.5, 239.5, {0.1, 0.2}}},
           Case{"1 OPENCV 640 480 500 501 320 240 0.1 0.2 0.3 0.4",
                {CameraModel::radtan, 640, 480, 500, 501, 319.5, 239.5, {0.1, 0.2, 0.3, 0.4}}},
           Case{"1 FULL_OPENCV 640 480 500 501 320 240 0.1 0.2 0.3 0.4 0.5 0 0 0",
                {CameraModel::radtan, 640, 480, 500, 501, 319.5, 239.5, {0.1, 0.2, 0.3, 0.4, 0.5}}},
           Case{"1 OPENCV_FISHEYE 640 480 500 501 320 240 0.1 0.2 0.3 0.4",
                {CameraModel::equidistant, 640, 480, 500, 501, 319.5, 239.5, {0.1, 0.2, 0.3, 0.4}}},
           Case{"1 FOV 640 480 500 501 320 240 0.9",
                {CameraModel::fov, 640, 480, 500, 501, 319.5, 239.5, {0.9}}},
       }) {
    EXPECT_EQ(read_as("cameras.txt", std::string("# comment\n") + c.row + "\n").camera, c.expected)
        << c.row;
  }
  EXPECT_THAT(error_of("cameras.txt", "1 PINHOL 640 480 500 501 320 240\n"), HasSubstr("PINHOLE"));
  EXPECT_THAT(error_of("cameras.txt", "1 PINHOLE 640 480 500 501 320\n"), HasSubstr(":1:"));
}

TEST(Calibration, MonoVoCamera) {
  // Relative values, the corner of the first pixel at (0, 0).
  Calibration c = read_as(
      "camera.txt", "0.349153 0.436593 0.493140 0.499021 0.933271\n1280 1024\ncrop\n640 480\n");
  EXPECT_EQ(c.format, "TUM monoVO camera.txt");
  EXPECT_EQ(c.camera.model, CameraModel::fov);
  EXPECT_NEAR(c.camera.fx_px, 0.349153 * 1280, 1e-9);
  EXPECT_NEAR(c.camera.cy_px, 0.499021 * 1024 - 0.5, 1e-9);
  EXPECT_EQ(c.camera.distortion[0], 0.933271);
  c = read_as("camera.txt", "RadTan 400 401 320 240 -0.1 0.2 0.3 0.4\n640 480\nnone\n640 480\n");
  EXPECT_EQ(c.camera.model, CameraModel::radtan);
  EXPECT_EQ(c.camera.cx_px, 320);
  c = read_as("camera.txt", "Pinhole 400 401 320 240 0\n640 480\nnone\n640 480\n");
  EXPECT_EQ(c.camera.model, CameraModel::pinhole);
  c = read_as("camera.txt",
              "EquiDistant 0.5 0.6 0.5 0.5 0.1 0.2 0.3 0.4\n640 480\ncrop\n640 480\n");
  EXPECT_EQ(c.camera.model, CameraModel::equidistant);
  EXPECT_THAT(error_of("camera.txt", "RadTam 400 401 320 240 1 2 3 4\n640 480\n"),
              HasSubstr("did you mean RadTan"));
  EXPECT_THAT(error_of("camera.txt", "400 401\n640 480\n"), HasSubstr(":1:"));
}

TEST(Calibration, MatrixAndItsDistortion) {
  TempFolder t;
  write_text(t / "K.txt", "420.5 0. 355.2\n0. 420.6 250.3\n0. 0. 1.\n");
  EXPECT_EQ(read_calibration(t / "K.txt")->camera.model, CameraModel::pinhole);
  write_text(t / "D.txt", "-0.29 0.08\n");
  const auto read = read_calibration(t / "K.txt");
  ASSERT_TRUE(read);
  EXPECT_EQ(read->camera.model, CameraModel::radtan);
  EXPECT_EQ(read->camera.distortion[1], 0.08);
  write_text(t / "D.txt", "-0.29 nan\n");
  EXPECT_FALSE(read_calibration(t / "K.txt"));
  EXPECT_THAT(error_of("K.txt", "420 0 355\n1 420 250\n0 0 1\n"), HasSubstr("camera matrix"));
}

TEST(Calibration, MisspeltKeysAreNamed) {
  const std::string good =
      "image_width: 640\nimage_height: 480\ncamera_matrix:\n"
      "  data: [438.7, 0, 305.6, 0, 437.3, 243.7, 0, 0, 1]\n"
      "distortion_coefficients:\n  data: [0.1, 0, 0, 0]\n";
  const auto with = [&](std::string from, const std::string& to) {
    std::string text = good;
    return text.replace(text.find(from), from.size(), to);
  };
  EXPECT_THAT(error_of("c.yaml", with("camera_matrix", "camera_matirx")),
              HasSubstr("did you mean camera_matrix"));
  // An optional key that is misspelt must not fall back to its default in silence.
  EXPECT_THAT(error_of("c.yaml", with("image_width", "image_widht")),
              HasSubstr("did you mean image_width"));
  EXPECT_THAT(error_of("c.yaml", with("  data: [0.1", "  dat: [0.1")), HasSubstr("data"));
  EXPECT_THAT(error_of("c.yaml", "a: 1\nb: 2\n"), HasSubstr("the file has: a, b"));
  EXPECT_THAT(error_of("c.yaml", "just text"), HasSubstr("no keys"));
  EXPECT_THAT(error_of("c.yaml", "cam0:\n  camera_model: pinhole\n  intrinsic: [1, 2, 3, 4]\n"),
              HasSubstr("cam0"));
  EXPECT_THAT(error_of("c.txt", std::string("\0\1\2", 3)), HasSubstr("not a calibration file"));
  EXPECT_THAT(error_of("c.xml",
                       "<?xml version=\"1.0\"?>\n<opencv_storage><camera_matirx>1</camera_matirx>"
                       "</opencv_storage>\n"),
              HasSubstr("\"camera_matirx\""));
  EXPECT_THAT(error_of("c.xml", "<?xml version=\"1.0\"?><opencv"), HasSubstr("XML"));
}

TEST(Calibration, FitsImages) {
  Calibration c;
  c.camera = {CameraModel::pinhole, 1226, 370, 700, 700, 600, 180, {}};
  auto half = fit_calibration(c, 613, 185, "x");
  ASSERT_TRUE(half);
  EXPECT_NEAR(half->camera.fx_px, 350, 1e-9);
  EXPECT_NEAR(half->camera.cx_px, 299.75, 1e-9);
  EXPECT_EQ(half->notes.size(), 1u);
  // A size that was rounded to whole pixels is one factor; a crop is not.
  EXPECT_TRUE(fit_calibration(c, 1000, 302, "x"));
  EXPECT_FALSE(fit_calibration(c, 1226, 300, "x"));
  EXPECT_FALSE(fit_calibration(c, 1, 370, "x"));
  c.camera.width_px = c.camera.height_px = 0;
  const auto taken = fit_calibration(c, 1226, 370, "x");
  ASSERT_TRUE(taken);
  EXPECT_EQ(taken->camera.width_px, 1226);
  EXPECT_TRUE(taken->notes.empty());
  EXPECT_TRUE(has_note(fit_calibration(c, 640, 480, "x")->notes, "principal point"));
}

}  // namespace
}  // namespace corvid
