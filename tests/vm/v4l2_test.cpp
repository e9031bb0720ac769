#include <gmock/gmock.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <set>

#include "vm/stream_checks.h"
#include "vm/v4l2_controls.h"

namespace corvid::vm {
namespace {

using testing::HasSubstr;

/// The driver vivid: the first node has one plane in a buffer, the second several, the third is for
/// what cannot be undone.
class V4l2 : public GuestTest {
 protected:
  void SetUp() override {
    GuestTest::SetUp();
    if (IsSkipped()) return;
    ASSERT_TRUE(eventually([] { return video_nodes("vivid").size() == 3; }));
    nodes_ = video_nodes("vivid");
  }
  [[nodiscard]] const std::string& single() const { return nodes_[0]; }
  [[nodiscard]] const std::string& multi() const { return nodes_[1]; }
  [[nodiscard]] const std::string& last() const { return nodes_[2]; }

 private:
  std::vector<std::string> nodes_;
};

/// What 100 % colour bars, white, yellow, cyan, green, magenta, red, blue, black, come to.
using Bars = std::array<int, 8>;
constexpr Bars kLimited = {235, 210, 170, 145, 106, 81, 41, 16};  // YUV: BT.601, limited range
constexpr Bars kFromRgb = {255, 226, 179, 150, 105, 76, 29, 0};   // 0.299 R + 0.587 G + 0.114 B
constexpr Bars kLuminance = {255, 237, 201, 182, 73, 54, 18, 0};  // vivid's grey: BT.709

const Bars& expected_bars(const std::string& format) {
  static const std::set<std::string> grey = {"GREY", "Y10 ", "Y12 ", "Y14 ", "Y16 "};
  static const std::set<std::string> yuv = {"YUYV", "YVYU", "UYVY", "VYUY", "NV12", "NV21",
                                            "NM12", "NM21", "YU12", "YV12", "YM12", "YM21"};
  return grey.contains(format) ? kLuminance : yuv.contains(format) ? kLimited : kFromRgb;
}

Bars bars_of(const GreyImage& grey) {
  Bars bars{};
  for (int i = 0; i < 8; ++i) {
    bars[static_cast<std::size_t>(i)] = grey((2 * i + 1) * grey.width() / 16, grey.height() / 2);
  }
  return bars;
}

void expect_bars(const GreyImage& grey, const std::string& format) {
  const Bars bars = bars_of(grey), expected = expected_bars(format);
  for (std::size_t i = 0; i < bars.size(); ++i) EXPECT_NEAR(bars[i], expected[i], 2) << i;
}

/// Captures a picture of vivid's bars in every format that we understand; returns their number.
std::size_t check_every_format(const std::string& node) {
  const ControlPanel panel(node);
  EXPECT_TRUE(panel.choose("Test Pattern", "100% Colorbar"));
  EXPECT_TRUE(panel.choose("OSD Text Mode", "None"));
  const auto listing = listing_of(node);
  if (!listing) {
    ADD_FAILURE() << node << " is not listed";
    return 0;
  }
  std::set<std::string> formats;
  for (const CameraMode& mode : listing->modes) {
    if (mode.note != "not understood") formats.insert(mode.format);
  }
  for (const std::string& format : formats) {
    SCOPED_TRACE(node + " " + format);
    const auto stream = opened(request_of(node, format, 320, 180, 60));
    if (!stream) continue;
    const Capture capture = taken(*stream);
    if (capture.grey.empty()) continue;
    EXPECT_EQ(std::pair(capture.grey.width(), capture.grey.height()), std::pair(320, 180));
    expect_bars(capture.grey, format);
    EXPECT_EQ(stream->counts().damaged, 0u);
  }
  return formats.size();
}

TEST_F(V4l2, EveryFormatOfOnePlaneShowsTheBars) { EXPECT_GE(check_every_format(single()), 30u); }

TEST_F(V4l2, EveryFormatOfMorePlanesShowsTheBars) { EXPECT_GE(check_every_format(multi()), 30u); }

TEST_F(V4l2, DroppedPicturesAreCounted) {
  const ControlPanel panel(single());
  ASSERT_TRUE(panel.set("Percentage of Dropped Buffers", 50));
  const auto stream = opened(request_of(single(), "GREY", 320, 180, 60));
  ASSERT_TRUE(stream);
  const Capture first = taken(*stream);
  Capture last = first;
  for (int i = 0; i < 30; ++i) {
    Capture next = taken(*stream);
    EXPECT_GT(next.sequence, last.sequence);
    EXPECT_GT(next.time_ns, last.time_ns);
    last = std::move(next);
  }
  EXPECT_TRUE(panel.set("Percentage of Dropped Buffers", 0));
  EXPECT_GT(stream->counts().lost, 0u);
  EXPECT_EQ(last.sequence - first.sequence, 30 + stream->counts().lost);
}

TEST_F(V4l2, PicturesThatTheDriverCallsFaultyAreDamaged) {
  for (const std::string& node : {single(), multi()}) {
    const ControlPanel panel(node);
    const auto stream = opened(request_of(node, "NV12", 320, 180, 60));
    ASSERT_TRUE(stream);
    taken(*stream);
    ASSERT_TRUE(panel.set("Inject V4L2_BUF_FLAG_ERROR", 1));
    for (int i = 0; i < 100 && stream->counts().damaged == 0; ++i) taken(*stream);
    ASSERT_EQ(stream->counts().damaged, 1u);
    EXPECT_THAT(stream->counts().messages.at(0), HasSubstr("faulty"));
  }
}

TEST_F(V4l2, AFatalErrorEndsTheStreamAndItOpensAnew) {
  const ControlPanel panel(single());
  {
    const auto stream = opened(request_of(single(), "GREY", 320, 180, 60));
    ASSERT_TRUE(stream);
    taken(*stream);
    ASSERT_TRUE(panel.set("Inject Fatal Streaming Error", 1));
    const Error end = end_of(*stream);
    EXPECT_EQ(end.code, ErrorCode::io);
    EXPECT_THAT(end.to_string(), HasSubstr("the camera's stream broke off: Input/output error"));
    EXPECT_THAT(end.where, HasSubstr(single()));
  }
  const auto again = opened(request_of(single(), "GREY", 320, 180, 60));
  ASSERT_TRUE(again);
  EXPECT_EQ(taken(*again).grey.width(), 320);
}

TEST_F(V4l2, ASourceThatChangesEndsTheStream) {
  const ControlPanel panel(single());
  ASSERT_TRUE(panel.set_input(3));  // HDMI
  {
    const auto stream = opened(request_of(single(), "GREY"));
    ASSERT_TRUE(stream);
    taken(*stream);
    ASSERT_TRUE(panel.choose("DV Timings Signal Mode", "No Signal"));
    EXPECT_THAT(end_of(*stream).to_string(), HasSubstr("has changed at its source"));
  }
  EXPECT_TRUE(panel.choose("DV Timings Signal Mode", "Selected DV Timings"));
  const auto listing = listing_of(single());
  ASSERT_TRUE(listing && !listing->modes.empty());
  EXPECT_THAT(listing->modes[0].note, HasSubstr("sizes from "));
  {
    const auto stream = opened(request_of(single(), "YUYV", 636, 358));
    ASSERT_TRUE(stream);
    EXPECT_EQ(taken(*stream).grey.width(), 636);
  }
  EXPECT_TRUE(panel.set_input(0));
}

TEST_F(V4l2, GainIsSetAndReadBack) {
  const ControlPanel panel(single());
  CameraRequest request = request_of(single(), "GREY", 320, 180, 60);
  request.gain = 77;
  request.exposure_s = 0.01;
  const auto stream = opened(request);
  ASSERT_TRUE(stream);
  EXPECT_EQ(panel.value("Gain"), 77);
  EXPECT_EQ(panel.value("Gain, Automatic"), 0);
  EXPECT_THAT(notes_of(*stream), HasSubstr("the camera has no control for it"));
}

TEST_F(V4l2, RatesAreFractions) {
  const auto stream = opened(request_of(single(), "GREY", 1280, 720, 12.5));  // 2/25 s
  ASSERT_TRUE(stream);
  EXPECT_EQ(stream->settings().rate_hz, 12.5);
  EXPECT_EQ(notes_of(*stream), "");
}

TEST_F(V4l2, TwoCamerasAtOnceAndEachForOne) {
  const auto a = opened(request_of(single(), "GREY", 320, 180, 60));
  const auto b = opened(request_of(multi(), "NM12", 640, 360));
  ASSERT_TRUE(a && b);
  EXPECT_THAT(refused(request_of(single(), "YUYV")).what, HasSubstr("in use"));
  EXPECT_THAT(listing_of(multi())->problem, HasSubstr("in use"));
  EXPECT_EQ(listing_of(last())->problem, "");
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(taken(*a).grey.width(), 320);
    EXPECT_EQ(taken(*b).grey.width(), 640);
  }
}

TEST_F(V4l2, ACameraWithoutPermissionIsListedWithWhatToDo) {
  constexpr uid_t kNobody = 65534;
  ASSERT_EQ(::chmod(single().c_str(), 0600), 0);
  ASSERT_EQ(::seteuid(kNobody), 0);
  const auto listing = listing_of(single());
  const Error error = refused(request_of(single()));
  ASSERT_EQ(::seteuid(0), 0);
  EXPECT_EQ(error.code, ErrorCode::io);
  EXPECT_THAT(error.to_string(), HasSubstr("no permission to open the camera"));
  EXPECT_THAT(error.hint, HasSubstr("group video"));
  ASSERT_TRUE(listing);
  EXPECT_THAT(listing->name, HasSubstr("vivid"));
  EXPECT_EQ(listing->problem, error.to_string());
}

TEST_F(V4l2, ADeviceThatDisappearsEndsTheStream) {
  const auto stream = opened(request_of(last(), "GREY", 320, 180, 60));
  ASSERT_TRUE(stream);
  taken(*stream);
  const std::string node = last();
  ASSERT_TRUE(ControlPanel(node).set("Disconnect", 1));
  EXPECT_THAT(end_of(*stream).to_string(), HasSubstr("the camera is gone"));
}

}  // namespace
}  // namespace corvid::vm
