#include "engine/queue.h"

#include <gtest/gtest.h>

#include <numeric>
#include <thread>
#include <vector>

#include "engine/latest.h"

namespace corvid {
namespace {

TEST(BoundedQueue, BlockingLosesNothingAndKeepsOrder) {
  BoundedQueue<int> queue(2, QueuePolicy::block);
  std::jthread producer([&](const std::stop_token& stop) {
    for (int i = 0; i < 1000; ++i) ASSERT_TRUE(queue.push(i, stop));
    queue.close();
  });
  std::vector<int> got;
  while (auto item = queue.pop({})) got.push_back(*item);
  std::vector<int> expected(1000);
  std::iota(expected.begin(), expected.end(), 0);
  EXPECT_EQ(got, expected);
  EXPECT_EQ(queue.dropped(), 0U);
}

TEST(BoundedQueue, DropOldestKeepsTheNewestAndCounts) {
  BoundedQueue<int> queue(3, QueuePolicy::drop_oldest);
  for (int i = 0; i < 10; ++i) EXPECT_TRUE(queue.push(i, {}));
  EXPECT_EQ(queue.dropped(), 7U);
  queue.close();
  EXPECT_EQ(queue.pop({}), 7);
  EXPECT_EQ(queue.pop({}), 8);
  EXPECT_EQ(queue.pop({}), 9);
  EXPECT_FALSE(queue.pop({}));
  EXPECT_FALSE(queue.push(1, {}));
}

TEST(BoundedQueue, StopWakesBothSides) {
  BoundedQueue<int> full(1, QueuePolicy::block), empty(1, QueuePolicy::block);
  ASSERT_TRUE(full.push(1, {}));
  std::stop_source stop;
  bool pushed = true, popped = true;
  std::jthread producer([&] { pushed = full.push(2, stop.get_token()); });
  std::jthread consumer([&] { popped = empty.pop(stop.get_token()).has_value(); });
  stop.request_stop();
  producer.join();
  consumer.join();
  EXPECT_FALSE(pushed);
  EXPECT_FALSE(popped);
}

TEST(Latest, WaitSeesTheNewestAndEndsOnClose) {
  Latest<int> latest;
  EXPECT_EQ(latest.get(), nullptr);
  std::uint64_t seen = 0;
  latest.publish(std::make_shared<int>(1));
  latest.publish(std::make_shared<int>(2));
  EXPECT_EQ(*latest.wait(seen, {}), 2);
  std::jthread closer([&] { latest.close(); });
  EXPECT_EQ(latest.wait(seen, {}), nullptr);
}

TEST(Latest, APublishedValueIsSeenBeforeTheClose) {
  Latest<int> latest;
  std::uint64_t seen = 0;
  latest.publish(std::make_shared<int>(3));
  latest.close();
  EXPECT_EQ(*latest.wait(seen, {}), 3);
  EXPECT_EQ(latest.wait(seen, {}), nullptr);
}

}  // namespace
}  // namespace corvid
