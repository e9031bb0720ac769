#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>
#include <ostream>

#include "apps/command_list.h"
#include "apps/progress.h"
#include "io/camera/libcamera_camera.h"
#include "io/camera/v4l2_camera.h"

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;

Json to_json(const CameraListing& camera) {
  Json modes = Json::array();
  for (const CameraMode& mode : camera.modes) {
    modes.push_back({{"format", mode.format},
                     {"width_px", mode.width_px},
                     {"height_px", mode.height_px},
                     {"rates_hz", mode.rates_hz},
                     {"note", mode.note}});
  }
  return {{"camera", camera.id},
          {"name", camera.name},
          {"driver", camera.driver},
          {"problem", camera.problem.empty() ? Json(nullptr) : Json(camera.problem)},
          {"modes", std::move(modes)}};
}

void print(std::ostream& out, const CameraListing& camera) {
  out << fmt::format("{}\n  {}{}\n", camera.id, camera.name,
                     camera.driver.empty() ? "" : fmt::format(" ({})", camera.driver));
  if (!camera.problem.empty()) out << "  cannot be used now: " << camera.problem << "\n";
  for (const CameraMode& mode : camera.modes) {
    std::string rates;
    for (const double rate_hz : mode.rates_hz)
      rates += fmt::format("{}{:.4g}", rates.empty() ? "" : ", ", rate_hz);
    const std::string size =
        mode.width_px > 0 ? fmt::format("{}x{}", mode.width_px, mode.height_px) : "";
    out << fmt::format("  {:<6} {:<10} {}{}{}\n", mode.format, size,
                       rates.empty() ? "" : rates + " Hz",
                       rates.empty() || mode.note.empty() ? "" : ", ", mode.note);
  }
}

Expected<ExitCode> run(bool json, Context& context) {
  std::vector<CameraListing> cameras = list_v4l2_cameras();
  for (CameraListing& camera : list_libcamera_cameras()) cameras.push_back(std::move(camera));
  if (json) {
    for (const CameraListing& camera : cameras) write_json_line(context.out, to_json(camera));
  } else {
    for (const CameraListing& camera : cameras) print(context.out, camera);
  }
  if (cameras.empty()) {
    return fail(ErrorCode::not_found, "there is no camera", "",
                "is it plugged in, is there a /dev/video*, and is this user in group video?");
  }
  return ExitCode::ok;
}

}  // namespace

Action add_cameras_command(CLI::App& app) {
  auto json = std::make_shared<bool>(false);
  CLI::App* command = app.add_subcommand(
      "cameras", "List the cameras of this machine with their formats, sizes and rates");
  command->add_flag("--json", *json, "One line of JSON per camera");
  command->footer(R"(
The first word of each entry is what --camera takes. A USB camera is listed twice, by V4L2 and by
libcamera: V4L2 is the shorter way. Cameras of a Raspberry Pi and the like need libcamera.

Examples:
  corvid cameras
  corvid live --camera v4l2:/dev/video0 --size 640x480 --camera-rate 30
)");
  return [json](Context& context) { return run(*json, context); };
}

}  // namespace corvid
