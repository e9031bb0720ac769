#include "vm/guest.h"

namespace corvid::vm {
namespace {

using V4l2 = GuestTest;

TEST_F(V4l2, VividHasOneNodeWithOnePlaneAndOneWithMore) {
  EXPECT_TRUE(eventually([] { return video_nodes("vivid").size() == 2; }));
}

}  // namespace
}  // namespace corvid::vm
