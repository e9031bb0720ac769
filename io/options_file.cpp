#include "io/options_file.h"

#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <charconv>
#include <cmath>
#include <set>
#include <type_traits>
#include <utility>
#include <vector>

#include "io/atomic_file.h"
#include "io/nearest_name.h"

namespace corvid {
namespace {

// The member is named once: its spelling is the key.
#define CORVID_OPTION(member, doc)                                       \
  OptionField {                                                          \
#member, doc, [](Options & o) -> OptionPointer { return &o.member; } \
  }

constexpr OptionField kFields[] = {
    CORVID_OPTION(frontend.max_tracks, "features kept alive per frame"),
    CORVID_OPTION(frontend.max_still_points,
                  "interest points per photograph, in place of matching.max_points"),
    CORVID_OPTION(frontend.corner_quality, "weakest corner, share of the strongest one's score"),
    CORVID_OPTION(frontend.harris_kappa, "kappa of the Harris-Stephens corner score"),
    CORVID_OPTION(frontend.template_px, "side of the NCC template, odd [px]"),
    CORVID_OPTION(frontend.min_score, "NCC score below which a track is lost"),
    CORVID_OPTION(frontend.peak_quality, "NCC peaks kept, share of the window's best"),
    CORVID_OPTION(frontend.ratio_highest_scores, "best score over the second best, at least"),
    CORVID_OPTION(frontend.max_epipolar_px, "inlier distance of the epipolar test [px]"),
    CORVID_OPTION(frontend.corner_score_ratio,
                  "weak-corner removal: largest score ratio of a match"),
    CORVID_OPTION(frontend.keyframe_min_tracked,
                  "new keyframe when a smaller share of the last one's tracks lives"),
    CORVID_OPTION(frontend.keyframe_parallax,
                  "new keyframe at this median motion, share of the image width"),
    CORVID_OPTION(frontend.seed, "seed of the epipolar RANSAC"),

    CORVID_OPTION(matching.max_points, "interest points per image"),
    CORVID_OPTION(matching.corner_quality, "weakest corner, share of the strongest one's score"),
    CORVID_OPTION(matching.harris_kappa, "kappa of the Harris-Stephens corner score"),
    CORVID_OPTION(matching.template_px, "side of the NCC template, odd [px]"),
    CORVID_OPTION(matching.peak_quality, "NCC peaks kept, share of the window's best"),
    CORVID_OPTION(matching.min_score, "NCC score below which nothing is a match"),
    CORVID_OPTION(matching.refine_template_px,
                  "side of the template of the last measurement, odd [px]"),
    CORVID_OPTION(matching.refine_min_score, "NCC score that a match needs in it"),
    CORVID_OPTION(matching.corner_score_ratio,
                  "weak-corner removal: largest score ratio of a match"),
    CORVID_OPTION(matching.window_frames, "images that are matched to each other in turn"),
    CORVID_OPTION(matching.disambiguation.highest_scores, "module: highest scores"),
    CORVID_OPTION(matching.disambiguation.epipolar, "module: epipolar constraint"),
    CORVID_OPTION(matching.disambiguation.sectors, "module: epipolar sectors"),
    CORVID_OPTION(matching.disambiguation.affine_transfer, "module: affine transfer, three views"),
    CORVID_OPTION(matching.disambiguation.topology, "module: match topology"),
    CORVID_OPTION(matching.disambiguation.epipolar_transfer,
                  "module: epipolar transfer, three views"),
    CORVID_OPTION(matching.disambiguation.max_epipolar_px,
                  "Sampson distance of a match to the epipolar geometry, at most [px]"),
    CORVID_OPTION(matching.disambiguation.ratio_highest_scores,
                  "best score over the second best, at least"),
    CORVID_OPTION(matching.disambiguation.ratio_epipolar,
                  "second epipolar distance over the best, at least"),
    CORVID_OPTION(matching.disambiguation.ratio,
                  "second distance over the best, at least, in the other ratio tests"),
    CORVID_OPTION(matching.disambiguation.global_px,
                  "largest best distance in the other ratio tests [px]"),
    CORVID_OPTION(matching.disambiguation.affine_px,
                  "inlier error of the affine cameras of three views [px]"),
    CORVID_OPTION(matching.disambiguation.topology_neighbours,
                  "as many common neighbours or fewer: the match is withdrawn"),
    CORVID_OPTION(matching.disambiguation.min_matches, "fewer that agree: no epipolar geometry"),
    CORVID_OPTION(matching.disambiguation.seed, "seed of RANSAC"),

    CORVID_OPTION(backend.start_min_parallax_rad,
                  "median ray angle of the two starting keyframes, at least [rad]"),
    CORVID_OPTION(backend.start_min_inliers, "landmarks that a start needs"),
    CORVID_OPTION(backend.max_error_px, "largest reprojection error of an inlier [px]"),
    CORVID_OPTION(backend.min_angle_rad,
                  "nothing is triangulated when its widest ray angle is smaller [rad]"),
    CORVID_OPTION(backend.huber_px, "width of the robust loss [px]"),
    CORVID_OPTION(backend.window_keyframes, "keyframes that the window adjustment moves"),
    CORVID_OPTION(backend.max_iterations, "iterations of one window adjustment, at most"),
    CORVID_OPTION(backend.min_inliers, "fewer agreeing landmarks: the camera is lost"),
    CORVID_OPTION(backend.max_scale_sigma,
                  "standard deviation of the scale below which positions make a map metric, share"),
    CORVID_OPTION(backend.max_position_gap_s,
                  "positions are interpolated over gaps up to this long [s]"),
    CORVID_OPTION(backend.final_adjustment, "adjust everything once more at the end of the run"),
    CORVID_OPTION(backend.adjustment_views,
                  "views that it holds at once; a larger map is adjusted in pieces"),
    CORVID_OPTION(backend.intrinsics,
                  "intrinsics that are estimated, too: auto, fixed, distortion, all"),
    CORVID_OPTION(backend.loop_max_drift,
                  "a loop may move the camera by this share of the way flown since"),
    CORVID_OPTION(backend.seed, "seed of the start's and the resection's RANSAC"),

    CORVID_OPTION(place.enabled, "recognise places: relocalization, loops, segments that meet"),
    CORVID_OPTION(place.candidates, "keyframes that a frame is matched with, at most"),
    CORVID_OPTION(place.min_similarity, "images less alike than this are not matched"),
    CORVID_OPTION(place.min_landmarks, "landmarks of an old keyframe that must be found again"),
    CORVID_OPTION(place.min_share, "of the landmarks that should be in view, found at least"),

    CORVID_OPTION(mapping.enabled,
                  "depth maps, voxel map and mesh; off: trajectory and points only"),
    CORVID_OPTION(mapping.neighbours, "views that a keyframe's depth is compared with"),
    CORVID_OPTION(mapping.depth_samples, "inverse-depth samples per ray"),
    CORVID_OPTION(mapping.depth_scale, "one ray per n x n pixels, 0: at most 640 x 480 rays"),
    CORVID_OPTION(mapping.template_px, "side of the depth template, odd [px]"),
    CORVID_OPTION(mapping.min_score, "a neighbour counts above this NCC score"),
    CORVID_OPTION(mapping.min_views, "neighbours that must agree on a depth"),
    CORVID_OPTION(mapping.voxel_size,
                  "side of a voxel [map units]; 0: from the median depth of the start"),
    CORVID_OPTION(mapping.memory_mb, "depth maps and voxels in memory; the rest goes to a file"),
    CORVID_OPTION(mapping.disk_mb, "voxels in that file; beyond it the oldest are lost"),
    CORVID_OPTION(mapping.stream_bytes_per_s, "of mesh, to each receiver"),
    CORVID_OPTION(mapping.cut_voxel_size,
                  "of the surface by graph cut [unit of the results]; 0: the live map's"),
    CORVID_OPTION(mapping.cut_decay, "mu: a face costs exp(-mu * votes for it)"),
    CORVID_OPTION(mapping.cut_ballooning, "cost of a voxel's volume, share of its face's"),
    CORVID_OPTION(mapping.cut_closed, "off: without caps and the parts that no point supports"),
    CORVID_OPTION(mapping.cut_max_mb,
                  "memory for the cut [MB]; larger voxels where that would not do"),

    CORVID_OPTION(device, "OpenCL device: auto, cpu, gpu, or a number from `corvid doctor`"),
    CORVID_OPTION(threads, "CPU budget of all stages; 0: all cores; 1: bit-repeatable, inline"),
    CORVID_OPTION(keyframe_images_mb,
                  "pictures of the newest keyframes kept in memory [MiB]; older ones go to a file"),
};
#undef CORVID_OPTION

const std::vector<std::string>& known_keys() {
  static const std::vector<std::string> keys = [] {
    std::vector<std::string> result;
    for (const OptionField& field : kFields) result.emplace_back(field.key);
    return result;
  }();
  return keys;
}

bool is_section(std::string_view name) {
  const std::string prefix = std::string(name) + ".";
  for (const OptionField& field : kFields) {
    if (field.key.starts_with(prefix)) return true;
  }
  return false;
}

template <class T>
bool parse_number(std::string_view text, T& value) {
  if (text.starts_with('+')) text.remove_prefix(1);
  T parsed{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), parsed);
  if (error != std::errc() || end != text.data() + text.size()) return false;
  if constexpr (std::is_floating_point_v<T>) {
    if (!std::isfinite(parsed)) return false;
  }
  value = parsed;
  return true;
}

bool parse_value(std::string_view text, bool& value) {
  if (text != "true" && text != "false") return false;
  value = text == "true";
  return true;
}
bool parse_value(std::string_view text, std::string& value) {
  if (text.empty()) return false;
  value = text;
  return true;
}
template <class T>
bool parse_value(std::string_view text, T& value) {
  return parse_number(text, value);
}

std::string at(const std::string& where, const YAML::Mark& mark) {
  return mark.is_null() ? where : fmt::format("{}:{}", where, mark.line + 1);
}

using Seen = std::set<std::string>;

Expected<void> read_scalar(Options& options, const std::string& key, const YAML::Node& value,
                           const std::string& place, Seen& seen) {
  if (!seen.insert(key).second) {
    return fail(ErrorCode::invalid_argument, fmt::format("{} is given twice", key), place,
                "keep one of them");
  }
  return set_option(options, key, value.IsScalar() ? value.Scalar() : "", place);
}

Expected<void> read_map(Options& options, const std::string& prefix, const YAML::Node& map,
                        const std::string& where, Seen& seen) {
  for (const auto& entry : map) {
    const std::string place = at(where, entry.first.Mark());
    if (!entry.first.IsScalar()) {
      return fail(ErrorCode::invalid_argument, "a key is not a word", place,
                  "write `key: value` lines");
    }
    const std::string key = prefix + entry.first.Scalar();
    if (is_section(key)) {
      if (entry.second.IsNull()) continue;  // a section whose every line is commented out
      if (!entry.second.IsMap()) {
        return fail(ErrorCode::invalid_argument,
                    fmt::format("{} is a section and needs keys below it", key), place,
                    "`corvid options` prints every key");
      }
      if (auto read = read_map(options, key + ".", entry.second, where, seen); !read) return read;
    } else if (auto read = read_scalar(options, key, entry.second, place, seen); !read) {
      return read;
    }
  }
  return {};
}

}  // namespace

std::string_view OptionField::type() const {
  Options probe;
  static constexpr std::string_view kNames[] = {"true or false", "whole number", "number",
                                                "whole number, not negative", "text"};
  static_assert(std::variant_size_v<OptionPointer> == std::size(kNames));
  return kNames[pointer(probe).index()];
}

std::string OptionField::text(const Options& options) const {
  Options copy = options;
  return std::visit([](const auto* value) { return fmt::format("{}", *value); }, pointer(copy));
}

std::span<const OptionField> option_fields() { return kFields; }

Expected<void> set_option(Options& options, std::string_view key, std::string_view text,
                          const std::string& where) {
  for (const OptionField& field : kFields) {
    if (field.key != key) continue;
    const bool parsed =
        std::visit([&](auto* value) { return parse_value(text, *value); }, field.pointer(options));
    if (parsed) return {};
    return fail(ErrorCode::invalid_argument,
                fmt::format("{} takes a value of the kind `{}`, not `{}`", key, field.type(), text),
                where, fmt::format("the default is {}", field.text(Options{})));
  }
  std::string hint = nearest_hint(key, known_keys());
  if (hint.empty()) hint = "`corvid options` prints every key";
  return fail(ErrorCode::invalid_argument, fmt::format("unknown option {}", key), where, hint);
}

Expected<void> check_options(const Options& options, const std::string& where) {
  const std::vector<std::string> problems = options.validate();
  if (problems.empty()) return {};
  return fail(ErrorCode::invalid_argument, fmt::format("{}", fmt::join(problems, "; ")), where,
              "`corvid options` prints every option with its default");
}

Expected<Options> parse_options(const std::string& yaml, const std::string& where,
                                const Options& base) {
  Options options = base;
  YAML::Node root;
  try {
    root = YAML::Load(yaml);
  } catch (const YAML::Exception& error) {
    return fail(ErrorCode::invalid_argument, fmt::format("not valid YAML: {}", error.msg),
                at(where, error.mark), "write `key: value` lines");
  }
  if (!root.IsNull() && !root.IsMap()) {
    return fail(ErrorCode::invalid_argument, "the file is not a list of options", where,
                "write `key: value` lines; `corvid options` prints every key");
  }
  if (root.IsMap()) {
    Seen seen;
    if (auto read = read_map(options, "", root, where, seen); !read) {
      return tl::unexpected(read.error());
    }
  }
  if (auto checked = check_options(options, where); !checked) {
    return tl::unexpected(checked.error());
  }
  return options;
}

Expected<Options> read_options_file(const std::filesystem::path& path, const Options& base) {
  auto text = read_file_bytes(path);
  if (!text) {
    Error error = text.error();
    if (error.hint.empty()) error.hint = "`corvid options > FILE` writes one to start from";
    return tl::unexpected(error);
  }
  return parse_options(*text, path.string(), base);
}

std::string options_to_yaml(const Options& options) {
  std::string text;
  std::string section;
  for (const OptionField& field : kFields) {
    const std::size_t dot = field.key.find('.');
    const bool nested = dot != std::string_view::npos;
    const std::string own(nested ? field.key.substr(0, dot) : "");
    if (nested && own != section) text += own + ":\n";
    section = own;
    Options copy = options;
    std::string value = field.text(options);
    if (std::holds_alternative<std::string*>(field.pointer(copy))) {
      YAML::Emitter quoted;
      quoted << YAML::DoubleQuoted << value;
      value = quoted.c_str();
    }
    text += fmt::format("{}{}: {}  # {}\n", nested ? "  " : "",
                        nested ? field.key.substr(dot + 1) : field.key, value, field.doc);
  }
  return text;
}

Expected<void> write_options_file(const std::filesystem::path& path, const Options& options) {
  return write_file_atomically(path, options_to_yaml(options));
}

}  // namespace corvid
