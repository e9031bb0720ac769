#include "apps/report.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "apps/plot.h"
#include "apps/render_mesh.h"
#include "apps/report_page.h"
#include "apps/report_pictures.h"
#include "scenes/run_results.h"

namespace corvid {
namespace {

RunReportInput input_of(const RunResult& run, bool with_truth) {
  RunReportInput input{run, std::nullopt, std::nullopt, "1.2.3", "corvid replay '<a&b>' --out x"};
  if (with_truth) {
    input.trajectory_errors = evaluate(run.trajectory, made_up_truth(run));
    SurfaceOptions options;
    options.estimate_samples = 2000;
    options.truth_samples = 4000;
    input.surface_errors = compare_surfaces(run.mesh, run.mesh, Sim3(), options);
  }
  return input;
}

ReportFacts facts_of(const RunReportInput& input) {
  return {input,
          count_run(input.result),
          machine_info(),
          "frontend:\n  max_tracks: 800  # <x>\n",
          {},
          {{"mesh.drc", "the surface", 12345}}};
}

/// The page without its pictures' bytes.
std::string without_data(const std::string& html) {
  std::string out;
  std::size_t at = 0;
  while (true) {
    const std::size_t begin = html.find(";base64,", at);
    if (begin == std::string::npos) return out + html.substr(at);
    out += html.substr(at, begin - at);
    at = html.find('"', begin);
  }
}

/// Why a page is not well-formed (as XML but for its doctype and void elements); empty if it is.
std::string malformed(const std::string& html) {
  std::vector<std::string> open;
  for (std::size_t i = 0; i < html.size(); ++i) {
    if (html[i] == '&') {
      const std::size_t end = html.find(';', i);
      if (end == std::string::npos || end - i > 8) {
        return "a bare & before " + html.substr(i, 30);
      }
    }
    if (html[i] == '>') return "a bare > before " + html.substr(i, 30);
    if (html[i] != '<') continue;
    std::size_t end = i + 1;
    for (bool quoted = false; end < html.size() && (quoted || html[end] != '>'); ++end) {
      if (html[end] == '"') quoted = !quoted;
      if (html[end] == '<') return "a < inside a tag: " + html.substr(i, 60);
    }
    if (end >= html.size()) return "a tag without end: " + html.substr(i, 60);
    const std::string tag = html.substr(i + 1, end - i - 1);
    i = end;
    if (tag.starts_with("!") || tag.ends_with("/")) continue;
    const std::string name = tag.substr(tag.starts_with("/") ? 1 : 0);
    const std::string word = name.substr(0, name.find(' '));
    if (!tag.starts_with("/")) {
      open.push_back(word);
      if (word == "style") i = html.find("</style>", i) - 1;
      continue;
    }
    if (open.empty() || open.back() != word) {
      return "</" + word + "> closes " + (open.empty() ? "nothing" : open.back());
    }
    open.pop_back();
  }
  return open.empty() ? "" : "<" + open.back() + "> is not closed";
}

/// "nan" or "inf" as a word of its own, with what stands around it; empty if there is none.
std::string number_that_is_none(const std::string& text) {
  std::string lower = text;
  std::transform(lower.begin(), lower.end(), lower.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  const auto letter = [&](std::size_t i) {
    return i < lower.size() && std::isalnum(static_cast<unsigned char>(lower[i])) != 0;
  };
  for (const char* word : {"nan", "inf"}) {
    for (std::size_t at = 0; (at = lower.find(word, at)) != std::string::npos; ++at) {
      if ((at == 0 || !letter(at - 1)) && !letter(at + 3)) return text.substr(at, 60);
    }
  }
  return "";
}

void expect_sound(const std::string& html) {
  EXPECT_EQ(malformed(html), "");
  const std::string text = without_data(html);
  EXPECT_EQ(number_that_is_none(text), "");
  // Nothing is fetched: every source is data, every link is inside the page.
  for (const char* attribute : {"src=\"", "href=\""}) {
    for (std::size_t at = 0; (at = text.find(attribute, at)) != std::string::npos; ++at) {
      const std::string value = text.substr(at + std::string(attribute).size(), 5);
      EXPECT_TRUE(value.starts_with("data:") || value.starts_with("#")) << value;
    }
  }
  EXPECT_EQ(text.find("<script"), std::string::npos);
  EXPECT_EQ(text.find("http://"), std::string::npos);
  EXPECT_EQ(text.find("https://"), std::string::npos);
  for (const char* id : {"trajectory", "truth", "tracking", "timing", "frames", "map", "depth",
                         "mesh", "files", "options", "notes", "machine"}) {
    EXPECT_NE(text.find("<section id=\"" + std::string(id) + "\""), std::string::npos) << id;
  }
}

std::string page_of(const ReportFacts& facts) { return report_html(facts, report_pictures(facts)); }

TEST(Report, FullRunShowsEverySection) {
  const RunResult run = made_up_run();
  const RunReportInput input = input_of(run, true);
  ASSERT_EQ(input.trajectory_errors->problem, "");
  const std::string html = page_of(facts_of(input));
  expect_sound(html);
  const std::string text = without_data(html);
  EXPECT_NE(text.find("Trajectory error (ATE)"), std::string::npos);
  EXPECT_NE(text.find("Mesh error"), std::string::npos);
  EXPECT_NE(text.find("&lt;flight&gt;"), std::string::npos);
  EXPECT_EQ(text.find("<flight>"), std::string::npos);
  EXPECT_NE(text.find("frame 17: a?.png"), std::string::npos);  // a byte that is no UTF-8
  EXPECT_NE(text.find("corvid replay &#39;&lt;a&amp;b&gt;&#39; --out x"), std::string::npos);
  EXPECT_NE(text.find("too little parallax"), std::string::npos);
  EXPECT_EQ(text.find("id=\"interrupted\""), std::string::npos);
  std::size_t pictures = 0;
  for (std::size_t at = 0; (at = html.find("data:image/", at)) != std::string::npos; ++at)
    ++pictures;
  EXPECT_GE(pictures, 3u + 4 * 3 + 1);  // mesh views, depth triples, landmarks
}

TEST(Report, WithoutTruth) {
  const RunResult run = made_up_run(60);
  const std::string html = page_of(facts_of(input_of(run, false)));
  expect_sound(html);
  EXPECT_EQ(html.find("Trajectory error (ATE)"), std::string::npos);
  EXPECT_NE(html.find("The source has no true trajectory."), std::string::npos);
}

TEST(Report, OnEarthWithoutTruth) {
  RunResult run = made_up_run(60);
  const std::string before = page_of(facts_of(input_of(run, false)));
  run.enu_origin = GeodeticPosition{47.4, 8.5, 500};
  const std::string html = page_of(facts_of(input_of(run, false)));
  expect_sound(html);
  EXPECT_NE(before.find("map units"), std::string::npos);
  EXPECT_EQ(html.find("map units"), std::string::npos);
}

TEST(Report, EmptyRun) {
  const RunResult run;
  const std::string html = page_of(facts_of(input_of(run, true)));
  expect_sound(html);
  EXPECT_NE(html.find("id=\"no-estimate\""), std::string::npos);
  const std::string bare = page_of(facts_of(input_of(run, false)));
  expect_sound(bare);
}

TEST(Report, EventsButNoPose) {
  RunResult run = made_up_run(40);
  run.trajectory.clear();
  run.map = nullptr;
  run.mesh = {};
  run.depth_maps.clear();
  run.stages.clear();
  for (PoseEvent& e : run.events) e.T_world_camera.reset();
  run.interrupted = true;
  const std::string html = page_of(facts_of(input_of(run, false)));
  expect_sound(html);
  EXPECT_NE(html.find("id=\"interrupted\""), std::string::npos);
}

TEST(Report, NumbersThatAreNotFiniteAreNotShown) {
  RunResult run = made_up_run(40);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  run.stages[0].median_ms = nan;
  run.wall_s = std::numeric_limits<double>::infinity();
  run.events[20].latency_ms = nan;
  run.events[21].mse_px2 = nan;
  DepthMap depth = run.depth_maps[0].load();
  depth.depth(5, 5) = std::numeric_limits<float>::infinity();
  depth.confidence(6, 6) = std::numeric_limits<float>::quiet_NaN();
  run.depth_maps[0] = StoredDepth(depth);
  run.mesh.vertices[3].x() = std::numeric_limits<float>::quiet_NaN();
  const RunReportInput input = input_of(run, false);
  expect_sound(page_of(facts_of(input)));
  EXPECT_TRUE(nlohmann::json::accept(report_json(facts_of(input))));
}

TEST(Report, OneFrameAndOneLandmark) {
  RunResult run = made_up_run(120);
  auto map = std::make_shared<MapSnapshot>(*run.map);
  map->keyframes.resize(1);
  map->landmarks = Landmarks(std::vector<Landmark>{*map->landmarks.begin()});
  run.map = map;
  run.events.resize(1);
  run.trajectory.resize(1);
  DepthMap depth = run.depth_maps[0].load();
  depth.depth = depth.confidence = FloatImage(8, 6);  // no answer anywhere
  run.depth_maps.assign(1, StoredDepth(depth));
  run.mesh.triangles.resize(1);
  expect_sound(page_of(facts_of(input_of(run, true))));
}

TEST(Report, JsonSaysTheSame) {
  const RunResult run = made_up_run();
  const RunReportInput input = input_of(run, true);
  const ReportFacts facts = facts_of(input);
  const auto json = nlohmann::json::parse(report_json(facts));
  EXPECT_EQ(json.at("schema_version"), kRunSchemaVersion);
  EXPECT_EQ(json.at("version"), "1.2.3");
  EXPECT_EQ(json.at("interrupted"), false);
  EXPECT_EQ(json.at("frames").at("dropped"), 8);
  EXPECT_EQ(json.at("frames").at("with_pose"), facts.numbers.with_pose);
  EXPECT_EQ(json.at("states").at("lost"), facts.numbers.states[3]);
  EXPECT_EQ(json.at("mesh").at("triangles"), run.mesh.triangles.size());
  EXPECT_EQ(json.at("errors").at("trajectory").at("ate_m").at("rmse"),
            input.trajectory_errors->position_m.rmse);
  EXPECT_TRUE(json.at("errors").at("trajectory").at("problem").is_null());
  EXPECT_EQ(json.at("stages").size(), run.stages.size());
  EXPECT_EQ(json.at("options").at("frontend.max_tracks"), "800");
  const RunResult empty;
  const auto bare = nlohmann::json::parse(report_json(facts_of(input_of(empty, false))));
  EXPECT_TRUE(bare.at("errors").at("trajectory").is_null());
}

TEST(ReportNumbers, CountsFromTheEvents) {
  RunResult run;
  const auto add = [&](std::int64_t ms, TrackingState state, bool pose, double latency_ms) {
    PoseEvent e;
    e.time_ns = ms * 1'000'000;
    e.state = state;
    e.latency_ms = latency_ms;
    e.mse_px2 = 4;
    if (pose) {
      e.T_world_camera = Pose();
      run.trajectory.push_back(
          {e.time_ns, Pose(Eigen::Quaterniond::Identity(), {static_cast<double>(ms) / 100, 0, 0})});
    }
    run.events.push_back(e);
  };
  add(0, TrackingState::starting, false, 1);
  add(100, TrackingState::tracking, true, 2);
  add(200, TrackingState::lost, false, 3);
  add(300, TrackingState::tracking, true, 4);
  add(1000, TrackingState::tracking, true, 90);
  run.wall_s = 2;
  const RunNumbers n = count_run(run);
  EXPECT_EQ(n.with_pose, 3u);
  EXPECT_EQ(n.untracked_after_start, 1u);
  EXPECT_DOUBLE_EQ(n.capture_s, 1);
  EXPECT_DOUBLE_EQ(n.start_s, 0.1);
  EXPECT_DOUBLE_EQ(n.path_length, 9);
  EXPECT_DOUBLE_EQ(n.frames_per_s, 2.5);
  EXPECT_DOUBLE_EQ(n.realtime_factor, 0.5);
  EXPECT_DOUBLE_EQ(n.rms_px.median, 2);
  EXPECT_DOUBLE_EQ(n.latency_ms.median, 3);
  EXPECT_DOUBLE_EQ(n.latency_ms.max, 90);
  EXPECT_EQ(n.states[1], 3u);
}

TEST(Plot, Text) {
  EXPECT_EQ(html_escape("a<b>&\"c'\xc3\xa9\x01\xff"), "a&lt;b&gt;&amp;&quot;c&#39;\xc3\xa9??");
  EXPECT_EQ(html_escape("\xed\xa0\x80"), "???");  // a surrogate is no character
  EXPECT_EQ(format_number(0.01234), "0.0123");
  EXPECT_EQ(format_number(0), "0.00");
  EXPECT_EQ(format_number(1234567), "1\u202f234\u202f567");
  EXPECT_EQ(format_number(-123456.7), "-123\u202f457");
  EXPECT_EQ(format_number(std::nan("")), "–");
  EXPECT_EQ(format_percent(0.99999), "99.9 %");
  EXPECT_EQ(format_percent(1), "100 %");
  EXPECT_EQ(base64(""), "");
  EXPECT_EQ(base64("f"), "Zg==");
  EXPECT_EQ(base64("fo"), "Zm8=");
  EXPECT_EQ(base64("foobar"), "Zm9vYmFy");
}

TEST(Plot, LongLinesAreThinnedAndSpikesStay) {
  PlotSeries series{"x", {}, 0, PlotSeries::Style::line};
  for (int i = 0; i < 200000; ++i) series.points.emplace_back(i, i == 77777 ? 1000.0 : 1.0);
  const std::string svg = svg_plot({}, std::span(&series, 1));
  EXPECT_LT(svg.size(), 60000u);
  const std::size_t line = svg.find("<polyline");
  ASSERT_NE(line, std::string::npos);
  const std::size_t begin = svg.find("points=\"", line) + 8;
  double top = 1e9;
  std::istringstream points(svg.substr(begin, svg.find('"', begin) - begin));
  for (std::string word; points >> word;)
    top = std::min(top, std::stod(word.substr(word.find(',') + 1)));
  EXPECT_LT(top, 60);  // the spike reaches the plot's upper edge
}

TEST(Plot, BreaksAtWhatIsNotFinite) {
  const double nan = std::nan("");
  const PlotSeries series{
      "x", {{0, 1}, {1, 2}, {nan, nan}, {3, 1}, {4, 2}}, 0, PlotSeries::Style::line};
  const std::string svg = svg_plot({}, std::span(&series, 1));
  std::size_t lines = 0;
  for (std::size_t at = 0; (at = svg.find("<polyline", at)) != std::string::npos; ++at) ++lines;
  EXPECT_EQ(lines, 2u);
  EXPECT_NE(svg_plot({}, {}).find("Nothing to draw"), std::string::npos);
}

Camera small_camera() {
  Camera camera;
  camera.width_px = 64;
  camera.height_px = 48;
  camera.fx_px = camera.fy_px = 60;
  camera.cx_px = 31.5;
  camera.cy_px = 23.5;
  return camera;
}

TEST(RenderMesh, SilhouetteAndOcclusion) {
  TriangleMesh mesh = coloured_sphere({0, 0, 10}, 2, 40, 60);
  std::fill(mesh.colours.begin(), mesh.colours.end(), Rgb8{200, 0, 0});
  TriangleMesh nearer = coloured_sphere({1.2f, 0, 5}, 0.3f, 20, 30);
  const auto offset = static_cast<std::uint32_t>(mesh.vertices.size());
  for (std::size_t i = 0; i < nearer.vertices.size(); ++i) {
    mesh.vertices.push_back(nearer.vertices[i]);
    mesh.normals.push_back(nearer.normals[i]);
    mesh.colours.push_back({0, 200, 0});
  }
  for (const auto& t : nearer.triangles) {
    mesh.triangles.push_back({t[0] + offset, t[1] + offset, t[2] + offset});
  }
  const MeshPicture picture = render_mesh(mesh, small_camera(), Pose());
  EXPECT_EQ(picture.alpha(0, 0), 0);
  EXPECT_EQ(picture.alpha(32, 24), 255);
  EXPECT_GT(picture.colour(32, 24).r, 80);
  // The silhouette's radius: fx tan(asin(2/10)).
  int width = 0;
  for (int x = 0; x < 32; ++x) width += picture.alpha(x, 24) > 127 ? 1 : 0;
  EXPECT_NEAR(width, 60 * 0.2041, 1.0);
  // The small ball hides the large one: 60 * 1.2 / 5 = 14.4 px right of the centre.
  EXPECT_GT(picture.colour(46, 24).g, 60);
  EXPECT_EQ(picture.colour(46, 24).r, 0);
}

TEST(RenderMesh, BacksAreDarker) {
  TriangleMesh mesh = coloured_sphere({0, 0, 10}, 2, 20, 30);
  const MeshPicture front = render_mesh(mesh, small_camera(), Pose());
  for (auto& t : mesh.triangles) std::swap(t[1], t[2]);
  const MeshPicture back = render_mesh(mesh, small_camera(), Pose());
  EXPECT_LT(back.colour(32, 24).g, front.colour(32, 24).g / 2 + 10);
}

TEST(RenderMesh, OutsideViewsFrameTheMesh) {
  const TriangleMesh mesh = coloured_sphere({5, -3, 20}, 2, 20, 30);
  const std::vector<Pose> cameras = {Pose(), Pose(Eigen::Quaterniond::Identity(), {9, 0, 1})};
  const auto views = outside_views(mesh, guess_axes(cameras), cameras, 320, 200);
  ASSERT_EQ(views.size(), 2u);
  for (const MeshView& view : views) {
    const MeshPicture picture = render_mesh(mesh, view.camera, view.T_world_camera);
    std::size_t covered = 0;
    for (std::size_t i = 0; i < picture.alpha.size(); ++i) covered += picture.alpha.data()[i] > 0;
    EXPECT_GT(covered, picture.alpha.size() / 8);
    EXPECT_EQ(picture.alpha(0, 100), 0);
    // From the side that the cameras looked from: their z is forward, so the eye's z is smaller.
    EXPECT_LT(view.T_world_camera.translation().z(), 20);
  }
  EXPECT_TRUE(outside_views({}, {}, cameras, 320, 200).empty());
}

TEST(RenderMesh, AxesFollowThePath) {
  std::vector<Pose> level, downwards;
  for (int i = 0; i < 10; ++i) {
    level.emplace_back(Eigen::Quaterniond::Identity(), Eigen::Vector3d(i, 0.1 * i, 2 * i));
    downwards.emplace_back(Eigen::Quaterniond::Identity(), Eigen::Vector3d(i, 2 * i, 0.1 * i));
  }
  EXPECT_EQ(guess_axes(level).up, Eigen::Vector3d(0, -1, 0));
  EXPECT_EQ(guess_axes(downwards).up, Eigen::Vector3d(0, 0, -1));
  for (const auto& poses : {level, downwards, std::vector<Pose>{}}) {
    const ViewAxes a = guess_axes(poses);
    EXPECT_EQ(a.right.cross(a.forward), a.up);
  }
}

TEST(RenderMesh, UpIsFoundForTiltedCamerasThatTurn) {
  for (const double pitch : {0.0, 0.6, 1.0, 1.5707963}) {  // up to straight down
    // World: the first camera's. True up there is -y turned up by the pitch.
    const Eigen::AngleAxisd tilt(-pitch, Eigen::Vector3d::UnitX());
    const Eigen::Vector3d up = tilt.inverse() * -Eigen::Vector3d::UnitY();
    std::vector<Pose> poses;
    for (int i = 0; i < 40; ++i) {
      const Eigen::AngleAxisd yaw(0.02 * i, up);
      const Eigen::AngleAxisd roll(0.01 * std::sin(2.0 * i), Eigen::Vector3d::UnitZ());
      poses.emplace_back(Eigen::Quaterniond(yaw * roll), Eigen::Vector3d(0.1 * i, 0, 0));
    }
    const ViewAxes axes = guess_axes(poses);
    EXPECT_GT(axes.up.dot(up), 0.999) << pitch;
    EXPECT_LT((axes.right.cross(axes.forward) - axes.up).norm(), 1e-12);
    EXPECT_EQ(axes.up_name, "up");
  }
}

TEST(ReportPictures, DepthColoursAndHoles) {
  FloatImage depth(20, 10, 2.0f);
  for (int y = 0; y < 10; ++y) {
    for (int x = 10; x < 20; ++x) depth(x, y) = 8;
  }
  depth(3, 3) = 0;
  const DepthPicture picture = picture_of_depth(depth);
  EXPECT_NEAR(picture.near, 2, 1e-6);
  EXPECT_NEAR(picture.far, 8, 1e-6);
  EXPECT_EQ(picture.picture.alpha(3, 3), 0);
  EXPECT_EQ(picture.picture.alpha(4, 3), 255);
  EXPECT_GT(picture.picture.colour(4, 3).r, picture.picture.colour(4, 3).b);    // near: red
  EXPECT_GT(picture.picture.colour(15, 3).b, picture.picture.colour(15, 3).r);  // far: blue
  EXPECT_EQ(spread_indices(10, 4), (std::vector<std::size_t>{0, 3, 6, 9}));
  EXPECT_EQ(spread_indices(3, 10).size(), 3u);
  EXPECT_TRUE(spread_indices(0, 10).empty());
}

}  // namespace
}  // namespace corvid
