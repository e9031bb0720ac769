// Tracking batches, corners and pyramids at 752 x 480, against OpenCV on the same work.
// ncc_bench [--device auto|cpu|gpu|N] [--json FILE]
#include <fmt/core.h>
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "kernels/corners.h"
#include "kernels/ncc.h"
#include "kernels/pyramid.h"

namespace {

using namespace corvid;

constexpr int kWidth = 752, kHeight = 480, kJobs = 1000;

// CPU time of the whole process, the OpenCL device's threads included: steadier than wall time on a
// machine that has other work.
double cpu_ms() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto ms = [](const timeval& t) {
    return 1e3 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_usec);
  };
  return ms(usage.ru_utime) + ms(usage.ru_stime);
}

struct Timing {
  double median_ms = 0, fastest_ms = 0, cpu_ms = 0;
};

template <class F>
Timing time(F&& f) {
  constexpr int kRuns = 41;
  f();  // caches, clocks, buffers
  std::vector<double> wall;
  const double before = cpu_ms();
  for (int run = 0; run < kRuns; ++run) {
    const auto start = std::chrono::steady_clock::now();
    f();
    wall.push_back(
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
            .count());
  }
  const double cpu = (cpu_ms() - before) / kRuns;
  std::sort(wall.begin(), wall.end());
  return {wall[kRuns / 2], wall.front(), cpu};
}

// Random texture with detail at several scales.
cv::Mat texture() {
  cv::Mat sum = cv::Mat::zeros(kHeight, kWidth, CV_32F), layer(kHeight, kWidth, CV_32F);
  cv::RNG random(7);
  for (const double sigma : {1.0, 2.5, 6.0, 15.0}) {
    random.fill(layer, cv::RNG::NORMAL, 0, 1);
    cv::GaussianBlur(layer, layer, {}, sigma);
    sum += layer * (16 * sigma);
  }
  cv::Mat grey;
  sum.convertTo(grey, CV_8U, 2.5, 128);
  return grey;
}

std::vector<NccJob> tracking_jobs(int radius) {
  std::mt19937 random(3);
  const auto within = [&](int low, int high) {
    return static_cast<float>(low) +
           static_cast<float>(high - low) * static_cast<float>(random() % 9973) / 9973;
  };
  std::vector<NccJob> jobs(kJobs);
  for (NccJob& job : jobs) {
    job.template_x_px = within(32, kWidth - 32);
    job.template_y_px = within(32, kHeight - 32);
    job.window_x_px = static_cast<int>(job.template_x_px) + 1;
    job.window_y_px = static_cast<int>(job.template_y_px) - 1;
    job.radius_x_px = job.radius_y_px = radius;
  }
  return jobs;
}

// The same windows by OpenCV, templates at whole pixels, best coefficient only.
void match_templates(const cv::Mat& image, const std::vector<NccJob>& jobs, int size) {
  cv::Mat scores;
  for (const NccJob& job : jobs) {
    const int x = static_cast<int>(job.template_x_px), y = static_cast<int>(job.template_y_px);
    const int half = size / 2, r = job.radius_x_px + half;
    cv::matchTemplate(
        image(cv::Rect(job.window_x_px - r, job.window_y_px - r, 2 * r + 1, 2 * r + 1)),
        image(cv::Rect(x - half, y - half, size, size)), scores, cv::TM_CCOEFF_NORMED);
    double best = 0;
    cv::minMaxLoc(scores, nullptr, &best);
  }
}

template <class T>
T opened(Expected<T> value) {
  if (value) return std::move(*value);
  fmt::print(stderr, "{}\n", value.error().to_string());
  std::exit(1);
}

}  // namespace

int main(int argc, char** argv) {
  std::string device_choice = "auto", json_path;
  for (int i = 1; i + 1 < argc; i += 2) {
    if (std::string(argv[i]) == "--device") device_choice = argv[i + 1];
    if (std::string(argv[i]) == "--json") json_path = argv[i + 1];
  }
  const auto device = opened(Device::open(device_choice));
  auto pyramids = opened(PyramidBuilder::create(device));
  auto corners = opened(CornerDetector::create(device));
  auto matcher = opened(NccMatcher::create(device));

  nlohmann::json json = {{"device", device->info().name},
                         {"platform", device->info().platform},
                         {"driver", device->info().version},
                         {"compute_units", device->info().compute_units},
                         {"cores", std::thread::hardware_concurrency()},
                         {"opencv", CV_VERSION},
                         {"compiler", CORVID_COMPILER},
                         {"image", {kWidth, kHeight}}};
  fmt::print("{} ({}, {} units, {}), {} cores, OpenCV {}, {}\n", device->info().name,
             device->info().platform, device->info().compute_units, device->info().version,
             std::thread::hardware_concurrency(), CV_VERSION, CORVID_COMPILER);
  fmt::print("{:<44} {:>10} {:>10} {:>10} {:>12} {:>8}\n", "", "median ms", "fastest", "cpu ms",
             "OpenCV ms", "ratio");
  const auto report = [&](const std::string& name, const Timing& ours, const Timing& theirs) {
    const double ratio = theirs.median_ms / ours.median_ms;
    fmt::print("{:<44} {:>10.3f} {:>10.3f} {:>10.3f} {:>12.3f} {:>8.2f}\n", name, ours.median_ms,
               ours.fastest_ms, ours.cpu_ms, theirs.median_ms, ratio);
    json["results"].push_back({{"name", name},
                               {"median_ms", ours.median_ms},
                               {"fastest_ms", ours.fastest_ms},
                               {"cpu_ms", ours.cpu_ms},
                               {"opencv_median_ms", theirs.median_ms},
                               {"ratio", ratio}});
  };

  const cv::Mat image = texture();
  GreyImage grey(kWidth, kHeight);
  std::copy_n(image.data, grey.size(), grey.data());
  const auto pyramid = pyramids.build(grey, 4);
  const DeviceImage& level = pyramid->level(0);

  report("pyramid, 4 levels, with upload", time([&] { (void)pyramids.build(grey, 4); }), time([&] {
           std::vector<cv::Mat> levels(4);
           levels[0] = image.clone();
           for (std::size_t i = 1; i < 4; ++i) cv::pyrDown(levels[i - 1], levels[i]);
         }));
  report("corner scores, maxima and selection of 1000",
         time([&] { (void)corners.detect(level, {}); }), time([&] {
           std::vector<cv::Point2f> found;
           cv::goodFeaturesToTrack(image, found, 1000, 0.01, 4, cv::noArray(), 7);
         }));
  for (const int size : {11, 21})
    for (const int radius : {4, 8, 15}) {
      const auto jobs = tracking_jobs(radius);
      NccOptions options;
      options.template_px = size;
      opened(matcher.prepare(options).map([] { return true; }));
      report(fmt::format("{} templates {}x{}, radius {}", kJobs, size, size, radius),
             time([&] { (void)matcher.match(level, level, jobs, options); }),
             time([&] { match_templates(image, jobs, size); }));
    }
  if (!json_path.empty()) {
    std::ofstream file(json_path);
    file << json.dump(2) << '\n';
    if (!file) {
      fmt::print(stderr, "{}: cannot be written\n", json_path);
      return 1;
    }
  }
  return 0;
}
