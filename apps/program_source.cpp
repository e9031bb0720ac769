#include "apps/program_source.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <numbers>
#include <string_view>
#include <utility>
#include <vector>

#include "apps/option_checks.h"
#include "core/log.h"
#include "io/nearest_name.h"
#include "replay/synthetic_flight.h"

namespace corvid {
namespace {

constexpr std::string_view kSynthetic = "synthetic";

template <class T>
bool parse(std::string_view text, T& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

template <class Enum>
bool parse_name(std::string_view text, Enum& value,
                std::initializer_list<std::pair<std::string_view, Enum>> names) {
  for (const auto& [name, candidate] : names) {
    if (text != name) continue;
    value = candidate;
    return true;
  }
  return false;
}

// One key of `synthetic:key=value,...`.
struct FlightKey {
  std::string_view name, doc;
  bool (*set)(FlightOptions&, std::string_view);
};

constexpr FlightKey kFlightKeys[] = {
    {"seed", "of the town, the path and the noise",
     [](FlightOptions& o, std::string_view v) { return parse(v, o.seed); }},
    {"duration", "[s]",
     [](FlightOptions& o, std::string_view v) { return parse(v, o.duration_s); }},
    {"rate", "frames per second",
     [](FlightOptions& o, std::string_view v) { return parse(v, o.rate_hz); }},
    {"width", "[px]", [](FlightOptions& o, std::string_view v) { return parse(v, o.width_px); }},
    {"height", "[px]", [](FlightOptions& o, std::string_view v) { return parse(v, o.height_px); }},
    {"path", "survey, orbit, nadir, loop, facade, hover or rotation",
     [](FlightOptions& o, std::string_view v) {
       return parse_name(v, o.path,
                         {{"survey", FlightPath::survey},
                          {"orbit", FlightPath::orbit},
                          {"nadir", FlightPath::nadir},
                          {"loop", FlightPath::loop},
                          {"facade", FlightPath::facade},
                          {"hover", FlightPath::hover},
                          {"rotation", FlightPath::rotation}});
     }},
    {"speed", "[m/s]", [](FlightOptions& o, std::string_view v) { return parse(v, o.speed_mps); }},
    {"model", "pinhole, radtan, equidistant or fov",
     [](FlightOptions& o, std::string_view v) {
       return parse_name(v, o.model,
                         {{"pinhole", CameraModel::pinhole},
                          {"radtan", CameraModel::radtan},
                          {"equidistant", CameraModel::equidistant},
                          {"fov", CameraModel::fov}});
     }},
    {"fov", "horizontal field of view [degrees]",
     [](FlightOptions& o, std::string_view v) {
       double degrees = 0;
       if (!parse(v, degrees)) return false;
       o.horizontal_fov_rad = degrees * std::numbers::pi / 180;
       return true;
     }},
    {"colour", "true or false",
     [](FlightOptions& o, std::string_view v) {
       return parse_name(v, o.colour, {{"true", true}, {"false", false}});
     }},
    {"noise", "sensor noise, standard deviation [grey levels]",
     [](FlightOptions& o, std::string_view v) { return parse(v, o.noise_sigma); }},
    {"blur", "sigma of the lens [px]",
     [](FlightOptions& o, std::string_view v) { return parse(v, o.optical_blur_px); }},
    {"shutter", "open time, for motion blur [s]",
     [](FlightOptions& o, std::string_view v) { return parse(v, o.shutter_s); }},
    {"vignetting", "share of the light lost in the corners",
     [](FlightOptions& o, std::string_view v) { return parse(v, o.vignetting); }},
    {"exposure", "amplitude of the exposure's changes",
     [](FlightOptions& o, std::string_view v) { return parse(v, o.exposure_change); }},
};

Expected<FlightOptions> parse_flight(std::string_view spec) {
  FlightOptions options;
  const std::string where(spec);
  std::string_view rest = spec.substr(kSynthetic.size());
  if (rest.starts_with(':')) rest.remove_prefix(1);
  while (!rest.empty()) {
    const std::string_view item = rest.substr(0, rest.find(','));
    rest.remove_prefix(std::min(rest.size(), item.size() + 1));
    const std::size_t equals = item.find('=');
    const std::string_view name = item.substr(0, equals);
    const FlightKey* key = nullptr;
    std::vector<std::string> known;
    for (const FlightKey& candidate : kFlightKeys) {
      known.emplace_back(candidate.name);
      if (candidate.name == name) key = &candidate;
    }
    if (key == nullptr) {
      std::string hint = nearest_hint(name, known);
      if (hint.empty()) hint = fmt::format("it takes {}", fmt::join(known, ", "));
      return fail(ErrorCode::invalid_argument,
                  fmt::format("the synthetic flight has no option {}", name), where, hint);
    }
    const std::string_view value = equals == std::string_view::npos ? "" : item.substr(equals + 1);
    if (!key->set(options, value)) {
      return fail(ErrorCode::invalid_argument,
                  fmt::format("`{}` is not a value of {}", value, name), where,
                  fmt::format("{}: {}", name, key->doc));
    }
  }
  return options;
}

bool is_synthetic(std::string_view spec) {
  return spec == kSynthetic || spec.starts_with("synthetic:");
}

}  // namespace

std::string synthetic_help() {
  std::string text;
  for (const FlightKey& key : kFlightKeys) text += fmt::format("  {:<11} {}\n", key.name, key.doc);
  return text;
}

void SourceArguments::add_to(CLI::App& command) {
  command
      .add_option("SOURCE", spec,
                  "Folder or file of images, recognised by itself, or synthetic[:key=value,...]; "
                  "./synthetic for a folder of that name")
      ->required();
  add_reading_options_to(command);
  command.add_flag_callback(
      "--grey", [this] { options.colour = false; }, "Do not keep the images' colour");
}

void SourceArguments::add_reading_options_to(CLI::App& command) {
  command.add_option("--calibration", options.calibration_path,
                     "Camera calibration file, instead of what lies beside the images");
  command
      .add_option("--frame-rate", options.rate_hz,
                  "Frame rate [Hz], instead of the source's own times")
      ->check(above(0));
  command.add_option("--first", options.first, "Images left out at the start")->check(at_least(0));
  command.add_option("--count", options.count, "Images taken at most")->check(at_least(1));
  command.add_option("--step", options.step, "Every N-th image is taken")->check(at_least(1));
}

Expected<std::unique_ptr<FrameSource>> SourceArguments::open() const {
  if (!is_synthetic(spec)) return open_source(spec, options);
  const SourceOptions defaults;
  if (!options.calibration_path.empty() || options.rate_hz || options.first != defaults.first ||
      options.count != defaults.count || options.step != defaults.step) {
    return fail(ErrorCode::invalid_argument,
                "--calibration, --frame-rate, --first, --count and --step are for files", spec,
                "write synthetic:duration=10,rate=20 and the like");
  }
  auto flight = parse_flight(spec);
  if (!flight) return tl::unexpected(flight.error());
  flight->colour = flight->colour && options.colour;
  auto opened = SyntheticFlight::open(*flight);
  if (!opened) return tl::unexpected(opened.error());
  return std::unique_ptr<FrameSource>(std::move(*opened));
}

std::string_view to_string(IntrinsicsOrigin origin) {
  switch (origin) {
    case IntrinsicsOrigin::calibration:
      return "calibration";
    case IntrinsicsOrigin::exif:
      return "EXIF";
    case IntrinsicsOrigin::nominal:
      return "nominal values";
    case IntrinsicsOrigin::guess:
      return "guess";
  }
  return "?";
}

std::string_view name_of(IntrinsicsOrigin origin) {
  switch (origin) {
    case IntrinsicsOrigin::calibration:
      return "calibration";
    case IntrinsicsOrigin::exif:
      return "exif";
    case IntrinsicsOrigin::nominal:
      return "nominal";
    case IntrinsicsOrigin::guess:
      return "guess";
  }
  return "unknown";
}

void log_skipped(const SourceCounts& counts) {
  for (const std::string& message : counts.messages) log().warn("skipped: {}", message);
}

std::string describe(const SourceInfo& info) {
  std::string text = info.path.empty() ? info.kind : fmt::format("{} {}", info.kind, info.path);
  text += info.frames ? fmt::format(": {} frames", *info.frames) : std::string(": stream");
  if (info.camera) text += fmt::format(", {}x{}", info.camera->width_px, info.camera->height_px);
  if (info.stills) {
    text += ", stills";
  } else if (info.rate_hz > 0) {
    text += fmt::format(", {:.4g} Hz", info.rate_hz);
  }
  if (info.camera) {
    text += fmt::format(", {}, intrinsics from {}", to_string(info.camera->model),
                        to_string(info.intrinsics));
  }
  return text;
}

}  // namespace corvid
