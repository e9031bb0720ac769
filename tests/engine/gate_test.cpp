#include "engine/gate.h"

#include <gtest/gtest.h>

#include <chrono>
#include <future>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "engine/queue.h"
#include "engine/queue_brake.h"

namespace corvid {
namespace {

struct Pedal final : Brake {
  std::string log;
  void hold() override { log += 'h'; }
  void release() override { log += 'r'; }
};

TEST(Gate, HoldsWhileSomethingUrgentIsUnderWay) {
  Pedal pedal;
  Gate gate(&pedal);
  EXPECT_FALSE(gate.held());
  gate.wait();  // returns at once
  {
    const Gate::Turn turn = gate.enter();
    EXPECT_TRUE(gate.held());
  }
  EXPECT_FALSE(gate.held());
  gate.wait();
  EXPECT_EQ(pedal.log, "hr");
}

TEST(Gate, IsNeverHeldForMoreThanSoManyTurnsInARow) {
  // Frame after frame, the next one always there before the last one is done.
  Gate gate;
  std::optional<Gate::Turn> current = gate.enter();
  int held = 0, longest = 0, free = 0;
  for (int frame = 0; frame < 100; ++frame) {
    if (gate.held()) {
      longest = std::max(longest, ++held);
    } else {
      held = 0;
      ++free;
    }
    Gate::Turn next = gate.enter();
    current = std::move(next);
  }
  EXPECT_EQ(longest, Gate::kHeldTurns);
  EXPECT_EQ(free, 100 / (Gate::kHeldTurns + 1));
  current.reset();
  EXPECT_FALSE(gate.held());
}

TEST(Gate, AMomentOfRestStartsTheCountAnew) {
  Gate gate;
  for (int i = 0; i < 3 * Gate::kHeldTurns; ++i) {
    const Gate::Turn turn = gate.enter();
    EXPECT_TRUE(gate.held()) << i;
  }
}

TEST(Gate, AReleaseGivesASliceHoweverShortItIs) {
  Gate gate;
  std::optional<Gate::Turn> turn = gate.enter();
  auto slice = std::async(std::launch::async, [&] { gate.wait(); });
  while (gate.waiting() == 0) std::this_thread::yield();
  turn.reset();
  turn = gate.enter();  // held again before the other thread can have looked
  EXPECT_EQ(slice.wait_for(std::chrono::seconds(60)), std::future_status::ready);
  EXPECT_TRUE(gate.held());
  gate.open();
}

TEST(Gate, ADroppedFrameGivesItsTurnBack) {
  Gate gate;
  struct Item {
    int value = 0;
    Gate::Turn turn{};
  };
  BoundedQueue<Item> queue(1, QueuePolicy::drop_oldest);
  for (int i = 0; i < 5; ++i) EXPECT_TRUE(queue.push({i, gate.enter()}, {}));
  EXPECT_EQ(queue.dropped(), 4U);
  ASSERT_TRUE(queue.pop({}));
  EXPECT_FALSE(gate.held());
}

TEST(Gate, LetsTheBackgroundGoOnWhenTheTurnEndsOrTheRunStops) {
  for (const bool stopped : {false, true}) {
    Pedal pedal;
    Gate gate(&pedal);
    std::optional<Gate::Turn> turn = gate.enter();
    std::jthread background([&] { gate.wait(); });
    if (stopped) {
      gate.open();
    } else {
      turn.reset();
    }
    background.join();
    EXPECT_EQ(pedal.log, "hr");
    if (!stopped) continue;
    const Gate::Turn late = gate.enter();
    EXPECT_FALSE(gate.held()) << "opened for good";
  }
}

TEST(QueueBrake, HoldsOneQueueAndNotTheOther) {
  auto device = Device::open("auto");
  ASSERT_TRUE(device) << device.error().to_string();
  constexpr int kBefore = 1, kAfter = 2;
  const cl::Buffer buffer((*device)->context(), CL_MEM_READ_WRITE, sizeof(int));
  const auto& mapping = (*device)->queue(Lane::mapping);
  const auto& tracking = (*device)->queue(Lane::tracking);
  const auto read = [&] {
    int value = 0;
    tracking.enqueueReadBuffer(buffer, CL_TRUE, 0, sizeof value, &value);
    return value;
  };
  mapping.enqueueFillBuffer(buffer, kBefore, 0, sizeof(int));
  mapping.finish();
  QueueBrake brake(*device, Lane::mapping);
  for (int round = 0; round < 20; ++round) {
    brake.hold();
    brake.hold();  // no more than held
    cl::Event written;
    mapping.enqueueFillBuffer(buffer, kAfter + round, 0, sizeof(int), nullptr, &written);
    mapping.flush();
    EXPECT_EQ(read(), round == 0 ? kBefore : kAfter + round - 1);
    EXPECT_NE(written.getInfo<CL_EVENT_COMMAND_EXECUTION_STATUS>(), CL_COMPLETE);
    brake.release();
    brake.release();
    mapping.finish();
    EXPECT_EQ(read(), kAfter + round);
  }
}

}  // namespace
}  // namespace corvid
