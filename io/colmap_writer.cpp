#include "io/colmap_writer.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <map>
#include <string>

#include "io/atomic_file.h"
#include "io/image_encode.h"
#include "io/undistort.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

constexpr double kPixelShift = 0.5;  ///< COLMAP's (0, 0) is the top-left pixel's corner

struct View {
  const Keyframe* keyframe = nullptr;
  std::uint32_t image_id = 0;
  std::string name;
};

struct Sighting {
  std::size_t view = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  ///< undistorted, ours
  double error_px = 0;
};

std::string image_name(const Keyframe& keyframe, const ColmapOptions& options) {
  return fmt::format("frame_{:06d}.{}", keyframe.frame->id.value, options.png ? "png" : "jpg");
}

std::string encode_image(const Frame& frame, const Undistorter& undistort,
                         const ColmapOptions& options) {
  if (!frame.colour.empty()) {
    const ColourImage image = undistort(frame.colour);
    return options.png ? encode_png(image) : encode_jpeg(image, options.jpeg_quality);
  }
  const GreyImage image = undistort(frame.grey);
  return options.png ? encode_png(image) : encode_jpeg(image, options.jpeg_quality);
}

/// The sightings of every landmark that at least two views can hold, by landmark.
std::map<LandmarkId, std::vector<Sighting>> collect(const MapSnapshot& map,
                                                    const Undistorter& undistort,
                                                    const std::vector<View>& views) {
  std::map<LandmarkId, std::vector<Sighting>> out;
  const Camera& camera = undistort.camera();
  for (std::size_t v = 0; v < views.size(); ++v) {
    const Pose T_camera_world = views[v].keyframe->T_world_camera.inverse();
    for (const Observation& observation : views[v].keyframe->observations) {
      const Landmark* landmark = map.find(observation.landmark);
      const auto pixel = undistort.pixel(observation.pixel);
      if (!landmark || !pixel || !camera.in_image(*pixel)) continue;
      const auto expected = camera.project(T_camera_world * landmark->p_world);
      if (!expected) continue;  // behind the camera
      auto& sightings = out[observation.landmark];
      if (!sightings.empty() && sightings.back().view == v) continue;
      sightings.push_back({v, *pixel, (*pixel - *expected).norm()});
    }
  }
  std::erase_if(out, [](const auto& entry) { return entry.second.size() < 2; });
  return out;
}

Expected<ColmapModel> write_model(const MapSnapshot& map, const Undistorter& undistort,
                                  const std::vector<View>& views, const fs::path& dir) {
  const auto sightings = collect(map, undistort, views);
  ColmapModel model;
  model.images = views.size();
  model.points = sightings.size();
  model.sparse_dir = dir;

  const Camera& camera = undistort.camera();
  const std::string cameras = fmt::format(
      "# Camera list with one line of data per camera:\n"
      "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 PINHOLE {} {} {} {} {} {}\n",
      camera.width_px, camera.height_px, camera.fx_px, camera.fy_px, camera.cx_px + kPixelShift,
      camera.cy_px + kPixelShift);

  std::string points =
      "# 3D point list with one line of data per point:\n"
      "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n";
  std::vector<std::string> pixels(views.size());
  std::vector<std::size_t> pixel_count(views.size());
  double error_sum = 0;
  for (const auto& [id, seen] : sightings) {
    const Landmark& landmark = *map.find(id);
    const std::uint64_t point_id = std::uint64_t{id.value} + 1;
    double error = 0;
    std::string track;
    for (const Sighting& s : seen) {
      error += s.error_px;
      fmt::format_to(std::back_inserter(track), " {} {}", views[s.view].image_id,
                     pixel_count[s.view]++);
      fmt::format_to(std::back_inserter(pixels[s.view]), "{}{} {} {}",
                     pixels[s.view].empty() ? "" : " ", s.pixel.x() + kPixelShift,
                     s.pixel.y() + kPixelShift, point_id);
    }
    error_sum += error;
    model.observations += seen.size();
    const Eigen::Vector3d& p = landmark.p_world;
    fmt::format_to(std::back_inserter(points), "{} {} {} {} {} {} {} {}{}\n", point_id, p.x(),
                   p.y(), p.z(), landmark.colour.r, landmark.colour.g, landmark.colour.b,
                   error / static_cast<double>(seen.size()), track);
  }
  if (model.observations > 0) {
    model.mean_error_px = error_sum / static_cast<double>(model.observations);
  }

  std::string images =
      "# Image list with two lines of data per image:\n"
      "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
      "#   POINTS2D[] as (X, Y, POINT3D_ID)\n";
  for (std::size_t v = 0; v < views.size(); ++v) {
    const Pose T_camera_world = views[v].keyframe->T_world_camera.inverse();
    const Eigen::Quaterniond& q = T_camera_world.rotation();
    const Eigen::Vector3d& t = T_camera_world.translation();
    fmt::format_to(std::back_inserter(images), "{} {} {} {} {} {} {} {} 1 {}\n{}\n",
                   views[v].image_id, q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z(),
                   views[v].name, pixels[v]);
  }
  for (const auto& [name, text] :
       {std::pair<const char*, const std::string*>{"cameras.txt", &cameras},
        {"images.txt", &images},
        {"points3D.txt", &points}}) {
    if (auto ok = write_file_atomically(dir / name, *text); !ok) {
      return tl::unexpected(ok.error());
    }
  }
  return model;
}

}  // namespace

Expected<std::vector<ColmapModel>> write_colmap(const MapSnapshot& map, const fs::path& dir,
                                                const ColmapOptions& options) {
  if (!map.camera) return fail(ErrorCode::invalid_argument, "the map has no camera", dir.string());
  std::map<int, std::vector<View>> segments;
  for (const auto& keyframe : map.keyframes) {
    if (!keyframe->frame || keyframe->frame->width_px != map.camera->width_px ||
        keyframe->frame->height_px != map.camera->height_px) {
      continue;
    }
    segments[keyframe->segment].push_back(
        {keyframe.get(), keyframe->id.value + 1, image_name(*keyframe, options)});
  }
  if (segments.empty()) {
    return fail(ErrorCode::invalid_argument, "the map has no keyframe with an image", dir.string());
  }
  const Undistorter undistort(*map.camera);
  for (const auto& [segment, views] : segments) {
    for (const View& view : views) {
      const FramePtr frame = view.keyframe->frame->load();
      if (frame->grey.empty()) {
        return fail(ErrorCode::io, "the picture could not be read back", view.name,
                    "see the warning before; free space on the disk of the output folder");
      }
      auto ok = write_file_atomically(dir / "images" / view.name,
                                      encode_image(*frame, undistort, options));
      if (!ok) return tl::unexpected(ok.error());
    }
  }
  std::vector<int> order;
  for (const auto& [segment, views] : segments) order.push_back(segment);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return segments[a].size() > segments[b].size(); });
  std::vector<ColmapModel> models;
  for (const int segment : order) {
    const std::string name =
        models.empty() ? std::string("sparse") : fmt::format("sparse_segment_{}", segment);
    auto model = write_model(map, undistort, segments[segment], dir / name);
    if (!model) return tl::unexpected(model.error());
    model->segment = segment;
    models.push_back(*model);
  }
  return models;
}

}  // namespace corvid
