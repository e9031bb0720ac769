#include "apps/mapping_scenes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <vector>

#include "apps/program_source.h"
#include "core/associate.h"
#include "core/log.h"
#include "io/depth_file.h"
#include "io/readers/readers.h"
#include "replay/synthetic_flight.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;

/// 7-Scenes: the depth camera looks along the colour camera, nearly from its place; f = 585 px.
Expected<FloatImage> kinect_depth(const fs::path& folder, const Frame& frame) {
  constexpr double kDepthFocal_px = 585;
  const std::string stem = frame.name.substr(0, frame.name.find('.'));
  const auto depth = read_depth_image((folder / (stem + ".depth.png")).string());
  if (!depth) return tl::unexpected(depth.error());
  const Camera& camera = *frame.camera;
  const double scale_x = kDepthFocal_px / camera.fx_px, scale_y = kDepthFocal_px / camera.fy_px;
  FloatImage seen(camera.width_px, camera.height_px);
  for (int y = 0; y < seen.height(); ++y) {
    for (int x = 0; x < seen.width(); ++x) {
      const double u = (x - camera.cx_px) * scale_x + 0.5 * (depth->width() - 1);
      const double v = (y - camera.cy_px) * scale_y + 0.5 * (depth->height() - 1);
      if (depth->contains(u, v))
        seen(x, y) = (*depth)(static_cast<int>(u + 0.5), static_cast<int>(v + 0.5));
    }
  }
  return seen;
}

}  // namespace

Expected<MappingScene> read_mapping_scene(FrameSource& source, int step, int count,
                                          const std::stop_token& stop) {
  MappingScene scene;
  scene.name = source.info().path;
  auto* flight = dynamic_cast<SyntheticFlight*>(&source);
  const bool kinect = source.info().kind == "7-Scenes" && source.info().has_depth;
  const fs::path depth_folder = kinect ? seven_scenes_frames(scene.name) : fs::path();
  std::vector<FramePtr> frames;
  std::vector<std::int64_t> times_ns;
  for (int i = 0; static_cast<int>(frames.size()) < count; ++i) {
    // Rendering is slow: only what is wanted.
    if (flight &&
        static_cast<std::size_t>(i) * static_cast<std::size_t>(step) >= flight->frame_count())
      break;
    auto frame = flight ? Expected<FramePtr>(flight->render(static_cast<std::size_t>(i * step)))
                        : source.next(stop);
    if (!frame) return tl::unexpected(frame.error());
    if (!*frame) break;
    if (!flight && i % step != 0) continue;
    times_ns.push_back((*frame)->time_ns);
    frames.push_back(std::move(*frame));
    if (stop.stop_requested())
      return fail(ErrorCode::interrupted, "stopped while reading", scene.name);
  }
  log_skipped(source.counts());
  const auto poses = true_poses(times_ns, source.truth());
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (i >= poses.size() || !poses[i]) continue;
    if (!scene.views.empty() && !(*frames[i]->camera == *scene.views.front().frame->camera))
      continue;
    TrueView view{frames[i], *poses[i],
                  FloatImage(frames[i]->grey.width(), frames[i]->grey.height())};
    if (flight) {
      view.depth = flight->render_depth(i * static_cast<std::size_t>(step));
    } else if (kinect) {
      if (auto depth = kinect_depth(depth_folder, *frames[i])) {
        view.depth = std::move(*depth);
      } else {
        log().warn("without true depth: {}", depth.error().to_string());
      }
    }
    scene.views.push_back(std::move(view));
  }
  constexpr std::size_t kFewest = 5;
  if (scene.views.size() < kFewest) {
    return fail(ErrorCode::unsupported,
                fmt::format("{} views of one camera have a true pose", scene.views.size()),
                scene.name, "depth needs 5 of them");
  }
  return scene;
}

bool has_true_depth(const MappingScene& scene) {
  return std::any_of(scene.views.begin(), scene.views.end(), [](const TrueView& view) {
    return std::any_of(view.depth.data(), view.depth.data() + view.depth.size(),
                       [](float z) { return z > 0; });
  });
}

std::optional<Eigen::AlignedBox3d> middlebury_box(const std::string& folder) {
  std::ifstream file(fs::path(folder) / "README.txt");
  bool announced = false;
  std::vector<Eigen::Vector3d> corners;
  for (std::string line; std::getline(file, line) && corners.size() < 2;) {
    Eigen::Vector3d p;
    announced = announced || line.find("bounding box") != std::string::npos;
    if (announced && std::sscanf(line.c_str(), " (%lf %lf %lf)", &p.x(), &p.y(), &p.z()) == 3)
      corners.push_back(p);
  }
  if (corners.size() < 2) return std::nullopt;
  Eigen::AlignedBox3d box(corners[0]);
  box.extend(corners[1]);
  return box;
}

}  // namespace corvid
