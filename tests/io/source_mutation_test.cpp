#include <gtest/gtest.h>

#include <filesystem>
#include <functional>
#include <random>

#include "io/calibration.h"
#include "io/exif.h"
#include "io/image_file.h"
#include "io/source_test_files.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace {

using test::TempFolder;
using test::write_image;
using test::write_text;

// Bytes changed, removed, doubled or put in, among them the ones that parsers stumble over.
std::string mutated(std::string text, std::mt19937_64& rng) {
  static const std::vector<std::string> kTokens = {"nan",
                                                   "inf",
                                                   "-",
                                                   "1e999",
                                                   "-1",
                                                   "0",
                                                   "99999999999999999999",
                                                   ",",
                                                   "\n",
                                                   "\r\n",
                                                   "#",
                                                   ":",
                                                   "[",
                                                   "]",
                                                   "{",
                                                   "&a [*a]",
                                                   "\"",
                                                   "'",
                                                   "\t",
                                                   "e",
                                                   "../",
                                                   "<",
                                                   ">",
                                                   "\xFF\xFE",
                                                   std::string(1, '\0'),
                                                   " ",
                                                   "4294967296"};
  const int changes = 1 + static_cast<int>(rng() % 4);
  for (int i = 0; i < changes; ++i) {
    const std::size_t at = text.empty() ? 0 : rng() % text.size();
    const std::size_t length = std::min<std::size_t>(rng() % 20, text.size() - at);
    switch (rng() % 5) {
      case 0:
        if (!text.empty()) text[at] = static_cast<char>(rng());
        break;
      case 1:
        text.erase(at, length);
        break;
      case 2:
        text.insert(at, text.substr(at, length));
        break;
      case 3:
        text.insert(at, kTokens[rng() % kTokens.size()]);
        break;
      default:
        if (rng() % 4 == 0)
          text.resize(at);
        else if (!text.empty())
          text[at] = static_cast<char>(text[at] ^ (1 << rng() % 8));
    }
  }
  return text;
}

void expect_sane_error(const Error& error) { EXPECT_FALSE(error.to_string().empty()); }

// Whatever comes out must be usable: finite cameras and poses, rising times.
void use(const std::string& path) {
  auto source = open_source(path);
  if (!source) return expect_sane_error(source.error());
  const SourceInfo& info = (*source)->info();
  ASSERT_TRUE(info.camera);
  EXPECT_EQ(info.camera->validate(), "");
  std::optional<std::int64_t> last;
  for (int i = 0; i < 1000; ++i) {
    const auto frame = (*source)->next();
    if (!frame) return expect_sane_error(frame.error());
    if (!*frame) break;
    ASSERT_TRUE(!last || (*frame)->time_ns > *last);
    last = (*frame)->time_ns;
    ASSERT_EQ((*frame)->grey.width(), info.camera->width_px);
    ASSERT_EQ((*frame)->camera->validate(), "");
  }
  EXPECT_GT((*source)->counts().delivered, 0u);
  last.reset();
  for (const StampedPose& pose : (*source)->truth()) {
    ASSERT_TRUE(pose.T_world_camera.finite());
    ASSERT_TRUE(!last || pose.time_ns > *last);
    last = pose.time_ns;
  }
}

// Mutates one file of a folder at a time and calls `check`.
void mutate(const std::string& file, int rounds, const std::function<void()>& check) {
  const std::string good = test::read_text(file);
  ASSERT_FALSE(good.empty()) << file;
  std::mt19937_64 rng(1);
  for (int i = 0; i < rounds; ++i) {
    SCOPED_TRACE(file + ", round " + std::to_string(i));
    write_text(file, mutated(good, rng));
    check();
    if (testing::Test::HasFailure()) return;
  }
  write_text(file, good);
}

constexpr int kRounds = 300;

TEST(SourceMutation, Asl) {
  TempFolder t;
  test::write_asl(t.path(), 2);
  for (const char* name : {"mav0/cam0/data.csv", "mav0/cam0/sensor.yaml",
                           "mav0/state_groundtruth_estimate0/data.csv"}) {
    mutate(t / name, kRounds, [&] { use(t.path()); });
  }
}

TEST(SourceMutation, Kitti) {
  TempFolder t;
  for (int i = 0; i < 2; ++i) write_image(t / ("image_0/00000" + std::to_string(i) + ".png"));
  write_text(t / "calib.txt", "P0: 30 0 16 0 0 30 12 0 0 0 1 0\n");
  write_text(t / "times.txt", "0\n1.038752e-01\n");
  write_text(t / "poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n");
  for (const char* name : {"calib.txt", "times.txt", "poses.txt"}) {
    mutate(t / name, kRounds, [&] { use(t.path()); });
  }
}

TEST(SourceMutation, TumRgbd) {
  TempFolder t;
  for (int i = 0; i < 2; ++i) write_image(t / ("rgb/" + std::to_string(i) + ".png"), 64, 48);
  write_text(t / "rgb.txt", "# color\n1305031102.175304 rgb/0.png\n1305031102.2 rgb/1.png\n");
  write_text(t / "groundtruth.txt",
             "1305031100.1 1 2 3 0 0 0.6 0.8\n1305031103.1 1 2 4 0 0 0.6 0.8\n");
  for (const char* name : {"rgb.txt", "groundtruth.txt"}) {
    mutate(t / name, kRounds, [&] { use(t.path()); });
  }
}

TEST(SourceMutation, MonoVo) {
  TempFolder t;
  for (int i = 0; i < 2; ++i) write_image(t / ("images/0000" + std::to_string(i) + ".png"), 64, 48);
  write_text(t / "times.txt", "00000 1446473911.2 0.5\n00001 1446473911.25 0.5\n");
  write_text(t / "camera.txt", "0.5 0.6 0.5 0.5 0.93\n64 48\ncrop\n64 48\n");
  for (const char* name : {"times.txt", "camera.txt"}) {
    mutate(t / name, kRounds, [&] { use(t.path()); });
  }
}

TEST(SourceMutation, Colmap) {
  TempFolder t;
  for (int i = 0; i < 2; ++i) write_image(t / ("images/" + std::to_string(i) + ".png"), 64, 48);
  write_text(t / "sparse/cameras.txt", "3 OPENCV 64 48 50 51 32 24 0.1 0.2 0.3 0.4\n");
  write_text(t / "sparse/images.txt",
             "1 1 0 0 0 1 2 3 3 0.png\n\n2 0.6 0 0 0.8 0 0 0 3 1.png\n10 10 -1\n");
  for (const char* name : {"sparse/cameras.txt", "sparse/images.txt"}) {
    mutate(t / name, kRounds, [&] { use(t.path()); });
  }
}

TEST(SourceMutation, MiddleburyAndStrecha) {
  TempFolder m;
  const std::string row = " 30 0 16 0 30 12 0 0 1 0 1 0 -1 0 0 0 0 1 1 2 3\n";
  for (int i = 0; i < 2; ++i) write_image(m / ("v" + std::to_string(i) + ".png"));
  write_text(m / "a_par.txt", "2\nv0.png" + row + "v1.png" + row);
  mutate(m / "a_par.txt", kRounds, [&] { use(m.path()); });
  TempFolder s;
  for (int i = 0; i < 2; ++i) {
    write_image(s / ("images/" + std::to_string(i) + ".jpg"));
    write_text(s / ("gt_dense_cameras/" + std::to_string(i) + ".jpg.camera"),
               "30 0 16\n0 30 12\n0 0 1\n0 0 0\n0 1 0\n-1 0 0\n0 0 1\n5 6 7\n32 24\n");
  }
  mutate(s / "gt_dense_cameras/0.jpg.camera", kRounds, [&] { use(s.path()); });
}

TEST(SourceMutation, FolderWithMatrixTimesAndPoses) {
  TempFolder t;
  for (int i = 0; i < 2; ++i) write_image(t / ("images/" + std::to_string(i) + ".png"));
  write_text(t / "K.txt", "30 0 16\n0 30 12\n0 0 1\n");
  write_text(t / "D.txt", "-0.2 0.01\n");
  write_text(t / "times.txt", "1.0\n1.1\n");
  write_text(t / "poses.txt", "-0.37 0.03 0.06 -0.1 -0.14 0.39\n0 0 0 1 2 3\n");
  for (const char* name : {"K.txt", "D.txt", "times.txt", "poses.txt"}) {
    mutate(t / name, kRounds, [&] { use(t.path()); });
  }
}

TEST(SourceMutation, CalibrationFiles) {
  const Camera camera{CameraModel::radtan, 640, 480, 500, 501, 320, 240, {-0.1, 0.2, 0, 0, 0}};
  TempFolder t;
  ASSERT_TRUE(write_calibration(t / "opencv.yaml", camera, CalibrationFormat::opencv));
  ASSERT_TRUE(write_calibration(t / "kalibr.yaml", camera, CalibrationFormat::kalibr));
  write_text(t / "ros.yaml",
             "image_width: 640\nimage_height: 480\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
             "  data: [438.7, 0, 305.6, 0, 437.3, 243.7, 0, 0, 1]\ndistortion_model: plumb_bob\n"
             "distortion_coefficients:\n  data: [0.1, 0, 0, 0, 0]\n");
  write_text(t / "opencv.xml",
             "<?xml version=\"1.0\"?>\n<opencv_storage>\n<image_width>640</image_width>\n"
             "<image_height>480</image_height>\n<camera_matrix type_id=\"opencv-matrix\">\n"
             "  <rows>3</rows><cols>3</cols><dt>d</dt>\n  <data>500. 0. 320. 0. 501. 240. 0. 0. 1."
             "</data></camera_matrix>\n<distortion_coefficients type_id=\"opencv-matrix\">\n"
             "  <rows>5</rows><cols>1</cols><dt>d</dt><data>-0.1 0.2 0. 0. 0.</data>"
             "</distortion_coefficients>\n</opencv_storage>\n");
  for (const char* name : {"opencv.yaml", "kalibr.yaml", "ros.yaml", "opencv.xml"}) {
    const auto good = read_calibration(t / name);
    ASSERT_TRUE(good) << good.error().to_string();
    mutate(t / name, kRounds, [&] {
      const auto read = read_calibration(t / name);
      if (!read) return expect_sane_error(read.error());
      Camera sized = read->camera;
      if (sized.width_px == 0) sized.width_px = sized.height_px = 1;
      EXPECT_EQ(sized.validate(), "");
    });
  }
}

TEST(SourceMutation, TrajectoryFiles) {
  TempFolder t;
  write_text(t / "tum.txt", "1.5 1 2 3 0 0 0.6 0.8\n2.5 1 2 4 0 0 0.6 0.8\n");
  write_text(t / "kitti.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n");
  write_text(t / "euroc.csv", "#t\n1403638538577829632,4,5,6,0.5,0.5,0.5,-0.5,9\n");
  for (const char* name : {"tum.txt", "kitti.txt", "euroc.csv"}) {
    mutate(t / name, kRounds, [&] {
      const auto read = read_trajectory(t / name);
      if (!read) return expect_sane_error(read.error());
      for (const StampedPose& pose : *read) EXPECT_TRUE(pose.T_world_camera.finite());
    });
  }
}

TEST(SourceMutation, ImagesAndExif) {
  TempFolder t;
  test::ExifFields fields;
  fields.make = "Maker";
  fields.model = "Model";
  fields.time = "2020:02:29 12:00:00";
  fields.fraction = "25";
  fields.focal_mm = 5;
  fields.focal_35mm = 28;
  fields.plane_px_per_inch = 2540;
  test::write_jpeg_with_exif(t / "a.jpg", 64, 48, fields);
  for (const char* name : {"b.png", "c.bmp", "d.tif", "e.pgm"}) write_image(t / name, 64, 48);
  for (const char* name : {"a.jpg", "b.png", "c.bmp", "d.tif", "e.pgm"}) {
    mutate(t / name, 200, [&] {
      const auto image = read_image(t / name);
      if (!image) expect_sane_error(image.error());
      const auto exif = read_exif(t / name);
      if (!exif) return;
      const auto focal = exif_focal(*exif, 64, 48);
      EXPECT_TRUE(!focal || std::isfinite(focal->focal_px));
    });
  }
}

}  // namespace
}  // namespace corvid
