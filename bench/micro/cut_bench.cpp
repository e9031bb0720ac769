// The snapshot of a folder of calibrated stills with true poses, stage by stage: depth maps of all
// views against their 4 nearest ones, then the cut at each voxel size. For work on the cut: it
// builds without the engine.
//   cut_bench FOLDER DEVICE DEPTH_SCALE LOW_X LOW_Y LOW_Z HIGH_X HIGH_Y HIGH_Z VOXEL...
//             [--out FILE.ply]
#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <iostream>
#include <string>
#include <vector>

#include "core/stopwatch.h"
#include "io/mesh_files.h"
#include "io/source.h"
#include "kernels/depth.h"
#include "kernels/device.h"
#include "kernels/pyramid.h"
#include "mapping/depth_clean.h"
#include "mapping/surface_cut.h"

namespace corvid {
namespace {

struct Still {
  FramePtr frame;
  Pose T_world_camera;
};

Expected<std::vector<Still>> read_stills(const std::string& folder) {
  auto source = open_source(folder);
  if (!source) return tl::unexpected(source.error());
  const Trajectory truth = (*source)->truth();
  std::vector<Still> out;
  while (true) {
    auto frame = (*source)->next();
    if (!frame) return tl::unexpected(frame.error());
    if (!*frame) return out;
    for (const auto& pose : truth) {
      if (pose.time_ns == (*frame)->time_ns) out.push_back({*frame, pose.T_world_camera});
    }
  }
}

/// The views whose cameras stand nearest to one's.
std::vector<std::size_t> nearest_views(const std::vector<Still>& stills, std::size_t reference) {
  constexpr std::size_t kNeighbours = 4;
  std::vector<std::pair<double, std::size_t>> by_distance;
  for (std::size_t i = 0; i < stills.size(); ++i) {
    if (i == reference) continue;
    by_distance.emplace_back(
        (stills[i].T_world_camera.translation() - stills[reference].T_world_camera.translation())
            .norm(),
        i);
  }
  std::sort(by_distance.begin(), by_distance.end());
  std::vector<std::size_t> out;
  for (std::size_t i = 0; i < std::min(kNeighbours, by_distance.size()); ++i) {
    out.push_back(by_distance[i].second);
  }
  return out;
}

std::vector<DepthMap> estimate(const std::vector<Still>& stills, const Eigen::AlignedBox3d& box,
                               const std::shared_ptr<Device>& device, DepthSweeper& sweeper,
                               int scale) {
  constexpr int kSamples = 128;
  std::vector<SweepImage> images;
  for (const Still& still : stills) {
    images.push_back(
        sweeper.prepare(upload(*device, still.frame->grey, Lane::mapping), scale, Lane::mapping));
  }
  std::vector<DepthMap> maps;
  for (std::size_t i = 0; i < stills.size(); ++i) {
    DepthMap map;
    map.keyframe = KeyframeId(static_cast<std::uint32_t>(i));
    map.camera = DepthSweeper::scaled(*stills[i].frame->camera, scale);
    map.T_world_camera = stills[i].T_world_camera;
    std::vector<SweepNeighbour> neighbours;
    for (const std::size_t j : nearest_views(stills, i)) {
      neighbours.push_back({&images[j], DepthSweeper::scaled(*stills[j].frame->camera, scale),
                            stills[j].T_world_camera.inverse() * map.T_world_camera});
    }
    SweepRequest request{&images[i], map.camera, neighbours, 0, 0, kSamples};
    request.near = 1e9;
    for (int c = 0; c < 8; ++c) {
      const double z = (map.T_world_camera.inverse() *
                        box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(c)))
                           .z();
      request.near = std::min(request.near, z);
      request.far = std::max(request.far, z);
    }
    SweepResult result = sweeper.estimate(request);
    map.depth = std::move(result.depth);
    map.confidence = std::move(result.confidence);
    weaken_ambiguous(map, result.lead);
    maps.push_back(std::move(map));
  }
  for (std::size_t i = 0; i < maps.size(); ++i) {
    std::vector<DepthWitness> witnesses;
    for (const std::size_t j : nearest_views(stills, i)) {
      witnesses.push_back({&maps[j], maps[j].T_world_camera.inverse() * maps[i].T_world_camera});
    }
    remove_contradicted(maps[i], witnesses, 0.005);
    remove_speckles(maps[i], static_cast<int>(maps[i].depth.size() / 2000));
  }
  return maps;
}

ColourImage reduced(const ColourImage& image, int scale) {
  ColourImage out(image.width() / scale, image.height() / scale);
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      int r = 0, g = 0, b = 0;
      for (int i = 0; i < scale * scale; ++i) {
        const Rgb8& c = image(scale * x + i % scale, scale * y + i / scale);
        r += c.r, g += c.g, b += c.b;
      }
      const int n = scale * scale;
      out(x, y) = {static_cast<std::uint8_t>(r / n), static_cast<std::uint8_t>(g / n),
                   static_cast<std::uint8_t>(b / n)};
    }
  }
  return out;
}

/// Edges that do not have exactly two faces which run along them in opposite directions.
std::size_t broken_edges(const TriangleMesh& mesh) {
  std::vector<std::array<std::uint32_t, 2>> edges;
  for (const auto& f : mesh.triangles) {
    for (std::size_t i = 0; i < 3; ++i) edges.push_back({f[i], f[(i + 1) % 3]});
  }
  std::sort(edges.begin(), edges.end());
  std::size_t broken = 0;
  for (std::size_t i = 0; i < edges.size(); ++i) {
    const bool twice = i > 0 && edges[i] == edges[i - 1];
    const std::array<std::uint32_t, 2> back{edges[i][1], edges[i][0]};
    broken += twice || !std::binary_search(edges.begin(), edges.end(), back);
  }
  return broken;
}

/// Of all threads of this process [s].
double processor_s() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

int run(std::vector<std::string> arguments) {
  std::string out;
  if (arguments.size() > 2 && arguments[arguments.size() - 2] == "--out") {
    out = arguments.back();
    arguments.resize(arguments.size() - 2);
  }
  if (arguments.size() < 10) {
    std::cerr << "cut_bench FOLDER DEVICE DEPTH_SCALE LOW(3) HIGH(3) VOXEL... [--out FILE.ply]\n";
    return 2;
  }
  const auto failed = [](const Error& error) {
    std::cerr << "error: " << error.to_string() << "\n";
    return 1;
  };
  const int scale = std::atoi(arguments[2].c_str());
  const auto number = [&](std::size_t i) { return std::atof(arguments[i].c_str()); };
  const Eigen::AlignedBox3d box(Eigen::Vector3d(number(3), number(4), number(5)),
                                Eigen::Vector3d(number(6), number(7), number(8)));
  const auto stills = read_stills(arguments[0]);
  if (!stills) return failed(stills.error());
  const auto device = Device::open(arguments[1]);
  if (!device) return failed(device.error());
  auto sweeper = DepthSweeper::create(*device, {});
  if (!sweeper) return failed(sweeper.error());
  Stopwatch watch;
  const std::vector<DepthMap> maps = estimate(*stills, box, *device, *sweeper, scale);
  std::cout << fmt::format("{} depth maps in {:.1f} s\n", maps.size(), 1e-3 * watch.lap_ms());
  std::vector<ColourImage> colours;
  std::vector<SurfaceCutView> views;
  for (const Still& still : *stills) colours.push_back(reduced(still.frame->colour, scale));
  for (std::size_t i = 0; i < maps.size(); ++i) views.push_back({&maps[i], &colours[i]});
  for (std::size_t i = 9; i < arguments.size(); ++i) {
    SurfaceCutOptions options;
    options.box = box;
    options.voxel_size = number(i);
    const double before_s = processor_s();
    const auto cut = cut_surface(views, options);
    if (!cut) return failed(cut.error());
    const SurfaceCutStatistics& s = cut->statistics;
    std::cout << fmt::format(
        "{:.2f} M voxels, {:.2f} M of crust, {:.2f} M points: graph {:.2f} s, flow {:.2f} s, mesh "
        "{:.2f} s ({:.2f} s of processor time in all), {:.0f} MB; flow {}, {} triangles, {} broken "
        "edges\n",
        1e-6 * static_cast<double>(s.voxels), 1e-6 * static_cast<double>(s.crust_voxels),
        1e-6 * static_cast<double>(s.points), s.graph_s, s.maxflow_s, s.mesh_s,
        processor_s() - before_s, 1e-6 * static_cast<double>(s.peak_bytes), s.flow,
        cut->mesh.triangles.size(), broken_edges(cut->mesh));
    if (!out.empty()) {
      if (auto written = write_mesh(cut->mesh, out); !written) return failed(written.error());
    }
  }
  return 0;
}

}  // namespace
}  // namespace corvid

int main(int argc, char** argv) { return corvid::run({argv + 1, argv + argc}); }
