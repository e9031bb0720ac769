#include <gmock/gmock.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <optional>

#include "kernels/ncc.h"
#include "kernels/test_device.h"
#include "kernels/textures.h"
#include "kernels/tuning.h"
#include "oracle/ncc.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;

template <class Pixel>
Image<Pixel> moved(const Image<Pixel>& image, int dx, int dy) {
  Image<Pixel> out(image.width(), image.height());
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x)
      out(x, y) = image(std::clamp(x - dx, 0, image.width() - 1),
                        std::clamp(y - dy, 0, image.height() - 1));
  return out;
}

// All candidates of the target; the template off the pixel grid and turned.
NccJob whole_image(float x, float y) {
  NccJob job;
  job.template_x_px = x;
  job.template_y_px = y;
  job.warp[1] = -0.1F;
  job.warp[2] = 0.1F;
  job.window_x_px = job.window_y_px = 100;
  job.radius_x_px = job.radius_y_px = 1000;
  return job;
}

struct Shape {
  int width, height;
  NccWeights weights;
  [[nodiscard]] NccOptions options() const {
    NccOptions options;
    options.template_px = width;
    options.template_height_px = height;
    options.weights = weights;
    return options;
  }
};

// Largest difference from the definition, of every third candidate.
template <class Pixel>
double worst_difference(const FloatImage& map, const Image<Pixel>& reference,
                        const Image<Pixel>& target, const NccJob& job, const Shape& s) {
  const auto shape = oracle::ncc_shape(s.width, s.height, s.weights == NccWeights::gaussian);
  const auto w = oracle::ncc_weights(shape);
  const auto t = oracle::sample_template(reference, job.template_x_px, job.template_y_px, job.warp,
                                         s.width, s.height);
  double worst = 0;
  for (int y = 0; y < map.height(); ++y)
    for (int x = y % 3; x < map.width(); x += 3)
      worst = std::max(
          worst,
          std::abs(
              oracle::ncc_at(t, target, x + s.width / 2, y + s.height / 2, shape, w).value_or(-2) -
              map(x, y)));
  return worst;
}

TEST(NccDense, FrequencyMapsAgreeWithTheOracle) {
  auto matcher = make<NccMatcher>("", NccVariant::frequency);
  NccScores scores(test_device());
  for (const auto& [name, image] : test_images(150, 110))
    for (const Shape& s :
         {Shape{11, 11, NccWeights::uniform}, Shape{31, 17, NccWeights::uniform}}) {
      const GreyImage target = moved(image, 3, -2);
      const NccJob job = whole_image(70.4F, 40.3F);
      matcher.score(upload(*test_device(), image), upload(*test_device(), target), job, s.options(),
                    scores);
      const FloatImage map = scores.download();
      ASSERT_EQ(map.width(), 150 - s.width + 1);
      ASSERT_EQ(map.height(), 110 - s.height + 1);
      EXPECT_LT(worst_difference(map, image, target, job, s), 1e-4) << name << s.width;
    }
}

TEST(NccDense, FrequencyMapsOfFloatImagesAgreeWithTheOracle) {
  auto matcher = make<NccMatcher>("", NccVariant::frequency);
  NccScores scores(test_device());
  const GreyImage grey = test_images(150, 110)[0].second;
  for (const auto& [scale, offset] : {std::pair{1.F, 0.F}, {1e-3F, -7.F}, {3e4F, 1e5F}}) {
    FloatImage image(grey.width(), grey.height());
    for (std::size_t i = 0; i < grey.size(); ++i)
      image.data()[i] = scale * (static_cast<float>(grey.data()[i]) + 0.25F) + offset;
    const FloatImage target = moved(image, 3, -2);
    for (const Shape& s :
         {Shape{11, 11, NccWeights::uniform}, Shape{31, 31, NccWeights::gaussian}}) {
      const NccJob job = whole_image(70.4F, 50.3F);
      matcher.score(upload(*test_device(), image), upload(*test_device(), target), job, s.options(),
                    scores);
      EXPECT_LT(worst_difference(scores.download(), image, target, job, s), 1e-4) << scale;
    }
  }
}

// What the transforms cannot do is done in the spatial way, inside one map.
TEST(NccDense, PixelsThatAreNotFiniteSpoilOnlyTheFootprintsThatHoldThem) {
  auto matcher = make<NccMatcher>("", NccVariant::frequency);
  const GreyImage grey = test_images(400, 300)[0].second;
  FloatImage image(grey.width(), grey.height());
  std::copy_n(grey.data(), grey.size(), image.data());
  const DeviceImage reference = upload(*test_device(), image);
  image(60, 40) = std::numeric_limits<float>::quiet_NaN();
  image(350, 260) = -std::numeric_limits<float>::infinity();
  const DeviceImage target = upload(*test_device(), image);
  NccScores whole(test_device()), spoilt(test_device());
  const NccJob job = whole_image(200, 100);
  for (const NccWeights weights : {NccWeights::uniform, NccWeights::gaussian}) {
    const NccOptions options = Shape{11, 11, weights}.options();
    matcher.score(reference, reference, job, options, whole);
    matcher.score(reference, target, job, options, spoilt);
    const FloatImage a = whole.download(), b = spoilt.download();
    for (int y = 0; y < a.height(); ++y)
      for (int x = 0; x < a.width(); ++x) {
        const int tx = x + spoilt.x_px, ty = y + spoilt.y_px;
        const bool holds = (std::abs(tx - 60) <= 5 && std::abs(ty - 40) <= 5) ||
                           (std::abs(tx - 350) <= 5 && std::abs(ty - 260) <= 5);
        if (holds)
          ASSERT_EQ(b(x, y), -2) << tx << " " << ty;
        else
          ASSERT_NEAR(b(x, y), a(x, y), 1e-4) << tx << " " << ty;
      }
  }
}

TEST(NccDense, TemplatesWithoutVarianceAndWindowsOfAnySize) {
  auto matcher = make<NccMatcher>("", NccVariant::frequency);
  const GreyImage image = test_images(150, 110)[0].second;
  const DeviceImage flat = upload(*test_device(), GreyImage(150, 110, 77));
  const DeviceImage reference = upload(*test_device(), image);
  NccScores scores(test_device());
  matcher.score(flat, reference, whole_image(70, 50), {}, scores);
  FloatImage map = scores.download();
  ASSERT_EQ(map.size(), 140U * 100U);
  EXPECT_EQ(*std::max_element(map.data(), map.data() + map.size()), -2);
  matcher.score(reference, flat, whole_image(70, 50), {}, scores);
  map = scores.download();
  ASSERT_EQ(map.size(), 140U * 100U);
  EXPECT_EQ(*std::max_element(map.data(), map.data() + map.size()), -2);
  for (const float x : {-5.F, std::numeric_limits<float>::quiet_NaN(), 149.F}) {
    matcher.score(reference, reference, whole_image(x, 50), {}, scores);
    EXPECT_TRUE(scores.download().empty());
  }
  NccJob one = whole_image(70, 50);
  one.warp[1] = one.warp[2] = 0;
  one.window_x_px = 70;
  one.window_y_px = 50;
  one.radius_x_px = one.radius_y_px = 0;
  matcher.score(reference, reference, one, {}, scores);
  map = scores.download();
  ASSERT_EQ(map.size(), 1U);
  EXPECT_NEAR(map(0, 0), 1, 1e-4);
}

TEST(NccDense, APlantedFaultIsFound) {
  auto matcher = make<NccMatcher>("-DCORVID_PLANT_FAULT", NccVariant::frequency);
  const GreyImage image = test_images(150, 110)[0].second;
  NccScores scores(test_device());
  const Shape s{11, 11, NccWeights::uniform};
  const NccJob job = whole_image(70.4F, 50.3F);
  matcher.score(upload(*test_device(), image), upload(*test_device(), image), job, s.options(),
                scores);
  EXPECT_GT(worst_difference(scores.download(), image, image, job, s), 5e-4);
}

// Ways are chosen by measurement, once per device and kind of job.
class NccDenseChoice : public ::testing::Test {
 protected:
  void SetUp() override {
    if (test_device()->info().gpu) GTEST_SKIP() << "a GPU has one way";
    std::string name = (fs::temp_directory_path() / "corvid_dense_XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
    if (const char* old = std::getenv("XDG_CACHE_HOME")) old_ = old;
    setenv("XDG_CACHE_HOME", name.c_str(), 1);
    unsetenv("CORVID_TUNING");
  }
  void TearDown() override {
    if (folder_.empty()) return;
    if (old_)
      setenv("XDG_CACHE_HOME", old_->c_str(), 1);
    else
      unsetenv("XDG_CACHE_HOME");
    unsetenv("CORVID_TUNING");
    fs::remove_all(folder_);
  }
  static std::shared_ptr<Device> fresh_device() {
    return *Device::open(std::to_string(test_device()->info().index));
  }
  static FloatImage map_of(const std::shared_ptr<Device>& device, NccVariant variant,
                           const GreyImage& image, const NccOptions& options, int radius = 1000) {
    auto matcher = NccMatcher::create(device, "", variant);
    if (!matcher) throw std::runtime_error(matcher.error().to_string());
    NccScores scores(device);
    NccJob job = whole_image(100.25F, 90.5F);
    job.radius_x_px = job.radius_y_px = radius;
    matcher->score(upload(*device, image), upload(*device, image), job, options, scores);
    return scores.download();
  }
  static std::string read(const fs::path& path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  }
  static double difference(const FloatImage& a, const FloatImage& b) {
    if (a.width() != b.width() || a.height() != b.height() || a.empty()) return 9;
    double worst = 0;
    for (std::size_t i = 0; i < a.size(); ++i)
      worst = std::max(worst, std::abs(double{a.data()[i]} - b.data()[i]));
    return worst;
  }

  fs::path folder_;
  std::optional<std::string> old_;
};

TEST_F(NccDenseChoice, AllWaysAgreeAndTheChosenOneIsOneOfThem) {
  const GreyImage image = test_images(220, 200)[0].second;
  const NccOptions options = Shape{17, 11, NccWeights::uniform}.options();
  const auto device = fresh_device();
  const FloatImage integer = map_of(device, NccVariant::integer, image, options);
  const FloatImage real = map_of(device, NccVariant::real, image, options);
  const FloatImage frequency = map_of(device, NccVariant::frequency, image, options);
  EXPECT_LT(difference(integer, real), 2e-5);
  EXPECT_LT(difference(real, frequency), 1e-4);
  EXPECT_FALSE(fs::exists(device->tuning().file()));  // nothing to choose so far
  const FloatImage chosen = map_of(device, NccVariant::by_device, image, options);
  EXPECT_TRUE(chosen == integer || chosen == real || chosen == frequency);
  const std::string file = read(device->tuning().file());
  EXPECT_THAT(file, testing::HasSubstr("17x11 uniform grey8"));
  EXPECT_THAT(file, testing::HasSubstr("\"frequency\":"));
  // Another process would find it.
  EXPECT_EQ(map_of(fresh_device(), NccVariant::by_device, image, options), chosen);
  EXPECT_EQ(read(device->tuning().file()), file);
}

TEST_F(NccDenseChoice, AKeptChoiceIsFollowed) {
  const GreyImage image = test_images(220, 200)[0].second;
  const NccOptions options = Shape{13, 13, NccWeights::uniform}.options();
  const auto device = fresh_device();
  (void)map_of(device, NccVariant::by_device, image, options);
  setenv("CORVID_TUNING", "off", 1);
  const FloatImage space = map_of(fresh_device(), NccVariant::by_device, image, options);
  unsetenv("CORVID_TUNING");
  const FloatImage frequency = map_of(device, NccVariant::frequency, image, options);
  ASSERT_NE(space, frequency);
  const std::string file = read(device->tuning().file());
  const std::size_t at = file.find("\"choice\": \"");
  ASSERT_NE(at, std::string::npos);
  for (const auto& [name, wanted] : {std::pair{"space", &space}, {"frequency", &frequency}}) {
    std::string other = file;
    const std::size_t begin = at + 11, end = other.find('"', begin);
    other.replace(begin, end - begin, name);
    std::ofstream(device->tuning().file(), std::ios::binary) << other;
    EXPECT_EQ(map_of(fresh_device(), NccVariant::by_device, image, options), *wanted) << name;
  }
}

TEST_F(NccDenseChoice, NothingIsMeasuredForSmallWindowsOrTemplatesNorWhenTuningIsOff) {
  const GreyImage image = test_images(220, 200)[0].second;
  const auto device = fresh_device();
  (void)map_of(device, NccVariant::by_device, image, {});
  EXPECT_FALSE(fs::exists(device->tuning().file()));
  const NccOptions options = Shape{13, 13, NccWeights::uniform}.options();
  const FloatImage small = map_of(device, NccVariant::by_device, image, options, 60);
  EXPECT_EQ(small.size(), 121U * 121U);
  EXPECT_FALSE(fs::exists(device->tuning().file()));
  setenv("CORVID_TUNING", "off", 1);
  const auto untuned = fresh_device();
  const FloatImage map = map_of(untuned, NccVariant::by_device, image, options);
  EXPECT_FALSE(fs::exists(device->tuning().file()));
  // The static choice, as match() takes it.
  EXPECT_TRUE(map == map_of(untuned, NccVariant::integer, image, options) ||
              map == map_of(untuned, NccVariant::real, image, options));
}

}  // namespace
}  // namespace corvid
