#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>
#include <memory>
#include <opencv2/core/utility.hpp>
#include <optional>
#include <ostream>
#include <set>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "apps/command_list.h"
#include "apps/engine_options.h"
#include "apps/match_images.h"
#include "apps/match_picture.h"
#include "apps/match_report.h"
#include "apps/opencl_trouble.h"
#include "apps/option_checks.h"
#include "apps/signal_guard.h"
#include "core/log.h"
#include "frontend/epipolar.h"
#include "io/atomic_file.h"
#include "io/image_encode.h"
#include "io/options_file.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;

constexpr int kJpegQuality = 92;

struct ModuleSwitch {
  const char* name;  ///< as in matching.disambiguation
  bool DisambiguationOptions::*on;
};
constexpr std::array kSwitches = {
    ModuleSwitch{"highest_scores", &DisambiguationOptions::highest_scores},
    ModuleSwitch{"epipolar", &DisambiguationOptions::epipolar},
    ModuleSwitch{"sectors", &DisambiguationOptions::sectors},
    ModuleSwitch{"affine_transfer", &DisambiguationOptions::affine_transfer},
    ModuleSwitch{"topology", &DisambiguationOptions::topology},
    ModuleSwitch{"epipolar_transfer", &DisambiguationOptions::epipolar_transfer},
};

struct Arguments {
  std::vector<std::string> images;
  std::vector<int> frames;
  std::string calibration;
  EngineArguments engine;
  std::vector<std::string> without;
  std::optional<int> max_points;
  std::string picture = "match.png", marks = "markers";
  bool no_picture = false;
  std::optional<std::string> matches, json;

  [[nodiscard]] Expected<Options> options() const {
    auto options = engine.read();
    if (!options) return options;
    for (const ModuleSwitch& module : kSwitches) {
      if (std::find(without.begin(), without.end(), module.name) != without.end())
        options->matching.disambiguation.*module.on = false;
    }
    if (max_points) options->matching.max_points = *max_points;
    if (auto checked = check_options(*options, "options"); !checked) {
      return tl::unexpected(checked.error());
    }
    return options;
  }

  [[nodiscard]] std::vector<std::string> outputs() const {
    std::vector<std::string> files;
    if (!no_picture) files.push_back(picture);
    if (matches) files.push_back(*matches);
    if (json) files.push_back(*json);
    return files;
  }
};

std::string lower_extension(const std::string& path) {
  std::string extension = fs::path(path).extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return extension;
}

// Found out before the work: files that cannot be written, that are given twice, or that are
// among the images.
Expected<void> check_outputs(const Arguments& arguments) {
  if (!arguments.no_picture) {
    const std::string extension = lower_extension(arguments.picture);
    if (extension != ".png" && extension != ".jpg" && extension != ".jpeg") {
      return fail(ErrorCode::invalid_argument, "is not the name of a PNG or JPEG file",
                  arguments.picture, "--out match.png, or --no-picture for none");
    }
  }
  const auto place = [](const std::string& path) {
    std::error_code ignored;
    return fs::weakly_canonical(fs::absolute(path, ignored), ignored);
  };
  std::set<fs::path> taken;
  for (const std::string& image : arguments.images) taken.insert(place(image));
  for (const std::string& file : arguments.outputs()) {
    if (auto writable = check_file_writable(file); !writable) return writable;
    if (!taken.insert(place(file)).second) {
      return fail(ErrorCode::invalid_argument, "is an image or an output already", file,
                  "give every output a name of its own");
    }
  }
  return {};
}

Expected<std::vector<MatchImage>> read_images(const Arguments& arguments,
                                              const std::stop_token& stop) {
  if (!arguments.frames.empty()) {
    if (arguments.images.size() != 1 || arguments.frames.size() < 2) {
      return fail(ErrorCode::invalid_argument,
                  "takes one source and at least two numbers of its frames", "--frames",
                  "corvid match SOURCE --frames 0,5");
    }
    SourceArguments source;
    source.spec = arguments.images.front();
    source.options.calibration_path = arguments.calibration;
    source.options.colour = false;
    return read_match_frames(source, arguments.frames, stop);
  }
  if (arguments.images.size() < 2) {
    return fail(ErrorCode::invalid_argument, "a second image is missing", arguments.images.front(),
                "give two images, or a source with --frames 0,5");
  }
  std::vector<MatchImage> images;
  for (const std::string& path : arguments.images) {
    auto image = read_match_image(path, arguments.calibration);
    if (!image) return tl::unexpected(image.error());
    images.push_back(std::move(*image));
  }
  return images;
}

// Every note once, with the images that it is about.
void say_notes(const std::vector<MatchImage>& images) {
  std::vector<std::pair<std::string, std::vector<std::string>>> said;
  for (const MatchImage& image : images) {
    for (const std::string& note : image.notes) {
      auto it =
          std::find_if(said.begin(), said.end(), [&](const auto& s) { return s.first == note; });
      if (it == said.end()) it = said.insert(said.end(), {note, {}});
      it->second.push_back(image.name);
    }
  }
  for (const auto& [note, names] : said) log().info("{}: {}", fmt::join(names, ", "), note);
}

// Fills in the views, the matches and the times. Throws DeviceFault.
Expected<void> match_images(PairMatcher& matcher, const std::stop_token& stop, MatchRun& run) {
  const auto append = [&](const std::string& prefix, const Timings& timings) {
    for (const auto& [step, ms] : timings) run.timings.emplace_back(prefix + step, ms);
  };
  const auto stopped = [&] {
    return fail(ErrorCode::interrupted, "interrupted: there are no matches yet");
  };
  Stopwatch watch;
  for (const MatchImage& image : run.images) {
    if (stop.stop_requested()) return stopped();
    run.views.push_back(matcher.prepare(image.grey, image.camera));
    run.timings.emplace_back("prepare " + image.name, watch.lap_ms());
  }
  std::vector<AuxiliaryMatches> auxiliary;
  for (std::size_t i = 2; i < run.images.size(); ++i) {
    if (stop.stop_requested()) return stopped();
    run.auxiliary.push_back(matcher.match(run.views[0], run.views[i]));
    const PairMatches& pair = run.auxiliary.back();
    append(run.images[i].name + ": ", pair.timings);
    if (pair.F) {
      auxiliary.push_back(auxiliary_matches(run.views[0], run.views[i], pair));
    } else {
      log().warn("{}: not used, it has no common geometry with the reference: {}",
                 run.images[i].name, pair.refusal);
    }
  }
  if (stop.stop_requested()) return stopped();
  run.pair = matcher.match(run.views[0], run.views[1], {std::nullopt, auxiliary});
  append("", run.pair.timings);
  return {};
}

std::string encoded_picture(const MatchRun& run, const Arguments& arguments) {
  const auto caption = [&](const char* role, std::size_t i) {
    const MatchImage& image = run.images[i];
    return fmt::format("{}   {}   {} x {} px", role, image.name, image.grey.width(),
                       image.grey.height());
  };
  const ColourImage picture =
      match_picture({run.images[0].grey, caption("reference", 0)},
                    {run.images[1].grey, caption("target", 1)}, run.views[0].points, run.pair,
                    arguments.marks == "lines" ? MatchMarks::lines : MatchMarks::markers);
  return lower_extension(arguments.picture) == ".png" ? encode_png(picture)
                                                      : encode_jpeg(picture, kJpegQuality);
}

Expected<void> write_outputs(const MatchRun& run, const Arguments& arguments, Context& context) {
  const auto write = [&](const char* what, const std::string& file, const std::string& bytes) {
    auto written = write_file_atomically(file, bytes);
    if (written) context.out << fmt::format("{:<12} {}\n", what, file);
    return written;
  };
  Expected<void> done;
  if (!arguments.no_picture)
    done = write("picture", arguments.picture, encoded_picture(run, arguments));
  if (done && arguments.matches) done = write("matches", *arguments.matches, matches_csv(run.pair));
  if (done && arguments.json) done = write("json", *arguments.json, match_json(run));
  return done;
}

Expected<ExitCode> run(const Arguments& arguments, Context& context) {
  const SignalGuard signals;
  const auto options = arguments.options();
  if (!options) return tl::unexpected(options.error());
  if (auto checked = check_outputs(arguments); !checked) return tl::unexpected(checked.error());
  MatchRun run;
  auto images = read_images(arguments, signals.token());
  if (!images) return tl::unexpected(images.error());
  run.images = std::move(*images);
  say_notes(run.images);

  const auto device =
      open_explained([&] { return Device::open(options->device, options->threads); });
  if (!device) return tl::unexpected(device.error());
  run.device = (*device)->info().name;
  if (options->threads > 0) cv::setNumThreads(options->threads);  // the host's part of the budget
  auto matcher = PairMatcher::create(*device, options->matching);
  if (!matcher) return tl::unexpected(matcher.error());
  auto matched =
      opening_on_device(**device, [&] { return match_images(**matcher, signals.token(), run); });
  if (!matched) return tl::unexpected(matched.error());
  if (!*matched) return tl::unexpected(matched->error());

  print(context.out, run);
  context.out << '\n';
  if (auto written = write_outputs(run, arguments, context); !written) {
    return tl::unexpected(written.error());
  }
  if (run.pair.F) return ExitCode::ok;
  log().error("{} and {}: no common geometry: {}", run.images[0].name, run.images[1].name,
              run.pair.refusal);
  return ExitCode::no_estimate;
}

}  // namespace

Action add_match_command(CLI::App& app) {
  auto a = std::make_shared<Arguments>();
  CLI::App* command =
      app.add_subcommand("match", "Match images: points, epipolar geometry, and a picture of them");
  command
      ->add_option("IMAGE", a->images,
                   "Reference, target, and auxiliary images that help to tell candidates apart; "
                   "with --frames one source as `corvid info` takes it")
      ->required();
  command
      ->add_option("--frames", a->frames,
                   "I,J[,K...]: frames of a source, counted from 0, instead of images")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(at_least(0));
  command->add_option("--calibration", a->calibration,
                      "Camera calibration file of all images; else EXIF, else a guess");
  command->add_option("--out", a->picture, "The picture, PNG or JPEG")->capture_default_str();
  command->add_flag("--no-picture", a->no_picture, "No picture");
  command
      ->add_option("--marks", a->marks,
                   "markers: the same random marker on both images; lines: joined")
      ->check(CLI::IsMember({"markers", "lines"}))
      ->capture_default_str();
  command->add_option("--matches", a->matches, "CSV file for the matches");
  command->add_option("--json", a->json, "JSON file for the counts, F and times");
  std::vector<std::string> modules;
  for (const ModuleSwitch& module : kSwitches) modules.emplace_back(module.name);
  command->add_option("--without", a->without, "Modules that do not run, separated by commas")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::IsMember(modules));
  command->add_option("--max-points", a->max_points,
                      "Interest points per image: matching.max_points");
  a->engine.add_to(*command);
  command->footer(R"(
Exit code 6 if the images have no common geometry; all outputs are written all the same.

Examples:
  corvid match a.jpg b.jpg                              match.png
  corvid match a.jpg b.jpg c.jpg --calibration cam.yaml --matches matches.csv
  corvid match ~/data/MH_05 --frames 100,110 --marks lines --out pair.png
  corvid match synthetic:seed=3,path=facade --frames 0,10 --without sectors,topology
  corvid match a.jpg b.jpg --no-picture --json match.json --set matching.template_px=15
)");
  return [a](Context& context) { return run(*a, context); };
}

}  // namespace corvid
