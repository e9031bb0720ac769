#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "apps/command_list.h"
#include "apps/mapping_scenes.h"
#include "apps/mvs_report.h"
#include "apps/opencl_trouble.h"
#include "apps/program_source.h"
#include "apps/report_pictures.h"
#include "apps/signal_guard.h"
#include "core/associate.h"
#include "core/log.h"
#include "core/stopwatch.h"
#include "io/atomic_file.h"
#include "io/image_encode.h"
#include "io/mesh_files.h"
#include "mapping/still_cut.h"
#include "mapping/still_depth.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
constexpr const char* kMarker = "mvs.json";
constexpr int kWidestRays = 1100;  ///< of a map, unless --scale says otherwise

struct Arguments {
  SourceArguments source;
  std::string out, device = "auto";
  int neighbours = 4;
  std::optional<int> scale;
  std::optional<double> near, far;
  bool no_surface = false, open = false;
  double voxel_size = 0;
  int max_mb = 2000;
};

/// The frames that have a true pose, of the first one's camera.
Expected<std::vector<StillView>> read_views(FrameSource& source, const std::stop_token& stop) {
  const auto no_pose = [&] {
    return fail(ErrorCode::unsupported, "no image has a pose", source.info().path,
                "depth of stills needs calibrated views: Middlebury, Strecha, or a COLMAP model; "
                "`corvid replay` finds the poses of others");
  };
  if (source.truth().empty()) return no_pose();  // before everything is decoded
  std::vector<FramePtr> frames;
  std::vector<std::int64_t> times_ns;
  while (true) {
    auto frame = source.next(stop);
    if (!frame) return tl::unexpected(frame.error());
    if (stop.stop_requested()) return fail(ErrorCode::interrupted, "stopped", source.info().path);
    if (!*frame) break;
    times_ns.push_back((*frame)->time_ns);
    frames.push_back(std::move(*frame));
  }
  log_skipped(source.counts());
  const auto poses = true_poses(times_ns, source.truth());
  std::vector<StillView> views;
  for (std::size_t i = 0; i < std::min(frames.size(), poses.size()); ++i) {
    if (poses[i]) views.push_back({frames[i], *poses[i]});
  }
  if (views.empty()) return no_pose();
  if (views.size() < frames.size())
    log().warn("{} of {} images have no pose and are left out", frames.size() - views.size(),
               frames.size());
  return views;
}

Expected<StillDepthOptions> depth_options(const Arguments& arguments, const Camera& camera) {
  StillDepthOptions options;
  options.neighbours = arguments.neighbours;
  options.scale =
      arguments.scale.value_or(std::max(1, (camera.width_px + kWidestRays - 1) / kWidestRays));
  if (arguments.near.has_value() != arguments.far.has_value()) {
    return fail(ErrorCode::invalid_argument, "one of the two is missing", "--near, --far",
                "give both, in the unit of the poses");
  }
  if (arguments.near) {
    if (!(*arguments.near > 0 && *arguments.near < *arguments.far)) {
      return fail(ErrorCode::invalid_argument, "must be 0 < near < far", "--near, --far");
    }
    options.interval = DepthInterval{*arguments.near, *arguments.far};
  }
  return options;
}

/// The minimal surface through the depth maps, or why there is none.
Expected<SurfaceCut> surface_of(const Arguments& arguments, const FrameSource& source,
                                const std::vector<StillView>& views,
                                const std::vector<StillDepth>& depths,
                                const std::stop_token& stop) {
  SurfaceCutOptions options;
  options.box = middlebury_box(source.info().path);
  options.voxel_size = arguments.voxel_size;
  options.closed = !arguments.open;
  options.coarsen = true;
  options.max_bytes = static_cast<std::size_t>(arguments.max_mb) * 1000000;
  auto cut = cut_stills(views, depths, options, {stop, [](std::string_view stage) {
                                                   log().info("cutting the surface: {}", stage);
                                                 }});
  if (cut && options.voxel_size > 0 && cut->voxel_size > 1.001 * options.voxel_size) {
    log().warn("the surface has voxels of {:.4g} instead of {:.4g}: --max-mb is {}",
               cut->voxel_size, options.voxel_size, arguments.max_mb);
  }
  if (cut && cut->mesh.empty()) {
    return fail(ErrorCode::not_found, "no voxel is inside", "surface cut",
                arguments.open ? "without --open it is closed" : "");
  }
  return cut;
}

Expected<void> write_folder(const MvsRun& run, const TriangleMesh& points, AtomicFolder& folder) {
  const auto put = [&](const fs::path& name, const std::string& bytes) {
    return write_file_atomically(folder.path() / name, bytes);
  };
  for (const StillDepth& d : run.depths) {
    if (!d.refusal.empty()) continue;
    const std::string stem = fmt::format("view_{:04d}", d.map.keyframe.value);
    const DepthPicture depth = picture_of_depth(d.map.depth);
    const MeshPicture confidence = picture_of_confidence(d.map.confidence);
    for (const auto& [name, bytes] :
         {std::pair(stem + ".pfm", encode_pfm(d.map.depth)),
          std::pair(stem + "_depth.png", encode_png(depth.picture.colour, depth.picture.alpha)),
          std::pair(stem + "_confidence.png", encode_png(confidence.colour, confidence.alpha))}) {
      if (auto written = put(fs::path("depth") / name, bytes); !written) return written;
    }
  }
  if (!points.vertices.empty()) {
    if (auto written = write_mesh(points, folder.path() / "points.ply"); !written) return written;
  }
  if (run.surface) {
    auto written = write_mesh(run.surface->mesh, folder.path() / "surface.ply");
    if (!written) return written;
  }
  if (auto written = put("report.html", mvs_html(run)); !written) return written;
  return put(kMarker, mvs_json(run));
}

Expected<ExitCode> run_mvs(const Arguments& arguments, Context& context) {
  const SignalGuard signals;
  auto folder = AtomicFolder::create(arguments.out, kMarker);  // before minutes of work
  if (!folder) return tl::unexpected(folder.error());
  auto source = arguments.source.open();
  if (!source) return tl::unexpected(source.error());
  log().info("{}", describe((*source)->info()));
  const auto views = read_views(**source, signals.token());
  if (!views) return tl::unexpected(views.error());
  const auto options = depth_options(arguments, *views->front().frame->camera);
  if (!options) return tl::unexpected(options.error());
  auto device = open_explained([&] { return Device::open(arguments.device); });
  if (!device) return tl::unexpected(device.error());
  Stopwatch watch;
  const auto depths = depth_of_stills(*device, *views, *options, [&](std::size_t i) {
    log().info("depth of view {} of {}: {}", i + 1, views->size(), (*views)[i].frame->name);
    return !signals.token().stop_requested();
  });
  if (!depths) {
    Error error = depths.error();
    if (error.where == "the views") error.where = arguments.source.spec;
    return tl::unexpected(std::move(error));
  }
  const TriangleMesh points = agreed_points(*views, *depths);
  MvsRun run{arguments.source.spec,  (*device)->info().name, CORVID_VERSION, *views, *depths,
             points.vertices.size(), 1e-3 * watch.lap_ms()};
  std::size_t maps = 0;
  for (const StillDepth& d : *depths) {
    maps += d.refusal.empty();
    if (!d.refusal.empty())
      log().warn("{}: {}", (*views)[d.map.keyframe.value].frame->name, d.refusal);
  }
  Expected<SurfaceCut> surface = SurfaceCut{};
  if (!arguments.no_surface) {
    if (maps > 0) {
      surface = surface_of(arguments, **source, *views, *depths, signals.token());
    } else {
      surface = fail(ErrorCode::not_found, "no view has depth", "surface cut");
    }
    if (surface) {
      run.surface = &*surface;
    } else {  // what there is so far is kept
      run.no_surface = surface.error().to_string();
      log().warn("no surface: {}", run.no_surface);
    }
  }
  if (auto written = write_folder(run, points, *folder); !written)
    return tl::unexpected(written.error());
  if (auto done = folder->commit(); !done) return tl::unexpected(done.error());
  context.out << fmt::format(
      "{} depth maps of {} views, {} points that 3 views agree on, {:.1f} s: {}\n", maps,
      views->size(), run.points, run.seconds, (fs::path(arguments.out) / "report.html").string());
  if (!surface && surface.error().code == ErrorCode::interrupted)
    return tl::unexpected(surface.error());
  if (run.surface) {
    context.out << fmt::format("surface: {} triangles, voxels of {:.4g}: {}\n",
                               run.surface->mesh.triangles.size(), run.surface->voxel_size,
                               (fs::path(arguments.out) / "surface.ply").string());
  }
  return maps > 0 && surface ? ExitCode::ok : ExitCode::no_estimate;
}

}  // namespace

Action add_mvs_command(CLI::App& app) {
  auto a = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand(
      "mvs", "Depth maps, points and surface of calibrated stills with known poses");
  a->source.add_to(*command);
  command->add_option("--out", a->out, "Folder for depth maps, points, surface and report")
      ->required();
  command->add_option("--device", a->device, "auto, cpu, gpu, or a number from `corvid doctor`")
      ->envname("CORVID_DEVICE")
      ->capture_default_str();
  command->add_option("--neighbours", a->neighbours, "Views that each is compared with")
      ->check(CLI::Range(2, 16))
      ->capture_default_str();
  command->add_option("--scale", a->scale, "One ray per n x n pixels [by the image's size]")
      ->check(CLI::Range(1, 16));
  command->add_option("--near", a->near, "Nearest depth, in the unit of the poses [looked for]");
  command->add_option("--far", a->far, "Farthest depth");
  command->add_flag("--no-surface", a->no_surface, "Stop at depth maps and points");
  command
      ->add_option("--voxel", a->voxel_size,
                   "Of the surface, in the unit of the poses [by the rays]")
      ->check(CLI::PositiveNumber);
  command
      ->add_option("--max-mb", a->max_mb,
                   "Memory for the surface; larger voxels if it would not do")
      ->check(CLI::Range(16, 1000000))
      ->capture_default_str();
  command->add_flag("--open", a->open, "Leave out the parts of the surface that no point supports");
  command->footer(R"(
Without --near and --far the depth is looked for around the point that the cameras look at.
The surface is the minimal one by graph cut, closed unless --open is given; of a Middlebury set in
the box that its README names, else around the points.

Examples:
  corvid mvs templeRing/ --out temple
  corvid mvs aerial_colmap/ --out aerial --near 60 --far 140
)");
  return [a](Context& context) { return run_mvs(*a, context); };
}

}  // namespace corvid
