#include "bench/ncc_bench.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <random>
#include <set>
#include <string>
#include <utility>

#include "bench/bench_image.h"
#include "bench/peak_meter.h"
#include "core/log.h"
#include "kernels/corners.h"
#include "kernels/ncc.h"
#include "kernels/pyramid.h"

namespace corvid {
namespace {

constexpr int kMiddleSide = 1024;                     // strips, flavours
constexpr int kFrameWidth = 752, kFrameHeight = 480;  // windows, features
constexpr int kStrips = 3000, kStripRadiusX = 320, kStripRadiusY = 10;
constexpr int kWindows = 1000, kWindowSides[] = {11, 21}, kWindowRadii[] = {4, 8, 15};
constexpr int kStripTemplate = 11;

// The same pixels under an id of their own: nothing that the matcher keeps of an image serves them.
DeviceImage as_new(const Device& device, const DeviceImage& image) {
  DeviceImage renamed = image;
  renamed.id = allocate_image(device, 1, 1, image.format).id;
  return renamed;
}

template <class T>
cv::Mat view(Image<T>& image) {
  return {image.height(), image.width(), cv::traits::Type<T>::value, image.data()};
}

// The largest |a - b|; NaN counts as 4, more than coefficients can differ.
double largest_difference(const FloatImage& a, const cv::Mat& b) {
  if (a.width() != b.cols || a.height() != b.rows) return 4;
  double largest = 0;
  for (int y = 0; y < b.rows; ++y) {
    const float *p = a.row(y), *q = b.ptr<float>(y);
    for (int x = 0; x < b.cols; ++x) {
      const double d = std::abs(double{p[x]} - double{q[x]});
      largest = std::max(largest, std::isnan(d) ? 4.0 : d);
    }
  }
  return largest;
}

// Places at least `margin` from the border, sub-pixel.
class Places {
 public:
  Places(int width, int height, int margin) : width_(width), height_(height), margin_(margin) {}
  void centre_template(NccJob& job) {
    job.template_x_px = within(margin_, width_ - margin_);
    job.template_y_px = within(margin_, height_ - margin_);
  }
  float within(int low, int high) {
    return static_cast<float>(low) +
           static_cast<float>(high - low) * static_cast<float>(random_() % 9973) / 9973;
  }

 private:
  std::mt19937 random_{3};
  int width_, height_, margin_;
};

// The jobs by OpenCV, templates at whole pixels, best coefficient only; over all cores.
void match_by_opencv(const cv::Mat& image, const std::vector<NccJob>& jobs, int side) {
  cv::parallel_for_(cv::Range(0, static_cast<int>(jobs.size())), [&](const cv::Range& range) {
    cv::Mat scores;
    for (int i = range.start; i < range.end; ++i) {
      const NccJob& job = jobs[static_cast<std::size_t>(i)];
      const int half = side / 2, rx = job.radius_x_px + half, ry = job.radius_y_px + half;
      const cv::Rect window(job.window_x_px - rx, job.window_y_px - ry, 2 * rx + 1, 2 * ry + 1);
      const cv::Rect patch(static_cast<int>(job.template_x_px) - half,
                           static_cast<int>(job.template_y_px) - half, side, side);
      cv::matchTemplate(image(window), image(patch), scores, cv::TM_CCOEFF_NORMED);
      double best = 0;
      cv::minMaxLoc(scores, nullptr, &best);
    }
  });
}

double coefficients_of(const std::vector<NccJob>& jobs) {
  double sum = 0;
  for (const NccJob& job : jobs) sum += (2.0 * job.radius_x_px + 1) * (2.0 * job.radius_y_px + 1);
  return sum;
}

NccRow row_of(NccTable table, std::string name, cv::Size patch, cv::Size image) {
  NccRow row;
  row.table = table;
  row.name = std::move(name);
  row.template_width_px = patch.width;
  row.template_height_px = patch.height;
  row.image_width_px = image.width;
  row.image_height_px = image.height;
  return row;
}

class NccBench {
 public:
  static Expected<NccBench> create(const std::shared_ptr<Device>& device,
                                   const NccBenchOptions& options, const std::stop_token& stop,
                                   NccReport& report) {
    log().info("preparing the device and measuring its peak");
    auto matcher = NccMatcher::create(device);
    if (!matcher) return tl::unexpected(matcher.error());
    auto meter = PeakMeter::create(device);
    if (!meter) return tl::unexpected(meter.error());
    return NccBench(device, std::move(*matcher), std::move(*meter), options, stop, report);
  }

  Expected<void> run() {
    for (const NccTable table : kNccTables) {
      if (std::find(options_.tables.begin(), options_.tables.end(), table) == options_.tables.end())
        continue;
      Expected<void> done;
      switch (table) {
        case NccTable::dense:
          done = dense();
          break;
        case NccTable::strips:
          done = strips();
          break;
        case NccTable::windows:
          done = windows();
          break;
        case NccTable::flavours:
          done = flavours();
          break;
        case NccTable::features:
          done = features();
          break;
      }
      if (!done) return done;
    }
    return {};
  }

 private:
  NccBench(std::shared_ptr<Device> device, NccMatcher matcher, PeakMeter meter,
           const NccBenchOptions& options, std::stop_token stop, NccReport& report)
      : device_(std::move(device)),
        matcher_(std::move(matcher)),
        meter_(std::move(meter)),
        options_(options),
        stop_(std::move(stop)),
        report_(report),
        scores_(device_) {}

  [[nodiscard]] bool stopped() const { return stop_.stop_requested(); }

  Expected<void> prepare(const NccOptions& options, PixelFormat format, const std::string& what) {
    if (!prepared_.insert(what).second || stopped()) return {};
    log().info("preparing the kernels for {} (compiled at their first use)", what);
    return matcher_.prepare(options, format);
  }

  // Measures the peak, and the works in turn.
  std::vector<Timing> measure(std::span<const TimedWork> works) {
    if (stopped()) return {};
    meter_.measure();
    report_.peak_gflops = meter_.fma_gflops();
    report_.copy_gbytes_s = meter_.copy_gbytes_s();
    report_.peak_measurements = meter_.measurements();
    return time_in_turn(works, options_.runs, stop_);
  }

  void finish(NccRow row) {
    row.runs = options_.runs;
    log().info("{}: {}: {:.3f} ms{}", to_string(row.table), row.name, row.corvid.median_ms,
               row.opencv ? fmt::format(", OpenCV {:.3f} ms", row.opencv->median_ms) : "");
    report_.rows.push_back(std::move(row));
  }

  // Every coefficient of the image with the template around its centre; by OpenCV too where it has
  // the same correlation.
  template <class T>
  Expected<void> whole_image(NccTable table, const std::string& name, Image<T>& pixels,
                             const DeviceImage& image, std::optional<double> upload_ms,
                             const NccOptions& options) {
    const int width = options.template_px;
    const int height = options.template_height_px > 0 ? options.template_height_px : width;
    if (auto ready =
            prepare(options, image.format,
                    fmt::format("{}x{} templates{}{}", width, height,
                                image.format == PixelFormat::float32 ? " of floats" : "",
                                options.weights == NccWeights::uniform ? "" : ", Gaussian"));
        !ready)
      return ready;
    NccJob job;
    job.window_x_px = pixels.width() / 2;
    job.window_y_px = pixels.height() / 2;
    job.template_x_px = static_cast<float>(job.window_x_px);
    job.template_y_px = static_cast<float>(job.window_y_px);
    job.radius_x_px = pixels.width();
    job.radius_y_px = pixels.height();
    const cv::Mat target = view(pixels);
    const cv::Mat patch =
        target(cv::Rect(job.window_x_px - width / 2, job.window_y_px - height / 2, width, height));
    cv::Mat expected;
    DeviceImage fresh = image;
    const auto score = [&] { matcher_.score(image, fresh, job, options, scores_); };
    std::vector<TimedWork> works{{score, [&] { fresh = as_new(*device_, image); }}, {score}};
    const bool comparable = options.weights == NccWeights::uniform;
    if (comparable) {
      works.push_back({[&] { cv::matchTemplate(target, patch, expected, cv::TM_CCOEFF_NORMED); }});
    }
    const std::vector<Timing> timings = measure(works);
    if (timings.empty()) return {};
    NccRow row = row_of(table, name, patch.size(), target.size());
    row.coefficients = (pixels.width() - width + 1.0) * (pixels.height() - height + 1.0);
    row.corvid = timings[0];
    row.kept_ms = timings[1].median_ms;
    row.upload_ms = upload_ms;
    if (comparable) {
      row.opencv = timings[2];
      row.largest_difference = largest_difference(scores_.download(), expected);
    }
    finish(std::move(row));
    return {};
  }

  Expected<void> dense() {
    for (const int side : options_.images_px) {
      if (stopped()) return {};
      GreyImage pixels = bench_image(side, side);
      DeviceImage image = upload(*device_, pixels);
      const TimedWork copy{[&] { image = upload(*device_, pixels); }};
      const std::vector<Timing> copied = time_in_turn({&copy, 1}, options_.runs, stop_);
      if (copied.empty()) return {};
      for (const int size : options_.templates_px) {
        NccOptions options;
        options.template_px = size;
        if (auto done = whole_image(NccTable::dense, fmt::format("{0}x{0} in {1}x{1}", size, side),
                                    pixels, image, copied[0].median_ms, options);
            !done)
          return done;
      }
    }
    return {};
  }

  Expected<void> flavours() {
    GreyImage grey = bench_image(kMiddleSide, kMiddleSide);
    FloatImage real(grey.width(), grey.height());
    std::copy_n(grey.data(), grey.size(), real.data());
    const DeviceImage grey_image = upload(*device_, grey), real_image = upload(*device_, real);
    NccOptions gaussian, wide, large;
    gaussian.weights = NccWeights::gaussian;
    wide.template_px = 21;
    wide.template_height_px = 7;
    large.template_px = 31;
    auto done =
        whole_image(NccTable::flavours, "11x11, Gaussian weights", grey, grey_image, {}, gaussian);
    if (done) done = whole_image(NccTable::flavours, "21x7", grey, grey_image, {}, wide);
    if (done)
      done = whole_image(NccTable::flavours, "11x11 of floats", real, real_image, {}, NccOptions{});
    if (done)
      done = whole_image(NccTable::flavours, "31x31 of floats", real, real_image, {}, large);
    return done;
  }

  Expected<void> strips() {
    NccOptions options;
    options.template_px = kStripTemplate;
    if (auto ready = prepare(options, PixelFormat::grey8, "11x11 templates"); !ready) return ready;
    GreyImage pixels = bench_image(kMiddleSide, kMiddleSide);
    const cv::Mat target = view(pixels);
    const DeviceImage image = upload(*device_, pixels);
    Places places(kMiddleSide, kMiddleSide, 16);
    std::vector<NccJob> jobs(kStrips);
    for (NccJob& job : jobs) {
      places.centre_template(job);
      job.radius_x_px = kStripRadiusX;
      job.radius_y_px = kStripRadiusY;
      job.window_x_px =
          static_cast<int>(places.within(kStripRadiusX + 8, kMiddleSide - kStripRadiusX - 8));
      job.window_y_px =
          static_cast<int>(places.within(kStripRadiusY + 8, kMiddleSide - kStripRadiusY - 8));
    }
    NccJob whole;
    whole.window_x_px = whole.window_y_px = whole.radius_x_px = whole.radius_y_px = kMiddleSide / 2;
    whole.template_x_px = whole.template_y_px = kMiddleSide / 2;
    DeviceImage fresh = image;
    const auto renew = [&] { fresh = as_new(*device_, image); };
    const TimedWork works[] = {
        {[&] { (void)matcher_.match(image, fresh, jobs, options); }, renew},
        {[&] { matcher_.score(image, fresh, whole, options, scores_); }, renew},
        {[&] { match_by_opencv(target, jobs, kStripTemplate); }}};
    const std::vector<Timing> timings = measure(works);
    if (timings.empty()) return {};
    NccRow dense_row = row_of(NccTable::strips, "11x11, every coefficient, in turn",
                              {kStripTemplate, kStripTemplate}, target.size());
    dense_row.coefficients =
        static_cast<double>(scores_.width_px) * static_cast<double>(scores_.height_px);
    dense_row.corvid = timings[1];
    NccRow row = dense_row;
    row.name = "11x11, 3000 strips";
    row.coefficients = coefficients_of(jobs);
    row.corvid = timings[0];
    row.opencv = timings[2];
    row.share_of_dense = row.gcoefficients_per_s() / dense_row.gcoefficients_per_s();
    finish(std::move(dense_row));
    finish(std::move(row));
    return {};
  }

  Expected<void> windows() {
    GreyImage pixels = bench_image(kFrameWidth, kFrameHeight);
    const cv::Mat target = view(pixels);
    const DeviceImage image = upload(*device_, pixels);
    for (const int side : kWindowSides) {
      NccOptions options;
      options.template_px = side;
      if (auto ready = prepare(options, PixelFormat::grey8, fmt::format("{0}x{0} templates", side));
          !ready)
        return ready;
      for (const int radius : kWindowRadii) {
        Places places(kFrameWidth, kFrameHeight, 32);
        std::vector<NccJob> jobs(kWindows);
        for (NccJob& job : jobs) {
          places.centre_template(job);
          job.window_x_px = static_cast<int>(job.template_x_px) + 1;
          job.window_y_px = static_cast<int>(job.template_y_px) - 1;
          job.radius_x_px = job.radius_y_px = radius;
        }
        DeviceImage fresh = image;
        const TimedWork works[] = {{[&] { (void)matcher_.match(image, fresh, jobs, options); },
                                    [&] { fresh = as_new(*device_, image); }},
                                   {[&] { match_by_opencv(target, jobs, side); }}};
        const std::vector<Timing> timings = measure(works);
        if (timings.empty()) return {};
        NccRow row =
            row_of(NccTable::windows, fmt::format("{0}x{0}, windows {1}x{1}", side, 2 * radius + 1),
                   {side, side}, target.size());
        row.coefficients = coefficients_of(jobs);
        row.corvid = timings[0];
        row.opencv = timings[1];
        finish(std::move(row));
      }
    }
    return {};
  }

  Expected<void> features() {
    if (stopped()) return {};
    log().info("preparing the kernels for corners and pyramids (compiled at their first use)");
    auto pyramids = PyramidBuilder::create(device_);
    if (!pyramids) return tl::unexpected(pyramids.error());
    auto corners = CornerDetector::create(device_);
    if (!corners) return tl::unexpected(corners.error());
    GreyImage pixels = bench_image(kFrameWidth, kFrameHeight);
    const cv::Mat picture = view(pixels);
    const DeviceImage image = upload(*device_, pixels);
    const auto report = [&](const char* name, std::span<const TimedWork> works) {
      const std::vector<Timing> timings = measure(works);
      if (timings.empty()) return;
      NccRow row = row_of(NccTable::features, name, {}, picture.size());
      row.corvid = timings[0];
      row.opencv = timings[1];
      finish(std::move(row));
    };
    const CornerOptions options;
    const TimedWork corner_works[] = {{[&] { (void)corners->detect(image, options); }}, {[&] {
                                        std::vector<cv::Point2f> found;
                                        cv::goodFeaturesToTrack(
                                            picture, found, options.max_count, options.quality,
                                            options.min_distance_px, cv::noArray(), 7);
                                      }}};
    report("corners, the best 1000 spread evenly", corner_works);
    const TimedWork pyramid_works[] = {{[&] { (void)pyramids->build(pixels, 4); }}, {[&] {
                                         std::vector<cv::Mat> levels(4);
                                         levels[0] = picture.clone();
                                         for (std::size_t i = 1; i < 4; ++i)
                                           cv::pyrDown(levels[i - 1], levels[i]);
                                       }}};
    report("pyramid of 4 levels, upload included", pyramid_works);
    return {};
  }

  std::shared_ptr<Device> device_;
  NccMatcher matcher_;
  PeakMeter meter_;
  const NccBenchOptions& options_;
  std::stop_token stop_;
  NccReport& report_;
  NccScores scores_;
  std::set<std::string> prepared_;
};

}  // namespace

Expected<void> validate(const NccBenchOptions& options) {
  std::string problems;
  const auto problem = [&](const std::string& text) {
    problems += (problems.empty() ? "" : "; ") + text;
  };
  if (options.runs < 1) problem("runs must be at least 1");
  int largest = 0;
  for (const int side : options.templates_px) {
    if (side < 3 || side > 31 || side % 2 == 0)
      problem(fmt::format("a template of {} px is not odd and 3 to 31", side));
    largest = std::max(largest, side);
  }
  for (const int side : options.images_px) {
    if (side > 16384) problem(fmt::format("an image of {0}x{0} px is larger than 16384", side));
    if (side < largest)
      problem(fmt::format("an image of {0}x{0} px is smaller than a template", side));
  }
  if (options.templates_px.empty() || options.images_px.empty() || options.tables.empty())
    problem("there is nothing to measure");
  if (!problems.empty()) return fail(ErrorCode::invalid_argument, problems);
  return {};
}

Expected<void> run_ncc_bench(const std::shared_ptr<Device>& device, const NccBenchOptions& options,
                             const std::stop_token& stop, NccReport& report) {
  report = {};
  report.runs = options.runs;
  if (auto valid = validate(options); !valid) return valid;
  auto machine = bench_machine(*device);
  if (!machine) return tl::unexpected(machine.error());
  report.machine = std::move(*machine);
  Expected<void> done;
  try {
    auto bench = NccBench::create(device, options, stop, report);
    done = bench ? bench->run() : Expected<void>(tl::unexpected(bench.error()));
  } catch (const DeviceFault& fault) {
    done = fail(ErrorCode::device, fault.what(), device->info().name);
  }
  report.interrupted = stop.stop_requested();
  return done;
}

}  // namespace corvid
