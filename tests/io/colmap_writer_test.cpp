#include "io/colmap_writer.h"

#include <gtest/gtest.h>

#include <array>
#include <fstream>
#include <map>
#include <random>
#include <sstream>

#include "io/atomic_file.h"
#include "io/image_file.h"
#include "io/undistort.h"
#include "scenes/temporary_folder.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;

Camera distorted_camera() {
  Camera camera;
  camera.model = CameraModel::radtan;
  camera.width_px = 320;
  camera.height_px = 240;
  camera.fx_px = 210;
  camera.fy_px = 215;
  camera.cx_px = 158;
  camera.cy_px = 121;
  camera.distortion = {-0.2, 0.05, 0.001, -0.0005, 0};
  return camera;
}

/// Cameras on a line that look at a cloud of points; observations without noise.
MapSnapshot small_map(int keyframes, int segments = 1, bool colour = true) {
  MapSnapshot map;
  auto camera = std::make_shared<Camera>(distorted_camera());
  map.camera = camera;
  std::mt19937 random(7);
  std::uniform_real_distribution<double> unit(-1, 1);
  std::vector<Landmark> landmarks;
  for (std::uint32_t i = 0; i < 150; ++i) {
    Landmark l;
    l.id = LandmarkId(3 * i + 1);
    l.p_world = {3 * unit(random), 2 * unit(random), 6 + 2 * unit(random)};
    l.colour = {static_cast<std::uint8_t>(i), 7, 200};
    landmarks.push_back(l);
  }
  map.landmarks = Landmarks(std::move(landmarks));
  for (int k = 0; k < keyframes; ++k) {
    auto keyframe = std::make_shared<Keyframe>();
    keyframe->id = KeyframeId(static_cast<std::uint32_t>(k));
    keyframe->segment = k * segments / keyframes;
    Vector6d tangent;
    tangent << 0.3 * k, -0.1 * k, 0.05 * k, 0.01 * k, 0.03 * k, -0.02 * k;
    keyframe->T_world_camera = Pose::exp(tangent);
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(5 * k));
    frame->grey = GreyImage(320, 240, 90);
    if (colour) frame->colour = ColourImage(320, 240, Rgb8{200, 90, 30});
    frame->camera = camera;
    frame->name = "a name with blanks.png";
    keyframe->frame = std::make_shared<const StoredFrame>(frame);
    for (const Landmark& l : map.landmarks) {
      const auto pixel = camera->project(keyframe->T_world_camera.inverse() * l.p_world);
      if (pixel && camera->in_image(*pixel)) keyframe->observations.push_back({l.id, *pixel});
    }
    map.keyframes.push_back(keyframe);
  }
  return map;
}

std::vector<std::string> data_lines(const fs::path& path) {
  std::ifstream file(path);
  std::vector<std::string> out;
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("#")) out.push_back(line);
  }
  return out;
}

struct ReadImage {
  Pose T_camera_world;
  std::string name;
  std::vector<std::array<double, 3>> points;  ///< x, y, point id
};

std::map<int, ReadImage> read_images(const fs::path& path) {
  const auto lines = data_lines(path);
  std::map<int, ReadImage> out;
  for (std::size_t i = 0; i + 1 < lines.size(); i += 2) {
    std::istringstream head(lines[i]);
    int id = 0, camera = 0;
    double q[4], t[3];
    ReadImage image;
    head >> id >> q[0] >> q[1] >> q[2] >> q[3] >> t[0] >> t[1] >> t[2] >> camera >> image.name;
    EXPECT_EQ(camera, 1);
    image.T_camera_world =
        Pose(Eigen::Quaterniond(q[0], q[1], q[2], q[3]), Eigen::Vector3d(t[0], t[1], t[2]));
    std::istringstream tail(lines[i + 1]);
    for (std::array<double, 3> p; tail >> p[0] >> p[1] >> p[2];) image.points.push_back(p);
    out[id] = image;
  }
  return out;
}

TEST(ColmapWriter, ModelIsConsistentAndReprojects) {
  const TemporaryFolder folder;
  const MapSnapshot map = small_map(5);
  const auto models = write_colmap(map, folder.path());
  ASSERT_TRUE(models) << models.error().to_string();
  ASSERT_EQ(models->size(), 1u);
  EXPECT_EQ(models->front().images, 5u);
  EXPECT_GT(models->front().points, 100u);
  EXPECT_LT(models->front().mean_error_px, 1e-6);

  const auto cameras = data_lines(folder / "sparse" / "cameras.txt");
  ASSERT_EQ(cameras.size(), 1u);
  std::istringstream line(cameras[0]);
  int id = 0, width = 0, height = 0;
  std::string model;
  double fx = 0, fy = 0, cx = 0, cy = 0;
  line >> id >> model >> width >> height >> fx >> fy >> cx >> cy;
  EXPECT_EQ(model, "PINHOLE");
  const Camera pinhole = map.camera->undistorted();
  EXPECT_EQ(width, pinhole.width_px);
  EXPECT_NEAR(cx, pinhole.cx_px + 0.5, 1e-9);

  const auto images = read_images(folder / "sparse" / "images.txt");
  ASSERT_EQ(images.size(), 5u);
  std::size_t in_images = 0, in_points = 0;
  for (const auto& [image_id, image] : images) in_images += image.points.size();
  // Every track entry leads to an observation of the same point, which the pose projects there.
  for (const std::string& text : data_lines(folder / "sparse" / "points3D.txt")) {
    std::istringstream point(text);
    double point_id = 0, x = 0, y = 0, z = 0, r = 0, g = 0, b = 0, error = 0;
    point >> point_id >> x >> y >> z >> r >> g >> b >> error;
    EXPECT_LT(error, 1e-6);
    EXPECT_EQ(g, 7);
    const Landmark* landmark = map.find(LandmarkId(static_cast<std::uint32_t>(point_id - 1)));
    ASSERT_TRUE(landmark);
    EXPECT_EQ(r, landmark->colour.r);
    int image_id = 0;
    std::size_t index = 0, length = 0;
    for (; point >> image_id >> index; ++length) {
      const ReadImage& image = images.at(image_id);
      ASSERT_LT(index, image.points.size());
      EXPECT_EQ(image.points[index][2], point_id);
      const Eigen::Vector3d p = image.T_camera_world * Eigen::Vector3d(x, y, z);
      EXPECT_NEAR(fx * p.x() / p.z() + cx, image.points[index][0], 1e-6);
      EXPECT_NEAR(fy * p.y() / p.z() + cy, image.points[index][1], 1e-6);
    }
    EXPECT_GE(length, 2u);
    in_points += length;
  }
  EXPECT_EQ(in_points, in_images);
  EXPECT_EQ(in_points, models->front().observations);
}

TEST(ColmapWriter, ImagesAreUndistortedAndInColour) {
  const TemporaryFolder folder;
  const MapSnapshot map = small_map(3);
  ASSERT_TRUE(write_colmap(map, folder.path(), {.jpeg_quality = 95, .png = true}));
  const auto images = read_images(folder / "sparse" / "images.txt");
  ASSERT_EQ(images.size(), 3u);
  for (const auto& [id, image] : images) {
    const auto picture = read_image((folder / "images" / image.name).string());
    ASSERT_TRUE(picture) << picture.error().to_string();
    EXPECT_EQ(picture->grey.width(), 320);
    ASSERT_FALSE(picture->colour.empty());
    EXPECT_EQ(picture->colour(160, 120), (Rgb8{200, 90, 30}));
  }
  ASSERT_TRUE(write_colmap(small_map(3, 1, false), folder.path()));
  const auto grey = read_image((folder / "images" / "frame_000005.jpg").string());
  ASSERT_TRUE(grey) << grey.error().to_string();
  EXPECT_NEAR(grey->grey(160, 120), 90, 1);
}

TEST(ColmapWriter, SegmentsGoToFoldersOfTheirOwn) {
  const TemporaryFolder folder;
  MapSnapshot map = small_map(7, 2);  // 4 and 3 keyframes
  const auto models = write_colmap(map, folder.path());
  ASSERT_TRUE(models);
  ASSERT_EQ(models->size(), 2u);
  EXPECT_EQ((*models)[0].images, 4u);
  EXPECT_EQ((*models)[1].images, 3u);
  EXPECT_EQ(read_images(folder / "sparse_segment_1" / "images.txt").size(), 3u);
  EXPECT_EQ(read_images(folder / "sparse" / "images.txt").size(), 4u);
}

TEST(ColmapWriter, ObservationsThatCannotBeKeptAreLeftOut) {
  const TemporaryFolder folder;
  MapSnapshot map = small_map(2);
  auto keyframe = std::make_shared<Keyframe>(*map.keyframes[0]);
  const std::size_t before = keyframe->observations.size();
  keyframe->observations.push_back({LandmarkId(900000), {10, 10}});  // not in the map
  map.keyframes[0] = keyframe;
  std::vector<Landmark> landmarks(map.landmarks.begin(), map.landmarks.end());
  landmarks[10].p_world.z() = -5;  // behind both cameras
  map.landmarks = Landmarks(landmarks);
  const auto models = write_colmap(map, folder.path());
  ASSERT_TRUE(models);
  EXPECT_LE(models->front().observations / 2, before);
  for (const std::string& line : data_lines(folder / "sparse" / "points3D.txt")) {
    EXPECT_FALSE(line.starts_with("900001 "));
    EXPECT_FALSE(line.starts_with(std::to_string(landmarks[10].id.value + 1) + " "));
  }
}

TEST(ColmapWriter, EmptyMapIsAnError) {
  const TemporaryFolder folder;
  EXPECT_EQ(write_colmap(MapSnapshot{}, folder.path()).error().code, ErrorCode::invalid_argument);
  MapSnapshot map = small_map(2);
  map.keyframes.clear();
  EXPECT_FALSE(write_colmap(map, folder.path()));
}

TEST(ColmapWriter, ColmapReadsTheModel) {
  if (!has_program("colmap")) GTEST_SKIP() << "colmap is absent (package colmap)";
  const TemporaryFolder folder;
  const auto models = write_colmap(small_map(6), folder.path());
  ASSERT_TRUE(models);
  ASSERT_TRUE(fs::create_directory(folder / "binary"));
  ASSERT_TRUE(fs::create_directory(folder / "text"));
  const auto convert = [&](const char* from, const char* to, const char* type) {
    return run_command("QT_QPA_PLATFORM=offscreen colmap model_converter --input_path '" +
                       (folder / from).string() + "' --output_path '" + (folder / to).string() +
                       "' --output_type " + type);
  };
  ASSERT_EQ(convert("sparse", "binary", "BIN"), 0);
  ASSERT_EQ(convert("binary", "text", "TXT"), 0);
  const auto ours = read_images(folder / "sparse" / "images.txt");
  const auto theirs = read_images(folder / "text" / "images.txt");
  ASSERT_EQ(theirs.size(), ours.size());
  for (const auto& [id, image] : ours) {
    EXPECT_EQ(theirs.at(id).points.size(), image.points.size());
    EXPECT_EQ(theirs.at(id).name, image.name);
    EXPECT_LT(
        (theirs.at(id).T_camera_world.translation() - image.T_camera_world.translation()).norm(),
        1e-9);
  }
  EXPECT_EQ(data_lines(folder / "text" / "points3D.txt").size(), models->front().points);
}

TEST(Undistort, StraightLinesBecomeStraight) {
  // A vertical bar in the world, drawn through the distorted camera, lies in one column afterwards.
  const Camera camera = distorted_camera();
  const Undistorter undistort(camera);
  GreyImage image(camera.width_px, camera.height_px);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      const auto ray = camera.unproject({x, y});
      if (ray) image(x, y) = ray->x() / ray->z() > 0.35 ? 255 : 0;
    }
  }
  const GreyImage straight = undistort(image);
  const auto column = undistort.camera().project({0.35, 0, 1});
  ASSERT_TRUE(column);
  double bent = 0;
  for (int y = 5; y < image.height() - 5; y += 10) {
    const auto edge = [&](const GreyImage& picture) {
      int x = 0;
      while (x < picture.width() && picture(x, y) < 128) ++x;
      return x - 0.5;
    };
    EXPECT_NEAR(edge(straight), column->x(), 1.0) << y;
    bent = std::max(bent, std::abs(edge(image) - edge(straight)));
  }
  EXPECT_GT(bent, 2);  // the camera bends the bar, so the test can fail
}

TEST(Undistort, PixelsFollowTheImage) {
  const Camera camera = distorted_camera();
  const Undistorter undistort(camera);
  const Eigen::Vector3d p(0.4, -0.3, 1);
  const auto from = camera.project(p), to = undistort.camera().project(p);
  ASSERT_TRUE(from && to);
  const auto moved = undistort.pixel(*from);
  ASSERT_TRUE(moved);
  EXPECT_LT((*moved - *to).norm(), 1e-6);

  Camera pinhole = camera;
  pinhole.model = CameraModel::pinhole;
  pinhole.distortion = {};
  const Undistorter identity(pinhole);
  GreyImage image(camera.width_px, camera.height_px, 17);
  image(30, 40) = 99;
  EXPECT_EQ(identity(image), image);
}

}  // namespace
}  // namespace corvid
