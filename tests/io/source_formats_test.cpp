#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <opencv2/videoio.hpp>

#include "io/exif.h"
#include "io/image_file.h"
#include "io/readers/text.h"
#include "io/source_test_files.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
using test::all_frames;
using test::ExifFields;
using test::has_note;
using test::open_error;
using test::opened;
using test::TempFolder;
using test::write_image;
using test::write_jpeg_with_exif;
using test::write_text;
using testing::HasSubstr;

TEST(SourceFormats, AslTruthIsTheCamerasOwn) {
  TempFolder t;
  test::write_asl(t.path());
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  const Trajectory truth = source->truth();
  ASSERT_EQ(truth.size(), 40u);
  EXPECT_EQ(truth[1].time_ns, 1'010'000'000);
  // T_WB is (1.5, 2, 3) without turn; T_BS shifts by (0.1, 0.2, 0.3) and turns by 90 degrees.
  EXPECT_NEAR((truth[1].T_world_camera.translation() - Eigen::Vector3d(1.6, 2.2, 3.3)).norm(), 0,
              1e-12);
  EXPECT_NEAR((truth[1].T_world_camera.R() * Eigen::Vector3d::UnitX()).y(), 1, 1e-12);
  SourceOptions options;
  options.rate_hz = 50;
  const auto faster = opened(t.path(), options);
  ASSERT_TRUE(faster);
  EXPECT_TRUE(faster->truth().empty());
  EXPECT_EQ(all_frames(*faster)[3]->time_ns, 60'000'000);
}

TEST(SourceFormats, GivenCalibrationReplacesTheOwn) {
  TempFolder t;
  test::write_asl(t.path());
  write_text(t / "other.txt", "99 0 16\n0 98 12\n0 0 1\n");
  SourceOptions options;
  options.calibration_path = t / "other.txt";
  const auto source = opened(t.path(), options);
  ASSERT_TRUE(source);
  EXPECT_EQ(source->info().camera->fx_px, 99);
  EXPECT_EQ(source->info().camera->width_px, 32);
  EXPECT_EQ(source->truth().size(), 40u) << "the extrinsic pose is still the recording's";
}

TEST(SourceFormats, KittiRootAndColourCamera) {
  TempFolder t;
  const std::string sequence = t / "sequences/07";
  for (int i = 0; i < 3; ++i) {
    write_image(sequence + "/image_2/00000" + std::to_string(i) + ".png", 32, 24, i, 3);
  }
  // P2's fourth column over the focal length: the colour camera sits 0.1 m to the left.
  write_text(sequence + "/calib.txt",
             "P0: 30 0 16 0 0 30 12 0 0 0 1 0\nP2: 30 0 16 3 0 30 12 0 0 0 1 0\n");
  write_text(sequence + "/times.txt", "0\n0.1\n0.2\n");
  write_text(t / "poses/07.txt",
             "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n1 0 0 0 0 1 0 0 0 0 1 2\n");
  for (const std::string& path : {t.path(), sequence, sequence + "/"}) {
    const auto source = opened(path);
    ASSERT_TRUE(source);
    EXPECT_EQ(source->info().kind, "KITTI odometry");
    EXPECT_TRUE(source->info().colour);
    const Trajectory truth = source->truth();
    ASSERT_EQ(truth.size(), 3u);
    EXPECT_NEAR((truth[2].T_world_camera.translation() - Eigen::Vector3d(-0.1, 0, 2)).norm(), 0,
                1e-12);
  }
  fs::copy(sequence, t / "sequences/08", fs::copy_options::recursive);
  EXPECT_THAT(open_error(t.path()), HasSubstr("choose one, for example"));
  // A part of a sequence keeps its numbers; times and poses are found by them.
  fs::remove(sequence + "/image_2/000000.png");
  const auto part = opened(sequence);
  ASSERT_TRUE(part);
  const auto frames = all_frames(*part);
  ASSERT_EQ(frames.size(), 2u);
  EXPECT_EQ(frames[0]->time_ns, 100'000'000);
  EXPECT_NEAR(part->truth()[0].T_world_camera.translation().z(), 1, 1e-12);
}

void write_tum(const std::string& root) {
  std::string list = "# color images\n# timestamp filename\n";
  for (int i = 0; i < 3; ++i) {
    const std::string name = "rgb/130503110" + std::to_string(i) + ".175304.png";
    write_image(root + "/" + name, 640, 480, i, 3);
    list += "130503110" + std::to_string(i) + ".175304 " + name + "\n";
  }
  write_text(root + "/rgb.txt", list);
  write_text(root + "/depth.txt", "# depth\n");
  write_text(root + "/groundtruth.txt",
             "# timestamp tx ty tz qx qy qz qw\n1305031100.1 1 2 3 0 0 0.6 0.8\n"
             "1305031103.1 1 2 4 0 0 0.6 0.8\n");
}

TEST(SourceFormats, TumRgbd) {
  TempFolder t;
  const std::string root = t / "rgbd_dataset_freiburg2_desk";
  write_tum(root);
  const auto source = opened(root);
  ASSERT_TRUE(source);
  const SourceInfo& info = source->info();
  EXPECT_EQ(info.kind, "TUM RGB-D");
  EXPECT_TRUE(info.has_depth);
  EXPECT_EQ(info.camera->fx_px, 520.9);
  EXPECT_EQ(info.camera->model, CameraModel::radtan);
  EXPECT_TRUE(has_note(info.notes, "freiburg2"));
  const auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_EQ(frames[0]->time_ns, 1305031100'175'304'000);
  ASSERT_EQ(source->truth().size(), 2u);
  EXPECT_NEAR(source->truth()[0].T_world_camera.rotation().z(), 0.6, 1e-12);

  fs::rename(root, t / "my_recording");
  const auto unknown = opened(t / "my_recording");
  ASSERT_TRUE(unknown);
  EXPECT_EQ(unknown->info().camera->fx_px, 525);
  EXPECT_EQ(unknown->info().intrinsics, IntrinsicsOrigin::nominal);
  write_text(t / "my_recording/calibration.txt", "");  // not one of the usual names
  write_text(t / "my_recording/camera.txt", "Pinhole 500 501 320 240 0\n640 480\n");
  EXPECT_EQ(opened(t / "my_recording")->info().camera->fx_px, 500);
}

TEST(SourceFormats, MonoVo) {
  TempFolder t;
  for (int i = 0; i < 3; ++i) write_image(t / ("images/0000" + std::to_string(i) + ".jpg"), 64, 48);
  write_text(t / "times.txt",
             "00000 1446473911.2 0.5\n00001 1446473911.25 0.5\n00002 1446473911.3 0.5\n"
             "00003 1446473911.35 0.5\n");
  write_text(t / "camera.txt", "0.5 0.6 0.5 0.5 0.93\n64 48\ncrop\n64 48\n");
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(source->info().kind, "TUM monoVO");
  EXPECT_EQ(source->info().camera->model, CameraModel::fov);
  EXPECT_NEAR(source->info().rate_hz, 20, 1e-6);
  const auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_EQ(frames[1]->time_ns, 1446473911'250'000'000);
  EXPECT_EQ(source->counts().skipped, 1u) << "00003 is listed but absent";
  fs::remove_all(t / "images");
  write_text(t / "images.zip", "PK");
  EXPECT_THAT(open_error(t.path()), HasSubstr("unzip"));
}

TEST(SourceFormats, ColmapTextModel) {
  TempFolder t;
  for (const char* name : {"b 10.png", "b 9.png", "b 11.png"}) {
    write_image(t / (std::string("images/") + name), 64, 48);
  }
  write_text(t / "sparse/0/cameras.txt", "# cameras\n3 PINHOLE 64 48 50 51 32 24\n");
  // The first image has no points: its second row is blank.
  write_text(t / "sparse/0/images.txt",
             "# images\n1 1 0 0 0 1 2 3 3 b 10.png\n\n2 0.6 0 0 0.8 0 0 0 3 b 9.png\n"
             "10 10 -1 20 20 5\n3 1 0 0 0 4 5 6 7 b 11.png\n\n");
  for (const std::string& path : {t.path(), t / "sparse/0"}) {
    const auto source = opened(path);
    ASSERT_TRUE(source);
    EXPECT_EQ(source->info().kind, "COLMAP text model");
    EXPECT_EQ(source->info().camera->cx_px, 31.5);
    const auto frames = all_frames(*source);
    ASSERT_EQ(frames.size(), 2u);
    EXPECT_EQ(frames[0]->name, "b 9.png");
    EXPECT_EQ(source->counts().skipped, 1u) << "camera 7 does not exist";
    EXPECT_TRUE(has_note(source->counts().messages, "images.txt:6: there is no camera 7"));
    const Trajectory truth = source->truth();
    ASSERT_EQ(truth.size(), 2u);
    EXPECT_NEAR((truth[1].T_world_camera.translation() + Eigen::Vector3d(1, 2, 3)).norm(), 0, 1e-12)
        << "the file has camera from world";
    EXPECT_NEAR(truth[0].T_world_camera.rotation().z(), -0.8, 1e-12);
  }
}

TEST(SourceFormats, MiddleburyWithACameraPerImage) {
  TempFolder t;
  const std::string pose = " 0 1 0 -1 0 0 0 0 1 1 2 3\n";
  for (int i = 1; i < 4; ++i) write_image(t / ("v" + std::to_string(i) + ".png"));
  write_text(t / "scene_par.txt", "4\nv1.png 30 0 16 0 30 12 0 0 1" + pose +
                                      "v2.png 40 0 16 0 30 12 0 0 1" + pose +
                                      "v3.png 40 0 16 0 30 12 0 0 1 0 1 0 -1\n");
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_TRUE(source->info().stills);
  const auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 2u);
  EXPECT_EQ(frames[0]->camera->fx_px, 30);
  EXPECT_EQ(frames[1]->camera->fx_px, 40);
  EXPECT_EQ(frames[1]->camera->width_px, 32);
  EXPECT_EQ(source->counts().skipped, 1u);
  EXPECT_TRUE(has_note(source->counts().messages, "scene_par.txt:4:"));
  EXPECT_TRUE(has_note(source->info().notes, "promises 4 images but lists 3"));
  // p_camera = R p_world + t, so the world's origin is at t.
  const Pose T = source->truth()[0].T_world_camera;
  EXPECT_NEAR((T.inverse() * Eigen::Vector3d::Zero() - Eigen::Vector3d(1, 2, 3)).norm(), 0, 1e-12);
}

TEST(SourceFormats, StrechaFaultsAreCounted) {
  TempFolder t;
  const std::string camera = "30 0 16\n0 30 12\n0 0 1\n0 0 0\n0 1 0\n-1 0 0\n0 0 1\n5 6 7\n32 24\n";
  for (int i = 0; i < 3; ++i) {
    write_image(t / ("images/000" + std::to_string(i) + ".jpg"));
    write_text(t / ("gt_dense_cameras/000" + std::to_string(i) + ".jpg.camera"),
               i == 1 ? camera.substr(0, 40) : camera);
  }
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(source->info().kind, "Strecha multi-view");
  EXPECT_EQ(all_frames(*source).size(), 2u);
  EXPECT_EQ(source->counts().skipped, 1u);
  EXPECT_EQ(source->truth()[0].T_world_camera.translation(), Eigen::Vector3d(5, 6, 7));
}

TEST(SourceFormats, SevenScenesWithoutSomePoses) {
  TempFolder t;
  for (int i : {0, 1, 3}) {
    const std::string stem = t / ("seq-01/frame-00000" + std::to_string(i));
    write_image(stem + ".color.png", 640, 480, i, 3);
    write_text(stem + ".pose.txt",
               i == 1 ? "nan nan nan nan\n" : "1 0 0 0.5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
  }
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(source->info().kind, "7-Scenes");
  EXPECT_FALSE(source->info().has_depth);
  const auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_EQ(frames[2]->time_ns, 100'000'000) << "the lost frame keeps its time";
  EXPECT_EQ(source->counts().skipped, 1u);
  EXPECT_EQ(source->truth().size(), 2u);
}

TEST(SourceFormats, FolderInNaturalOrderWithTimesFromNames) {
  TempFolder t;
  for (const char* name : {"img_10.png", "img_9.png", "img_1.png", ".hidden.png"}) {
    write_image(t / name);
  }
  auto source = opened(t.path());
  ASSERT_TRUE(source);
  auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_EQ(frames[1]->name, "img_9.png");
  EXPECT_TRUE(has_note(source->info().notes, "30 Hz is assumed"));
  EXPECT_EQ(source->info().intrinsics, IntrinsicsOrigin::guess);
  EXPECT_NEAR(source->info().camera->fx_px, 1.2 * 32, 1e-12);
  EXPECT_TRUE(has_note(source->info().notes, "guessed"));

  TempFolder n;
  write_image(n / "1403638538577829376.png");
  write_image(n / "1403638539577829376.png");
  source = opened(n.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(all_frames(*source)[0]->time_ns, 1403638538577829376);
  EXPECT_TRUE(source->info().stills) << "1 s apart";

  TempFolder f;
  for (int i = 0; i < 3; ++i) write_image(f / ("images/" + std::to_string(i) + ".png"));
  write_text(f / "times.txt", "5.0\n5.1\n5.2\n");
  source = opened(f / "images");
  ASSERT_TRUE(source);
  EXPECT_EQ(all_frames(*source)[2]->time_ns, 5'200'000'000);
  EXPECT_FALSE(source->info().stills);
}

TEST(SourceFormats, CalibrationBesideTheImages) {
  const std::string yaml =
      "cam0:\n  camera_model: pinhole\n  intrinsics: [30, 31, 16, 12]\n"
      "  distortion_model: none\n  distortion_coeffs: []\n  resolution: [32, 24]\n";
  for (const char* name : {"calib.yaml", "images/camchain.yaml", "camera_info.yml"}) {
    TempFolder t;
    write_image(t / "images/a.png");
    write_text(t / name, yaml);
    for (const std::string& path : {t.path(), t / "images"}) {
      const auto source = opened(path);
      ASSERT_TRUE(source);
      EXPECT_EQ(source->info().camera->fy_px, 31);
      EXPECT_EQ(source->info().intrinsics, IntrinsicsOrigin::calibration);
    }
  }
}

TEST(SourceFormats, ExifFocalLengths) {
  const auto focal = [](ExifFields fields, int width, int height) {
    TempFolder t;
    write_jpeg_with_exif(t / "a.jpg", width, height, fields);
    const auto exif = read_exif(t / "a.jpg");
    return exif ? exif_focal(*exif, width, height) : std::nullopt;
  };
  ExifFields f;
  f.make = "Someone";
  f.focal_mm = 5;
  EXPECT_FALSE(focal(f, 400, 300)) << "millimetres alone say nothing";
  f.focal_35mm = 24;
  EXPECT_NEAR(focal(f, 400, 300)->focal_px, 24 * 500 / std::hypot(36, 24), 1e-9);
  EXPECT_NEAR(focal(f, 300, 400)->focal_px, 24 * 500 / std::hypot(36, 24), 1e-9);
  f.focal_35mm.reset();
  f.plane_px_per_inch = 2540;  // 100 pixels per mm of an original that was twice as wide
  f.original_width_px = 800;
  EXPECT_NEAR(focal(f, 400, 300)->focal_px, 250, 1e-6);
  f.model = "Canon PowerShot SX260 HS";
  EXPECT_NEAR(focal(f, 400, 300)->focal_px, 5 / 6.17 * 400, 1e-9);
  f.focal_mm = 5000;
  EXPECT_FALSE(focal(f, 400, 300)) << "no such lens";
}

TEST(SourceFormats, PhotographsByTheirExif) {
  TempFolder t;
  ExifFields f;
  f.make = "Maker";
  f.orientation = 6;
  f.gps = GeodeticPosition{-33.856784, 151.215297, -4.25};
  f.focal_35mm = 28;
  const char* times[] = {"2020:02:29 12:00:00", "2020:02:29 12:00:01", "2020:02:29 12:00:01",
                         "2020:02:29 12:00:02"};
  for (int i = 0; i < 4; ++i) {
    f.time = times[i];
    write_jpeg_with_exif(t / ("a" + std::to_string(i) + ".jpg"), 64, 48, f);
  }
  auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_TRUE(source->info().stills);
  EXPECT_EQ(source->info().intrinsics, IntrinsicsOrigin::exif);
  EXPECT_TRUE(has_note(source->info().notes, "GPS positions in the EXIF of 4 images"));
  const std::vector<PositionFix> fixes = source->positions();
  ASSERT_EQ(fixes.size(), 4u);
  for (const PositionFix& fix : fixes) {
    EXPECT_NEAR(fix.position.latitude_deg, -33.856784, 1e-8);
    EXPECT_NEAR(fix.position.longitude_deg, 151.215297, 1e-8);
    EXPECT_NEAR(fix.position.altitude_m, -4.25, 1e-9);
    EXPECT_TRUE(fix.problem().empty());
  }
  EXPECT_TRUE(has_note(source->info().notes, "orientation 6"));
  auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 4u);
  EXPECT_EQ(frames[0]->grey.width(), 64) << "pixels are not turned";
  EXPECT_EQ(frames[0]->time_ns, 1582977600'000'000'000);
  EXPECT_EQ(frames[2]->time_ns - frames[1]->time_ns, 500'000'000) << "one second is shared";
  for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ(fixes[i].time_ns, frames[i]->time_ns);

  f.time = "2019:01:01 00:00:00";  // the last one goes back: names decide, 1 s apart
  f.fraction = "25";
  write_jpeg_with_exif(t / "a3.jpg", 64, 48, f);
  EXPECT_EQ(read_exif(t / "a3.jpg")->time_ns.value() % 1'000'000'000, 250'000'000);
  source = opened(t.path());
  frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 4u);
  EXPECT_EQ(frames[3]->time_ns, 3'000'000'000);
  EXPECT_TRUE(has_note(source->info().notes, "do not rise"));
}

TEST(SourceFormats, APhotographAtSeaLevelHasAPosition) {
  TempFolder t;
  ExifFields f;
  f.gps = GeodeticPosition{-33.856784, 151.215297, 0};
  write_jpeg_with_exif(t / "a.jpg", 64, 48, f);
  const auto exif = read_exif(t / "a.jpg");
  ASSERT_TRUE(exif && exif->gps);
  EXPECT_EQ(exif->gps->altitude_m, 0);
  EXPECT_NEAR(exif->gps->latitude_deg, -33.856784, 1e-8);
}

TEST(SourceFormats, DepthsAndColoursOfPixels) {
  TempFolder t;
  cv::Mat deep(2, 3, CV_16UC1, cv::Scalar(0x1234));
  deep.at<std::uint16_t>(1, 2) = 0xFFFF;
  deep.at<std::uint16_t>(0, 0) = 0x00FF;
  cv::imwrite(t / "deep.png", deep);
  const auto grey = read_image(t / "deep.png");
  ASSERT_TRUE(grey);
  EXPECT_EQ(grey->grey(1, 0), 0x12) << "the upper byte";
  EXPECT_EQ(grey->grey(2, 1), 0xFF);
  EXPECT_EQ(grey->grey(0, 0), 0);
  EXPECT_TRUE(grey->colour.empty());
  cv::imwrite(t / "red.png", cv::Mat(4, 4, CV_8UC3, cv::Scalar(0, 0, 255)));
  const auto red = read_image(t / "red.png");
  ASSERT_TRUE(red);
  EXPECT_EQ(red->colour(1, 1), (Rgb8{255, 0, 0}));
  EXPECT_EQ(red->grey(1, 1), 76);  // 0.299 * 255
  EXPECT_TRUE(read_image(t / "red.png", false)->colour.empty());
  cv::imwrite(t / "clear.png", cv::Mat(4, 4, CV_8UC4, cv::Scalar(0, 0, 255, 9)));
  EXPECT_EQ(read_image(t / "clear.png")->grey(1, 1), 76);
}

TEST(SourceFormats, VideoFile) {
  TempFolder t;
  const std::string path = t / "flight.avi";
  {
    cv::VideoWriter writer(path, cv::CAP_FFMPEG, cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 25,
                           cv::Size(64, 48), true);
    if (!writer.isOpened()) GTEST_SKIP() << "this OpenCV cannot write MJPG through FFmpeg";
    for (int i = 0; i < 20; ++i) writer << test::picture(64, 48, i, 3);
  }
  auto source = opened(path);
  ASSERT_TRUE(source);
  EXPECT_EQ(source->info().kind, "video file");
  EXPECT_NEAR(source->info().rate_hz, 25, 1e-6);
  EXPECT_EQ(source->info().frames, 20u);
  EXPECT_FALSE(source->info().stills);
  EXPECT_TRUE(has_note(source->info().notes, "container"));
  auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 20u);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(frames[i]->time_ns, static_cast<std::int64_t>(i) * 40'000'000);
  }
  EXPECT_EQ(source->counts().skipped, 0u);
  EXPECT_EQ(frames[0]->colour.width(), 64);

  write_text(t / "flight.txt", "Pinhole 70 71 32 24 0\n64 48\n");
  SourceOptions options;
  options.first = 5;
  options.step = 4;
  options.count = 3;
  options.rate_hz = 10;
  source = opened(path, options);
  ASSERT_TRUE(source);
  EXPECT_EQ(source->info().camera->fx_px, 70);
  EXPECT_EQ(source->info().frames, 3u);
  frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_EQ(frames[1]->time_ns, 900'000'000);
  EXPECT_EQ(frames[1]->id, FrameId(1));

  // Cut in the middle: what is whole is delivered, what is lost is counted.
  test::truncate_file(path, 0.6);
  auto cut = open_source(path);
  if (cut) {
    const std::size_t got = all_frames(**cut).size();
    EXPECT_LT(got, 20u);
    EXPECT_GT(got, 0u);
    EXPECT_EQ(got + (*cut)->counts().skipped, 20u);
    EXPECT_FALSE((*cut)->counts().messages.empty());
    // Of every fourth frame from the fifth on, 5 9 13 17, those beyond the cut are missed.
    options.count = -1;
    auto part = open_source(path, options);
    ASSERT_TRUE(part) << part.error().to_string();
    const std::size_t some = all_frames(**part).size();
    EXPECT_EQ(some + (*part)->counts().skipped, 4u);
    options.count = static_cast<int>(some) + 1;
    auto counted = open_source(path, options);
    ASSERT_TRUE(counted);
    EXPECT_EQ(all_frames(**counted).size(), some);
    EXPECT_EQ((*counted)->counts().skipped, 1u);
  }
}

TEST(SourceText, NumbersAndOrder) {
  EXPECT_EQ(seconds_to_ns("1305031102.175304"), 1305031102'175'304'000);
  EXPECT_EQ(seconds_to_ns("-0.5"), -500'000'000);
  EXPECT_EQ(seconds_to_ns("0.0000000015"), 2);
  EXPECT_EQ(seconds_to_ns("1.5e1"), 15'000'000'000);
  EXPECT_EQ(seconds_to_ns("9200000000"), 9'200'000'000'000'000'000);
  for (const char* bad : {"", "-", ".", "1e30", "nan", "inf", "1.2.3", "1,5", "0x10", "12a"}) {
    EXPECT_FALSE(seconds_to_ns(bad)) << bad;
  }
  EXPECT_EQ(to_number("1e-400"), 0);
  EXPECT_EQ(to_number("-1E-400"), 0);
  EXPECT_FALSE(to_number("1e-400abc"));
  EXPECT_FALSE(to_number("1e-400 2"));
  EXPECT_FALSE(to_number("1e400"));
  EXPECT_TRUE(natural_less("img_2", "img_10"));
  EXPECT_FALSE(natural_less("img_10", "img_2"));
  EXPECT_TRUE(natural_less("a1b2", "a01b3"));
  EXPECT_TRUE(natural_less("a", "a1"));
  EXPECT_FALSE(natural_less("x", "x"));
}

}  // namespace
}  // namespace corvid
