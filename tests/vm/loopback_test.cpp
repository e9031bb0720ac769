#include <gmock/gmock.h>

#include "vm/loopback_writer.h"
#include "vm/numbered_picture.h"
#include "vm/stream_checks.h"

namespace corvid::vm {
namespace {

using testing::HasSubstr;

class Loopback : public GuestTest {
 protected:
  void SetUp() override {
    GuestTest::SetUp();
    if (IsSkipped()) return;
    ASSERT_EQ(video_nodes("Loopback").size(), 1u);
    node_ = video_nodes("Loopback")[0];
  }
  [[nodiscard]] static bool write(const LoopbackWriter& writer, std::uint32_t number) {
    const auto luma = numbered_picture(320, 240, number);
    return writer.write(luma.data(), luma.size());
  }

  std::string node_;
};

TEST_F(Loopback, HandsOnWhatIsWrittenAndCountsWhatWasPassedOver) {
  const Error silent = refused(request_of(node_));
  EXPECT_EQ(silent.code, ErrorCode::unsupported);
  EXPECT_THAT(silent.hint, HasSubstr("start the program that writes"));
  EXPECT_FALSE(listing_of(node_));

  const LoopbackWriter writer(node_, 320, 240);
  ASSERT_TRUE(write(writer, 0));
  const auto stream = opened(request_of(node_));
  ASSERT_TRUE(stream);
  EXPECT_EQ(stream->settings().format, "GREY");
  EXPECT_EQ(stream->settings().width_px, 320);
  EXPECT_THAT(notes_of(*stream), HasSubstr("times are those of their arrival"));
  EXPECT_EQ(listing_of(node_)->problem, "");

  Capture last = taken(*stream);
  for (std::uint32_t number = 1; number < 70; ++number) {
    ASSERT_TRUE(write(writer, number));
    if (number > 20 && number < 50) continue;  // the writer runs ahead of what the driver keeps
    Capture capture = taken(*stream);
    EXPECT_EQ(number_in(capture.grey.data(), 320), number);
    EXPECT_EQ(capture.sequence, number);
    EXPECT_EQ(capture.grey(300, 200), numbered_luma(300, 200, number));
    EXPECT_GT(capture.time_ns, last.time_ns);
    last = std::move(capture);
  }
  EXPECT_EQ(stream->counts().lost, 29u);
  EXPECT_EQ(stream->counts().damaged, 0u);
}

}  // namespace
}  // namespace corvid::vm
