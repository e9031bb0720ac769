#include "kernels/ncc.h"

#include <gtest/gtest.h>

#include <limits>

#include "kernels/test_device.h"
#include "kernels/textures.h"
#include "oracle/ncc.h"

namespace corvid {
namespace {

template <class Pixel>
struct CaseOf {
  Image<Pixel> reference, target;
  std::vector<NccJob> jobs;
  NccOptions options;
  [[nodiscard]] oracle::NccShape shape() const {
    const int height =
        options.template_height_px == 0 ? options.template_px : options.template_height_px;
    if (options.weights == NccWeights::separable)
      return {options.template_px, height, options.weights_x, options.weights_y};
    return oracle::ncc_shape(options.template_px, height, options.weights == NccWeights::gaussian);
  }
};
using Case = CaseOf<std::uint8_t>;

NccJob job_at(float x, float y, int window_x, int window_y, int radius_x, int radius_y) {
  NccJob job;
  job.template_x_px = x;
  job.template_y_px = y;
  job.window_x_px = window_x;
  job.window_y_px = window_y;
  job.radius_x_px = radius_x;
  job.radius_y_px = radius_y;
  return job;
}

template <class Pixel>
std::vector<NccResult> match(NccMatcher& matcher, const CaseOf<Pixel>& c) {
  return matcher.match(upload(*test_device(), c.reference), upload(*test_device(), c.target),
                       c.jobs, c.options);
}

bool same(const NccResult& a, const NccResult& b) {
  if (a.count != b.count || a.best_raw != b.best_raw) return false;
  for (std::size_t k = 0; k < 4; ++k) {
    const NccPeak &p = a.peaks[k], &q = b.peaks[k];
    if (p.x_px != q.x_px || p.y_px != q.y_px || p.score != q.score || p.cxx != q.cxx ||
        p.cxy != q.cxy || p.cyy != q.cyy)
      return false;
  }
  return true;
}

struct Difference {
  double best = 0;  // of best_raw
  double peak = 0;  // of a peak's place [px], score or curvature
  int lost = 0;     // peaks that are not there and surely should be
  int wrong = 0;    // peaks that are there and surely should not be
  int peaks = 0;    // peaks compared
  void join(const Difference& o) {
    best = std::max(best, o.best);
    peak = std::max(peak, o.peak);
    lost += o.lost;
    wrong += o.wrong;
    peaks += o.peaks;
  }
};

// Compares one job's result (without alignment) with the definition in double precision.
template <class Pixel>
Difference compare(const CaseOf<Pixel>& c, const NccJob& job, const NccResult& result) {
  Difference d;
  const oracle::NccShape shape = c.shape();
  const auto weights = oracle::ncc_weights(shape);
  const auto t = oracle::sample_template(c.reference, job.template_x_px, job.template_y_px,
                                         job.warp, shape.width, shape.height);
  const int width = 2 * job.radius_x_px + 1, height = 2 * job.radius_y_px + 1;
  Image<double> scores(width, height, -2);
  double best = -2;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      scores(x, y) = oracle::ncc_at(t, c.target, job.window_x_px - job.radius_x_px + x,
                                    job.window_y_px - job.radius_y_px + y, shape, weights)
                         .value_or(-2);
      best = std::max(best, scores(x, y));
    }
  d.best = std::abs(best - result.best_raw);
  constexpr double kSlack = 2e-4;
  int sure = 0, found = 0;
  std::array<bool, 4> explained{};
  for (int y = 1; y < height - 1; ++y)
    for (int x = 1; x < width - 1; ++x) {
      double around = -2, least = 2, values[3][3];
      for (int j = -1; j <= 1; ++j)
        for (int i = -1; i <= 1; ++i) {
          values[j + 1][i + 1] = scores(x + i, y + j);
          least = std::min(least, scores(x + i, y + j));
          if (i != 0 || j != 0) around = std::max(around, scores(x + i, y + j));
        }
      if (least < -1.5) continue;
      const double margin =
          std::min(scores(x, y) - around, scores(x, y) - c.options.peak_quality * best);
      if (margin < -kSlack) continue;
      auto wanted = oracle::quadratic_peak(values);
      const bool has_vertex = wanted.has_value();
      if (!has_vertex) wanted = oracle::Peak{0, 0, scores(x, y), -1, 0, -1};
      const double px = job.window_x_px - job.radius_x_px + x + wanted->x;
      const double py = job.window_y_px - job.radius_y_px + y + wanted->y;
      double nearest = 1e9, bend = 0;
      for (std::size_t k = 0; k < static_cast<std::size_t>(result.count); ++k) {
        const NccPeak& peak = result.peaks[k];
        const double away = std::max({std::abs(peak.x_px - px), std::abs(peak.y_px - py),
                                      std::abs(peak.score - wanted->score)});
        explained[k] = explained[k] || away < 0.5;
        if (away >= nearest) continue;
        nearest = away;
        bend = std::max({std::abs(peak.cxx - wanted->cxx), std::abs(peak.cxy - wanted->cxy),
                         std::abs(peak.cyy - wanted->cyy)});
      }
      if (margin > kSlack) {
        ++sure;
        if (nearest < 0.5) {
          ++found;
          // Flat surfaces magnify rounding: their vertex is compared where it is well defined.
          const double det = wanted->cxx * wanted->cyy - wanted->cxy * wanted->cxy;
          if (det > 1e-4) d.peak = std::max({d.peak, nearest, has_vertex ? 10 * bend : 0});
        }
      }
    }
  d.peaks = found;
  d.lost = std::min(sure, 4) - std::min(found, 4);
  for (std::size_t k = 0; k < static_cast<std::size_t>(result.count); ++k)
    d.wrong += explained[k] ? 0 : 1;
  return d;
}

template <class Pixel>
Difference compare_all(NccMatcher& matcher, const CaseOf<Pixel>& c) {
  const auto results = match(matcher, c);
  Difference worst;
  for (std::size_t i = 0; i < c.jobs.size(); ++i) worst.join(compare(c, c.jobs[i], results[i]));
  return worst;
}

// Many jobs of every shape: inside, over the borders, warped, small and large windows.
template <class Pixel>
CaseOf<Pixel> mixed_case(const Image<Pixel>& image, int template_px, bool gaussian,
                         int template_height_px = 0) {
  CaseOf<Pixel> c;
  c.options.template_px = template_px;
  c.options.template_height_px = template_height_px;
  if (gaussian) c.options.weights = NccWeights::gaussian;
  c.options.align_iterations = 0;
  c.options.peak_quality = 0.6;
  c.reference = image;
  // The target is the reference, moved by (3, -2).
  c.target = Image<Pixel>(image.width(), image.height());
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x)
      c.target(x, y) =
          image(std::clamp(x - 3, 0, image.width() - 1), std::clamp(y + 2, 0, image.height() - 1));
  std::mt19937 random(11);
  const float half = static_cast<float>(std::max(template_px, template_height_px) / 2);
  const auto uniform = [&](float low, float high) {
    return low + (high - low) * static_cast<float>(random() % 10007) / 10007;
  };
  const float margin = 1.5F * half + 1;
  for (int i = 0; i < 24; ++i) {
    const float x = uniform(margin, static_cast<float>(image.width()) - 1 - margin);
    const float y = uniform(margin, static_cast<float>(image.height()) - 1 - margin);
    NccJob job = job_at(i % 3 == 0 ? std::round(x) : x, i % 3 == 0 ? std::round(y) : y,
                        static_cast<int>(x) + 2, static_cast<int>(y) - 1,
                        static_cast<int>(1 + random() % 9), static_cast<int>(1 + random() % 9));
    if (i % 4 == 1)
      for (float& a : job.warp) a += uniform(-0.2F, 0.2F);
    c.jobs.push_back(job);
  }
  return c;
}

// Every way of working, on the device of the tests.
class NccVariants : public ::testing::TestWithParam<NccVariant> {};
std::string name_of(const ::testing::TestParamInfo<NccVariant>& param) {
  return param.param == NccVariant::integer ? "integer"
         : param.param == NccVariant::real  ? "real"
                                            : "group";
}
INSTANTIATE_TEST_SUITE_P(Ncc, NccVariants,
                         ::testing::Values(NccVariant::integer, NccVariant::real,
                                           NccVariant::group),
                         name_of);

/// Integer arithmetic is for 8-bit images.
class NccFloatVariants : public NccVariants {};
INSTANTIATE_TEST_SUITE_P(Ncc, NccFloatVariants,
                         ::testing::Values(NccVariant::real, NccVariant::group), name_of);

TEST_P(NccVariants, AgreesWithTheOracle) {
  auto matcher = make<NccMatcher>("", GetParam());
  for (const auto& [name, image] : test_images(110, 84))
    for (const bool gaussian : {false, true}) {
      const Difference d = compare_all(matcher, mixed_case(image, 11, gaussian));
      EXPECT_LT(d.best, 1e-4) << name << gaussian;
      EXPECT_LT(d.peak, 0.01) << name << gaussian;
      EXPECT_EQ(d.lost, 0) << name << gaussian;
      EXPECT_EQ(d.wrong, 0) << name << gaussian;
      if (name == "natural" || name == "noise") {
        EXPECT_GT(d.peaks, 15) << name << gaussian;
      }
    }
}

TEST_P(NccVariants, AgreesWithTheOracleForEverySizeAndWeight) {
  auto matcher = make<NccMatcher>("", GetParam());
  const GreyImage image = test_images(110, 84)[0].second;
  for (const auto& [size, gaussian] :
       {std::pair{3, false}, {15, false}, {17, false}, {31, false}, {9, true}, {31, true}}) {
    const Difference d = compare_all(matcher, mixed_case(image, size, gaussian));
    EXPECT_LT(d.best, 1e-4) << size << gaussian;
    EXPECT_LT(d.peak, 0.01) << size << gaussian;
    EXPECT_EQ(d.lost, 0) << size << gaussian;
    EXPECT_EQ(d.wrong, 0) << size << gaussian;
    EXPECT_GT(d.peaks, 10) << size << gaussian;
  }
}

// Templates of several images in one call are those of one call for each, whatever the memory.
TEST_P(NccVariants, SeveralReferencesAreAsOneAfterTheOther) {
  auto matcher = make<NccMatcher>("", GetParam());
  const auto images = test_images(110, 84);
  const DeviceImage target = upload(*test_device(), images[0].second);
  const DeviceImage references[] = {target, upload(*test_device(), noise(90, 70)), target};
  std::vector<NccJob> jobs[3];
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 40 + 7 * i; ++k)  // some lie outside: they have no template
      jobs[i].push_back(job_at(static_cast<float>(2 * k) + 0.3F, 30.0F + static_cast<float>(i),
                               2 * k, 30 + i, 6, 5));
  NccOptions options;
  std::vector<NccResult> wanted;
  for (int i = 0; i < 3; ++i)
    for (const NccResult& result : matcher.match(references[i], target, jobs[i], options))
      wanted.push_back(result);
  const NccBatch batches[] = {
      {&references[0], jobs[0]}, {&references[1], jobs[1]}, {&references[2], jobs[2]}};
  for (const std::size_t budget : {std::size_t{64} << 20, std::size_t{20000}}) {
    options.memory_budget_bytes = budget;
    const auto got = matcher.match(batches, target, options);
    ASSERT_EQ(got.size(), wanted.size());
    int peaks = 0;
    for (std::size_t i = 0; i < got.size(); ++i) {
      EXPECT_TRUE(same(got[i], wanted[i])) << i << " budget " << budget;
      peaks += wanted[i].count;
    }
    EXPECT_GT(peaks, 60);
  }
  EXPECT_TRUE(matcher.match(std::span<const NccBatch>(), target, options).empty());
}

TEST_P(NccVariants, TemplatesNeedNotBeSquareNorWeightsSymmetric) {
  auto matcher = make<NccMatcher>("", GetParam());
  const GreyImage image = test_images(110, 84)[0].second;
  for (const auto& [width, height, gaussian] :
       {std::tuple{3, 31, false}, {31, 5, true}, {13, 7, false}}) {
    const Difference d = compare_all(matcher, mixed_case(image, width, gaussian, height));
    EXPECT_LT(d.best, 1e-4) << width << "x" << height;
    EXPECT_LT(d.peak, 0.01) << width << "x" << height;
    EXPECT_EQ(d.lost, 0) << width << "x" << height;
    EXPECT_EQ(d.wrong, 0) << width << "x" << height;
    EXPECT_GT(d.peaks, 5) << width << "x" << height;
  }
  Case c = mixed_case(image, 7, false, 9);
  c.options.weights = NccWeights::separable;
  c.options.weights_x = {1, 2, 3, 9, 2, 5, 0.5};
  c.options.weights_y = {7, 1, 1, 2, 4, 1, 8, 1, 3};
  const Difference d = compare_all(matcher, c);
  EXPECT_LT(d.best, 1e-4);
  EXPECT_LT(d.peak, 0.01);
  EXPECT_EQ(d.lost, 0);
  EXPECT_EQ(d.wrong, 0);
  EXPECT_GT(d.peaks, 10);
}

TEST_P(NccFloatVariants, FloatImagesOfAnyRangeAgreeWithTheOracle) {
  auto matcher = make<NccMatcher>("", GetParam());
  const GreyImage grey = test_images(110, 84)[0].second;
  for (const auto& [scale, offset] :
       {std::pair{1.F, 0.F}, {1 / 255.F, 0.F}, {1e-3F, -7.F}, {3e4F, 1e5F}}) {
    FloatImage image(grey.width(), grey.height());
    for (std::size_t i = 0; i < grey.size(); ++i)
      image.data()[i] = scale * (static_cast<float>(grey.data()[i]) + 0.25F) + offset;
    for (const auto& [size, gaussian] : {std::pair{11, false}, {11, true}, {25, false}}) {
      const Difference d = compare_all(matcher, mixed_case(image, size, gaussian));
      EXPECT_LT(d.best, 1e-4) << scale << " " << size << gaussian;
      EXPECT_LT(d.peak, 0.01) << scale << " " << size << gaussian;
      EXPECT_EQ(d.lost, 0) << scale << " " << size << gaussian;
      EXPECT_EQ(d.wrong, 0) << scale << " " << size << gaussian;
      EXPECT_GT(d.peaks, 10) << scale << " " << size << gaussian;
    }
  }
}

TEST_P(NccFloatVariants, NotANumberInAFloatImageSpoilsOnlyTheFootprintsThatHoldIt) {
  auto matcher = make<NccMatcher>("", GetParam());
  const GreyImage grey = test_images(110, 84)[0].second;
  FloatImage image(grey.width(), grey.height());
  std::copy_n(grey.data(), grey.size(), image.data());
  const DeviceImage reference = upload(*test_device(), image);
  // Among them pixels from which sums of tiles and blocks might start.
  const std::pair<int, int> holes[] = {{60, 40}, {20, 60}, {5, 5}, {37, 37}, {10, 37}};
  for (const auto& [x, y] : holes)
    image(x, y) =
        y == 60 ? std::numeric_limits<float>::infinity() : std::numeric_limits<float>::quiet_NaN();
  const DeviceImage target = upload(*test_device(), image);
  NccScores whole(test_device()), spoilt(test_device());
  const NccJob job = job_at(30, 30, 55, 42, 100, 100);
  for (const NccWeights weights : {NccWeights::uniform, NccWeights::gaussian}) {
    NccOptions options;
    options.weights = weights;
    matcher.score(reference, reference, job, options, whole);
    matcher.score(reference, target, job, options, spoilt);
    const FloatImage a = whole.download(), b = spoilt.download();
    for (int y = 0; y < a.height(); ++y)
      for (int x = 0; x < a.width(); ++x) {
        const int tx = x + spoilt.x_px, ty = y + spoilt.y_px;
        const bool holds = std::any_of(std::begin(holes), std::end(holes), [&](const auto& h) {
          return std::abs(tx - h.first) <= 5 && std::abs(ty - h.second) <= 5;
        });
        if (holds)
          ASSERT_EQ(b(x, y), -2) << tx << " " << ty;
        else
          ASSERT_NEAR(b(x, y), a(x, y), 1e-5) << tx << " " << ty;
      }
    // As a template it has no variance that could be told.
    EXPECT_EQ(matcher.match(target, reference, {{job_at(60, 42, 60, 42, 5, 5)}}, options)[0].count,
              0);
    const auto near =
        matcher.match(reference, target, {{job_at(69, 40, 69, 40, 2, 2)}}, options)[0];
    ASSERT_EQ(near.count, 1);
    EXPECT_NEAR(near.peaks[0].x_px, 69, 0.01);
  }
}

TEST_P(NccFloatVariants, AnOutlierSpoilsOnlyTheFootprintsThatHoldIt) {
  auto matcher = make<NccMatcher>("", GetParam());
  const GreyImage grey = test_images(110, 84)[0].second;
  FloatImage image(grey.width(), grey.height());
  for (std::size_t i = 0; i < grey.size(); ++i)
    image.data()[i] = static_cast<float>(grey.data()[i]) / 255;
  const DeviceImage clean = upload(*test_device(), image);
  image(40, 20) = 1e8F;
  const DeviceImage target = upload(*test_device(), image);
  NccScores whole(test_device()), spoilt(test_device());
  const NccJob job = job_at(30, 60, 55, 42, 15, 17);  // its first candidate is (40, 25)
  matcher.score(clean, clean, job, {}, whole);
  matcher.score(clean, target, job, {}, spoilt);
  const FloatImage a = whole.download(), b = spoilt.download();
  for (int y = 0; y < a.height(); ++y)
    for (int x = 0; x < a.width(); ++x) {
      const int tx = x + spoilt.x_px, ty = y + spoilt.y_px;
      if (std::abs(tx - 40) > 5 || std::abs(ty - 20) > 5) {
        ASSERT_NEAR(b(x, y), a(x, y), 1e-4) << tx << " " << ty;
      }
    }
}

// What is kept of an image serves any later window, and only that image.
TEST_P(NccVariants, KeptDenominatorsAreThoseOfTheImage) {
  const auto images = test_images(110, 84);
  for (const NccWeights weights : {NccWeights::uniform, NccWeights::gaussian}) {
    Case c = mixed_case(images[0].second, 11, weights == NccWeights::gaussian);
    auto kept = make<NccMatcher>("", GetParam());
    const DeviceImage reference = upload(*test_device(), c.reference);
    std::vector<DeviceImage> targets;
    for (int i = 0; i < 11; ++i)
      targets.push_back(
          upload(*test_device(), images[static_cast<std::size_t>(i) % images.size()].second));
    for (const std::size_t i : {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 0, 10, 3})
      for (const std::size_t half : {0, 1}) {  // other windows of the same image the second time
        const std::span<const NccJob> jobs(c.jobs.data() + 12 * half, 12);
        auto fresh = make<NccMatcher>("", GetParam());
        const auto a = kept.match(reference, targets[i], jobs, c.options,
                                  half == 0 ? Lane::tracking : Lane::mapping);
        const auto b = fresh.match(reference, targets[i], jobs, c.options);
        for (std::size_t k = 0; k < jobs.size(); ++k)
          ASSERT_TRUE(same(a[k], b[k])) << i << " " << k;
      }
  }
}

TEST_P(NccVariants, ScoreMapsAgreeWithTheOracle) {
  auto matcher = make<NccMatcher>("", GetParam());
  for (const auto& [name, image] : test_images(90, 70)) {
    for (const bool gaussian : {false, true}) {
      Case c = mixed_case(image, 5, gaussian, 9);
      NccScores scores(test_device());
      for (const NccJob& job : {job_at(30.5F, 30.25F, 45, 35, 100, 100),
                                job_at(40, 20, 50, 30, 17, 2), job_at(40, 20, 50, 30, 0, 3)}) {
        matcher.score(upload(*test_device(), c.reference), upload(*test_device(), c.target), job,
                      c.options, scores);
        const FloatImage map = scores.download();
        ASSERT_GT(map.size(), 0U);
        const auto w = oracle::ncc_weights(c.shape());
        const auto t = oracle::sample_template(c.reference, job.template_x_px, job.template_y_px,
                                               job.warp, 5, 9);
        double worst = 0;
        for (int y = 0; y < map.height(); ++y)
          for (int x = 0; x < map.width(); ++x)
            worst = std::max(worst, std::abs(oracle::ncc_at(t, c.target, x + scores.x_px,
                                                            y + scores.y_px, c.shape(), w)
                                                 .value_or(-2) -
                                             map(x, y)));
        EXPECT_LT(worst, 1e-4) << name << gaussian;
      }
      // A job without candidates has an empty map.
      matcher.score(upload(*test_device(), c.reference), upload(*test_device(), c.target),
                    job_at(-5, 30, 45, 35, 10, 10), c.options, scores);
      EXPECT_TRUE(scores.download().empty());
    }
  }
}

TEST_P(NccVariants, LongStripsAndWholeImagesAgreeWithTheOracle) {
  auto matcher = make<NccMatcher>("", GetParam());
  Case c = mixed_case(test_images(150, 90)[0].second, 7, false);
  c.options.peak_quality = 0.85;
  c.jobs.clear();
  c.jobs.push_back(job_at(60.4F, 40.7F, 75, 38, 75, 10));  // a strip
  c.jobs.push_back(job_at(30, 40, 75, 45, 200, 200));      // everything
  c.jobs.push_back(job_at(100.5F, 60.5F, 75, 45, 70, 45));
  c.jobs.push_back(job_at(50, 30, 53, 28, 6, 6));  // a small one among them
  const Difference d = compare_all(matcher, c);
  EXPECT_LT(d.best, 1e-4);
  EXPECT_LT(d.peak, 0.01);
  EXPECT_EQ(d.lost, 0);
  EXPECT_EQ(d.wrong, 0);
  EXPECT_GE(d.peaks, 4);
}

TEST_P(NccVariants, APlantedFaultIsFound) {
  auto matcher = make<NccMatcher>("-DCORVID_PLANT_FAULT", GetParam());
  const GreyImage image = test_images(110, 84)[0].second;
  EXPECT_GT(compare_all(matcher, mixed_case(image, 11, false)).best, 5e-4);
  EXPECT_GT(compare_all(matcher, mixed_case(image, 9, true)).best, 5e-4);
  Case strips = mixed_case(image, 11, false);
  for (NccJob& job : strips.jobs) job.radius_x_px = 60;
  EXPECT_GT(compare_all(matcher, strips).best, 5e-4);
}

TEST_P(NccVariants, RowsAndColumnsGetParabolas) {
  auto matcher = make<NccMatcher>("", GetParam());
  Case c = mixed_case(test_images(110, 84)[0].second, 11, false);
  c.jobs = {job_at(50, 40, 53, 38, 12, 0), job_at(50, 40, 53, 38, 0, 12),
            job_at(50, 40, 53, 38, 0, 0), job_at(50, 40, 53, 38, 45, 0)};
  const auto results = match(matcher, c);
  const auto t = oracle::sample_template(c.reference, 50, 40, c.jobs[0].warp, 11, 11);
  const auto w = oracle::ncc_weights(c.shape());
  const auto at = [&](int x, int y) { return *oracle::ncc_at(t, c.target, x, y, c.shape(), w); };
  for (const std::size_t i : {0U, 1U, 3U}) {
    ASSERT_GE(results[i].count, 1) << i;
    const NccPeak& peak = results[i].peaks[0];
    const bool row = i != 1;
    const double l = row ? at(52, 38) : at(53, 37), m = at(53, 38),
                 r = row ? at(54, 38) : at(53, 39);
    const double curvature = l + r - 2 * m, offset = -(r - l) / 2 / curvature;
    EXPECT_NEAR(peak.x_px, 53 + (row ? offset : 0), 2e-3);
    EXPECT_NEAR(peak.y_px, 38 + (row ? 0 : offset), 2e-3);
    EXPECT_NEAR(row ? peak.cxx : peak.cyy, curvature, 1e-3);
    EXPECT_EQ(row ? peak.cyy : peak.cxx, 0);
    EXPECT_NEAR(results[i].best_raw, 1, 1e-4);
  }
  // A single candidate is scored but is no maximum.
  EXPECT_EQ(results[2].count, 0);
  EXPECT_NEAR(results[2].best_raw, 1, 1e-4);
}

TEST_P(NccVariants, PeaksAreOrderedAndNegativeDefinite) {
  auto matcher = make<NccMatcher>("", GetParam());
  // A pattern that repeats every 9 px has many peaks: the four best come back.
  Case c;
  c.reference = c.target = paint(140, 100, [](int x, int y) {
    return 128 +
           60 * std::sin(2 * std::numbers::pi * x / 9) * std::cos(2 * std::numbers::pi * y / 9);
  });
  c.options.align_iterations = 8;
  c.jobs = {job_at(60, 50, 60, 50, 15, 15), job_at(60.5F, 50.25F, 60, 50, 40, 40)};
  for (const NccResult& result : match(matcher, c)) {
    ASSERT_EQ(result.count, 4);
    for (std::size_t k = 0; k < 4; ++k) {
      const NccPeak& p = result.peaks[k];
      EXPECT_LT(p.cxx, 0);
      EXPECT_GT(p.cxx * p.cyy - p.cxy * p.cxy, 0);
      EXPECT_LE(p.score, 1);
      if (k > 0) {
        EXPECT_LE(p.score, result.peaks[k - 1].score);
      }
    }
  }
}

TEST_P(NccVariants, ResultsRepeatAndDoNotDependOnTheMemoryBudget) {
  auto matcher = make<NccMatcher>("", GetParam());
  Case c = mixed_case(test_images(150, 90)[0].second, 11, false);
  c.options.align_iterations = 8;
  for (std::size_t i = 0; i < c.jobs.size(); i += 5) c.jobs[i].radius_x_px = 70;
  const auto first = match(matcher, c);
  for (const std::size_t budget :
       {std::size_t{64} << 20, std::size_t{0}, std::size_t{1000}, std::size_t{20000}}) {
    c.options.memory_budget_bytes = budget;
    const auto again = match(matcher, c);
    for (std::size_t i = 0; i < first.size(); ++i) EXPECT_TRUE(same(first[i], again[i])) << i;
  }
  // Nor on the company or the lane.
  c.jobs = {c.jobs[7]};
  EXPECT_TRUE(same(match(matcher, c)[0], first[7]));
  const auto mapping =
      matcher.match(upload(*test_device(), c.reference), upload(*test_device(), c.target), c.jobs,
                    c.options, Lane::mapping);
  EXPECT_TRUE(same(mapping[0], first[7]));
}

TEST_P(NccVariants, HostileJobsGiveNothingAndDisturbNobody) {
  auto matcher = make<NccMatcher>("", GetParam());
  Case c = mixed_case(test_images(110, 84)[0].second, 11, false);
  const NccJob good = job_at(50, 40, 53, 38, 6, 6);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float inf = std::numeric_limits<float>::infinity();
  const int huge = std::numeric_limits<std::int32_t>::max();
  const int tiny = std::numeric_limits<std::int32_t>::min();
  std::vector<NccJob> bad;
  for (const float v : {nan, inf, -inf, 1e30F, -1e30F, 4.9F, 104.5F}) {
    bad.push_back(job_at(v, 40, 53, 38, 6, 6));
    bad.push_back(job_at(50, v == 104.5F ? 79 : v, 53, 38, 6, 6));
    NccJob warped = good;
    warped.warp[1] = std::abs(v) < 1e6F && v < 50 ? 20 : v;
    bad.push_back(warped);
  }
  for (const int v : {huge, tiny, -100, 1000}) {
    bad.push_back(job_at(50, 40, v, 38, 6, 6));
    bad.push_back(job_at(50, 40, 53, v, 6, 6));
  }
  for (const int v : {-1, tiny}) {
    bad.push_back(job_at(50, 40, 53, 38, v, 6));
    bad.push_back(job_at(50, 40, 53, 38, 6, v));
  }
  c.jobs = {good};
  const NccResult wanted = match(matcher, c)[0];
  ASSERT_EQ(wanted.count, 1);
  c.jobs.clear();
  for (const NccJob& job : bad) {
    c.jobs.push_back(job);
    c.jobs.push_back(good);
  }
  const auto results = match(matcher, c);
  for (std::size_t i = 0; i < results.size(); i += 2) {
    EXPECT_EQ(results[i].count, 0) << i / 2;
    EXPECT_EQ(results[i].best_raw, -2) << i / 2;
    EXPECT_TRUE(same(results[i + 1], wanted)) << i / 2;
  }
  EXPECT_TRUE(matcher
                  .match(upload(*test_device(), c.reference), upload(*test_device(), c.target), {},
                         c.options)
                  .empty());
}

TEST_P(NccVariants, HugeWindowsAreTheWholeImage) {
  auto matcher = make<NccMatcher>("", GetParam());
  Case c = mixed_case(test_images(110, 84)[0].second, 11, false);
  const int huge = std::numeric_limits<std::int32_t>::max();
  c.jobs = {job_at(50, 40, 55, 42, 500, 500), job_at(50, 40, 55, 42, huge, huge),
            job_at(50, 40, -huge, huge, huge, huge)};
  const auto results = match(matcher, c);
  EXPECT_TRUE(same(results[0], results[1]));
  ASSERT_GE(results[0].count, 1);
  EXPECT_NEAR(results[0].peaks[0].x_px, 53, 0.2);
  EXPECT_NEAR(results[0].peaks[0].y_px, 38, 0.2);
}

TEST_P(NccVariants, SmallImagesAndTexturelessOnesGiveNothing) {
  auto matcher = make<NccMatcher>("", GetParam());
  for (const auto& [width, height] : {std::pair{11, 11}, {10, 30}, {1, 1}, {12, 12}}) {
    Case c;
    c.reference = c.target = noise(width, height);
    const float x = static_cast<float>(width / 2), y = static_cast<float>(height / 2);
    c.jobs = {job_at(x, y, width / 2, height / 2, 6, 6)};
    const NccResult result = match(matcher, c)[0];
    EXPECT_EQ(result.count, 0) << width;
    EXPECT_EQ(result.best_raw > -2, std::min(width, height) >= 11) << width;
  }
  Case c;
  c.reference = c.target = GreyImage(90, 80, 255);
  c.jobs = {job_at(40, 40, 40, 40, 8, 8), job_at(40.3F, 40.2F, 40, 40, 60, 60)};
  for (const auto& r : match(matcher, c)) EXPECT_EQ(r.count, 0);
  // A textured template in a flat target, and the reverse.
  c.reference = noise(90, 80);
  for (const auto& r : match(matcher, c)) {
    EXPECT_EQ(r.count, 0);
    EXPECT_EQ(r.best_raw, -2);
  }
  std::swap(c.reference, c.target);
  for (const auto& r : match(matcher, c)) EXPECT_EQ(r.count, 0);
}

TEST(Ncc, AMillionJobsRunWithinAMebibyte) {
  auto matcher = make<NccMatcher>();
  Case c = mixed_case(test_images(110, 84)[0].second, 3, false);
  c.options.align_iterations = 0;
  const NccJob job = job_at(50, 40, 53, 38, 1, 1);
  c.jobs = {job};
  const NccResult wanted = match(matcher, c)[0];
  ASSERT_EQ(wanted.count, 1);
  c.jobs.assign(1000000, job);
  c.options.memory_budget_bytes = std::size_t{1} << 20;
  const auto results = match(matcher, c);
  ASSERT_EQ(results.size(), c.jobs.size());
  EXPECT_TRUE(std::all_of(results.begin(), results.end(),
                          [&](const NccResult& r) { return same(r, wanted); }));
}

TEST(Ncc, WrongOptionsAreRefused) {
  auto matcher = make<NccMatcher>();
  const DeviceImage image = upload(*test_device(), noise(64, 64));
  for (const int size : {-1, 0, 1, 2, 10, 33, 1000}) {
    NccOptions options;
    options.template_px = size;
    EXPECT_FALSE(matcher.prepare(options)) << size;
    EXPECT_THROW((void)matcher.match(image, image, {}, options), std::logic_error) << size;
    options.template_px = 11;
    options.template_height_px = size;
    EXPECT_EQ(matcher.prepare(options).has_value(), size == 0) << size;
  }
  const double inf = std::numeric_limits<double>::infinity();
  for (const std::vector<double>& weights :
       {std::vector<double>{}, {1, 2}, {1, 0, 1}, {1, -1, 1}, {1, inf, 1}, {1e-8, 1, 1}}) {
    NccOptions options;
    options.template_px = 3;
    options.weights = NccWeights::separable;
    options.weights_x = {1, 2, 1};
    options.weights_y = weights;
    EXPECT_FALSE(matcher.prepare(options)) << weights.size();
  }
  // Images of two formats cannot be correlated.
  EXPECT_THROW((void)matcher.match(image, upload(*test_device(), FloatImage(64, 64)), {}, {}),
               std::logic_error);
  for (const double quality : {-0.1, 1.1, std::numeric_limits<double>::quiet_NaN()}) {
    NccOptions options;
    options.peak_quality = quality;
    EXPECT_FALSE(matcher.prepare(options)) << quality;
  }
}

}  // namespace
}  // namespace corvid
