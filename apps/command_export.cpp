#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <optional>
#include <ostream>
#include <string>

#include "apps/command_list.h"
#include "apps/live_export.h"
#include "apps/run_folder.h"
#include "io/atomic_file.h"
#include "io/mesh_files.h"

namespace corvid {
namespace {

struct Arguments {
  std::string run, format, surface = "live";
  std::optional<std::string> out;
};

/// The surface so far of a run that is not finished, beside its folder, which is not there yet.
Expected<ExitCode> export_live(const TriangleMesh& mesh, const Arguments& arguments,
                               Context& context) {
  if (mesh.empty()) {
    return fail(ErrorCode::not_found, "the run has no surface yet", arguments.run,
                "try again later");
  }
  auto folder = std::filesystem::absolute(arguments.run).lexically_normal();
  if (folder.filename().empty()) folder = folder.parent_path();
  const bool plain = arguments.format == "glb-plain";
  const auto out = arguments.out
                       ? std::filesystem::path(*arguments.out)
                       : folder.concat(plain ? "-live-plain.glb" : "-live." + arguments.format);
  if (auto written = write_mesh(mesh, out, mesh_format_from_name(arguments.format)); !written) {
    return tl::unexpected(written.error());
  }
  context.out << fmt::format("{}: {} vertices, {} triangles, of a run that goes on\n", out.string(),
                             mesh.vertices.size(), mesh.triangles.size());
  return ExitCode::ok;
}

Expected<ExitCode> run(const Arguments& arguments, Context& context) {
  const std::filesystem::path folder = arguments.run;
  const auto out_or = [&](const char* name) {
    return arguments.out ? std::filesystem::path(*arguments.out) : folder / name;
  };
  if (arguments.format == "colmap") {
    const auto out = out_or("colmap-export");
    if (auto copied = copy_run_colmap(folder, out); !copied) return tl::unexpected(copied.error());
    context.out << out.string() << '\n';
    return ExitCode::ok;
  }
  const RunSurface surface = arguments.surface == "cut" ? RunSurface::cut : RunSurface::live;
  auto live = fetch_live_surface(folder);
  if (!live) return tl::unexpected(live.error());
  if (*live && surface == RunSurface::cut) {
    return fail(ErrorCode::unsupported, "the run goes on, and is cut at its end", arguments.run,
                "--surface live gives what there is by now");
  }
  if (*live) return export_live(**live, arguments, context);
  const std::string stem = run_mesh_stem(surface);
  const auto mesh = load_run_mesh(folder, surface);
  if (!mesh) return tl::unexpected(mesh.error());
  if (mesh->empty() && surface == RunSurface::cut) {
    return fail(ErrorCode::not_found, "the run has no surface by graph cut", arguments.run,
                "fly it with `corvid replay --surface cut` or `both`");
  }
  if (mesh->empty()) {
    return fail(ErrorCode::not_found, "the run made no mesh", arguments.run,
                "it was flown with --no-mapping or --surface cut, or saw too little to map; its "
                "report says more");
  }
  if (arguments.format == "drc" || arguments.format == "glb") {  // the run's own, byte for byte
    const std::string name = stem + "." + arguments.format;
    const auto own = folder / name;
    const auto bytes = read_file_bytes(own);
    if (!bytes) return tl::unexpected(bytes.error());
    const auto out = out_or(name.c_str());
    std::error_code ignored;
    if (!std::filesystem::equivalent(own, out, ignored)) {
      if (auto written = write_file_atomically(out, *bytes); !written) {
        return tl::unexpected(written.error());
      }
    }
    context.out << out.string() << '\n';
    return ExitCode::ok;
  }
  const auto format = mesh_format_from_name(arguments.format);
  const std::string name =
      stem + (arguments.format == "glb-plain" ? "-plain.glb" : "." + arguments.format);
  const auto out = out_or(name.c_str());
  MeshWriteOptions options;
  options.z_up = run_is_on_earth(folder);
  if (auto written = write_mesh(*mesh, out, format, options); !written) {
    return tl::unexpected(written.error());
  }
  context.out << fmt::format("{}: {} vertices, {} triangles\n", out.string(), mesh->vertices.size(),
                             mesh->triangles.size());
  return ExitCode::ok;
}

}  // namespace

Action add_export_command(CLI::App& app) {
  auto a = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand("export", "Write a run's mesh or map in another format");
  command->add_option("DIR", a->run, "The folder of a run; while it goes on, its surface so far")
      ->required();
  command->add_option("--format", a->format, "ply, obj, glb, glb-plain, drc or colmap")
      ->required()
      ->check(CLI::IsMember({"ply", "obj", "glb", "glb-plain", "drc", "colmap"}));
  command
      ->add_option("--surface", a->surface,
                   "live: the fused one; cut: the minimal one, of a run flown with --surface "
                   "cut or both")
      ->capture_default_str()
      ->check(CLI::IsMember({"live", "cut"}));
  command->add_option("--out", a->out,
                      "File (colmap: new folder) to write, through symbolic links, never a device "
                      "or a pipe; default: inside the run's folder; beside it while the run goes "
                      "on");
  command->footer(R"(
Examples:
  corvid export run --format ply                          run/mesh.ply
  corvid export run --format glb --surface cut            run/mesh-cut.glb
  corvid export run --format colmap --out for-openmvs     sparse/ and images/
  corvid export run --format ply                          while the run goes on: run-live.ply
)");
  return [a](Context& context) { return run(*a, context); };
}

}  // namespace corvid
