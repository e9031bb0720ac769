#include "io/mesh_stream.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <set>

namespace corvid {
namespace {

constexpr double kVoxel = 0.0371;
constexpr int kSide = 16;
constexpr double kStep = kVoxel / 16;
using Index = std::array<int, 3>;

/// The sheet z = f(x, y) inside block (i, j, 0), a vertex per voxel, shared borders bit for bit.
MeshBlock sheet(int i, int j, std::uint64_t version, double phase = 0) {
  MeshBlock block{{i, j, 0}, version, kVoxel, kSide, {}};
  for (int y = 0; y <= kSide; ++y) {
    for (int x = 0; x <= kSide; ++x) {
      const double gx = i * kSide + x, gy = j * kSide + y;
      const double z = 8 + 5 * std::sin(0.31 * gx + phase) * std::cos(0.17 * gy);
      block.mesh.vertices.emplace_back((Eigen::Vector3d(gx, gy, z) * kVoxel).cast<float>());
      block.mesh.normals.emplace_back(0, 0, 1);
      block.mesh.colours.push_back({static_cast<std::uint8_t>(x * 9), 7, 200});
    }
  }
  for (std::uint32_t y = 0; y < kSide; ++y) {
    for (std::uint32_t x = 0; x < kSide; ++x) {
      const std::uint32_t a = x + (kSide + 1) * y, b = a + kSide + 1;
      block.mesh.triangles.push_back({a, a + 1, b});
      block.mesh.triangles.push_back({a + 1, b + 1, b});
    }
  }
  return block;
}

MeshBlock removal(int i, int j, std::uint64_t version) {
  return {{i, j, 0}, version, kVoxel, kSide, {}};
}

/// What a client shows: every packet goes through its bytes.
struct Client {
  std::map<Index, TriangleMesh> blocks;
  std::map<Index, std::uint64_t> versions;
  std::size_t bytes = 0, removals = 0;

  void take(const std::vector<MeshPacket>& packets) {
    for (const MeshPacket& sent : packets) {
      const std::string wire = encode_packet(sent);
      bytes += wire.size();
      const auto packet = decode_packet(wire);
      ASSERT_TRUE(packet) << packet.error().to_string();
      EXPECT_GE(packet->version, versions[packet->index]);
      versions[packet->index] = packet->version;
      auto mesh = decode_mesh(*packet);
      ASSERT_TRUE(mesh) << mesh.error().to_string();
      if (mesh->empty()) {
        EXPECT_EQ(blocks.erase(packet->index), 1U) << "removed, but it was never sent";
        ++removals;
      } else {
        blocks[packet->index] = *mesh;
      }
    }
  }
};

bool same(const TriangleMesh& a, const TriangleMesh& b) {
  return a.vertices == b.vertices && a.normals == b.normals && a.colours == b.colours &&
         a.triangles == b.triangles;
}

double farthest(const TriangleMesh& from, const TriangleMesh& to) {
  double worst = 0;
  for (const auto& v : from.vertices) {
    double best = 1e9;
    for (const auto& w : to.vertices) best = std::min<double>(best, (v - w).norm());
    worst = std::max(worst, best);
  }
  return worst;
}

TEST(MeshStream, DecodedBlocksAreTheMeshWithinTheLatticeAndMeetExactly) {
  MeshStream stream;
  const auto receiver = stream.join();
  std::map<Index, TriangleMesh> live;
  for (int j = -1; j <= 1; ++j) {
    for (int i = -2; i <= 1; ++i) {
      const MeshBlock block = sheet(i, j, 1);
      live[block.index] = block.mesh;
      stream.on_block(block);
    }
  }
  Client client;
  client.take(receiver->next(1 << 30));
  ASSERT_EQ(client.blocks.size(), live.size());
  std::map<Index, std::set<std::array<float, 3>>> points;
  for (const auto& [index, mesh] : client.blocks) {
    EXPECT_EQ(mesh.triangles.size(), live[index].triangles.size());
    const double bound = kStep * std::sqrt(0.75) * 1.001;
    EXPECT_LE(farthest(mesh, live[index]), bound);
    EXPECT_LE(farthest(live[index], mesh), bound);
    for (const auto& v : mesh.vertices) points[index].insert({v.x(), v.y(), v.z()});
  }
  for (int j = -1; j <= 1; ++j) {
    for (int i = -2; i < 1; ++i) {
      int shared = 0;
      for (const auto& p : points[{i, j, 0}]) shared += points[{i + 1, j, 0}].contains(p) ? 1 : 0;
      EXPECT_EQ(shared, kSide + 1) << "blocks " << i << " and " << i + 1;
    }
  }
  const MeshStreamStatistics s = stream.statistics();
  EXPECT_EQ(s.encoded, 12U);
  EXPECT_EQ(s.failed, 0U);
  EXPECT_LT(static_cast<double>(s.bytes), 8.0 * static_cast<double>(s.triangles));
}

TEST(MeshStream, ALateReceiverGetsWhatAnEarlyOneHas) {
  MeshStream stream;
  const auto early = stream.join();
  Client early_client, late_client;
  std::mt19937 random(3);
  for (std::uint64_t version = 1; version <= 200; ++version) {
    const int i = static_cast<int>(random() % 5), j = static_cast<int>(random() % 5);
    stream.on_block(random() % 3 == 0 ? removal(i, j, version)
                                      : sheet(i, j, version, static_cast<double>(version)));
    early_client.take(early->next(random() % 3000));
  }
  const auto late = stream.join();
  for (int rest = 0; rest < 300; ++rest) {
    early_client.take(early->next(900));
    late_client.take(late->next(700));
  }
  EXPECT_TRUE(early->up_to_date());
  EXPECT_TRUE(late->up_to_date());
  EXPECT_GT(early_client.removals, 5U);
  EXPECT_EQ(late_client.removals, 0U);
  ASSERT_EQ(early_client.blocks.size(), late_client.blocks.size());
  ASSERT_GT(late_client.blocks.size(), 5U);
  for (const auto& [index, mesh] : late_client.blocks)
    EXPECT_TRUE(same(mesh, early_client.blocks.at(index)));
}

TEST(MeshStream, ASlowReceiverCostsNoMoreThanTheMapAndNobodyStarves) {
  MeshStreamOptions options;
  options.max_waiting_bytes = 100000;
  MeshStream stream(options);
  const auto slow = stream.join();
  Client client;
  std::size_t most = 0;
  // Block (0, 0) changes all the time; the others once, before it does so again.
  for (std::uint64_t version = 1; version <= 300; ++version) {
    stream.on_block(sheet(static_cast<int>(version % 6), 1, version, 0.01 * version));
    stream.on_block(sheet(0, 0, version, 0.02 * version));
    if (version % 10 == 0) client.take(slow->next(1));  // one block
    most = std::max(most, stream.kept_bytes());
  }
  // One block of 512 triangles waits with about 14 kB, or takes 2 kB when compressed.
  EXPECT_LT(most, 100000U + 7 * 4000U);
  EXPECT_EQ(client.versions.size(), 7U) << "every block came at least once";
  EXPECT_GT((client.versions[{0, 0, 0}]), 200U) << "the one that changes always came again";
  const MeshStreamStatistics s = stream.statistics();
  EXPECT_EQ(s.changes, 600U);
  EXPECT_LE(s.encoded, 200U) << "what was replaced before it was sent is not compressed";
}

TEST(MeshStream, BudgetsHoldOverTime) {
  ByteAllowance allowance(1000, 0);
  EXPECT_EQ(allowance.available(0), 0U);
  EXPECT_EQ(allowance.available(500'000'000), 500U);
  allowance.spend(2500);  // one large packet
  EXPECT_EQ(allowance.available(2'000'000'000), 0U);
  EXPECT_EQ(allowance.available(3'000'000'000), 500U);
  EXPECT_EQ(allowance.available(60'000'000'000), 1000U) << "saved for a second at most";
}

TEST(MeshStream, RemovalsAreOfTheNewestVersionAndOnlyForThoseWhoHadTheBlock) {
  MeshStream stream;
  const auto receiver = stream.join();
  stream.on_block(sheet(0, 0, 1));
  stream.on_block(removal(0, 0, 2));
  EXPECT_TRUE(receiver->next(1 << 20).empty());
  stream.on_block(sheet(0, 0, 3));
  Client client;
  client.take(receiver->next(1 << 20));
  stream.on_block(removal(0, 0, 4));
  const auto late = stream.join();
  EXPECT_TRUE(late->next(1 << 20).empty());
  const auto packets = receiver->next(1);
  ASSERT_EQ(packets.size(), 1U);
  EXPECT_EQ(packets[0].version, 4U);
  EXPECT_FALSE(packets[0].draco);
  client.take(packets);
  EXPECT_TRUE(client.blocks.empty());
}

TEST(MeshStream, ASnapshotIsTheLastCompleteVersion) {
  MeshStream stream;
  const auto versions = [&] {  // by block
    std::map<int, std::uint64_t> found;
    for (const MeshPacket& packet : stream.snapshot())
      EXPECT_TRUE(found.emplace(packet.index[0], packet.version).second) << "twice";
    return found;
  };
  using Found = std::map<int, std::uint64_t>;
  stream.on_block(sheet(0, 0, 1));
  EXPECT_TRUE(stream.snapshot().empty()) << "nothing was complete yet";
  stream.on_block(sheet(1, 0, 1));
  stream.on_complete(1);
  const std::size_t bytes = stream.kept_bytes();
  EXPECT_EQ(versions(), (Found{{0, 1}, {1, 1}}));
  stream.on_block(removal(0, 0, 2));
  stream.on_block(sheet(1, 0, 2, 0.1));
  stream.on_block(sheet(1, 0, 3, 0.2));
  stream.on_block(sheet(2, 0, 3));
  EXPECT_EQ(versions(), (Found{{0, 1}, {1, 1}}));
  EXPECT_EQ(stream.kept_bytes(), 2 * bytes);
  stream.on_complete(3);
  EXPECT_EQ(versions(), (Found{{1, 3}, {2, 3}}));
  EXPECT_EQ(stream.kept_bytes(), bytes);
  // All is taken away and comes back in other voxels.
  for (const int i : {1, 2}) stream.on_block(removal(i, 0, 4));
  EXPECT_EQ(versions(), (Found{{1, 3}, {2, 3}}));
  stream.on_block(sheet(1, 0, 5));
  EXPECT_EQ(versions(), (Found{{1, 3}, {2, 3}}));
  stream.on_complete(5);
  EXPECT_EQ(versions(), (Found{{1, 5}}));
}

TEST(MeshStream, BlocksThatCannotBeSentAreCountedNotAFault) {
  MeshStream stream;
  const auto receiver = stream.join();
  MeshBlock outside = sheet(0, 0, 1);
  outside.mesh.vertices[0].x() = 1000;
  stream.on_block(outside);
  MeshBlock dust = sheet(1, 0, 1);  // without extent on the lattice
  for (auto& v : dust.mesh.vertices) v = Eigen::Vector3f(kSide * 1.5F, 1, 1) * float(kVoxel);
  stream.on_block(dust);
  EXPECT_TRUE(receiver->next(1 << 20).empty());
  EXPECT_TRUE(receiver->up_to_date());
  EXPECT_EQ(stream.statistics().failed, 1U);
}

TEST(MeshStream, WrongPacketsAreErrors) {
  MeshStream stream;
  const auto receiver = stream.join();
  stream.on_block(sheet(0, 0, 1));
  const std::string wire = encode_packet(receiver->next(1)[0]);
  ASSERT_TRUE(decode_packet(wire));
  for (std::size_t n = 0; n < wire.size(); n += 13)
    EXPECT_EQ(decode_packet(std::string_view(wire).substr(0, n)).error().code, ErrorCode::corrupt);
  std::string bad = wire;
  bad[0] = 'X';
  EXPECT_FALSE(decode_packet(bad));
  bad = wire;
  std::fill(bad.begin() + 24, bad.begin() + 32, '\xff');  // voxel size: NaN
  EXPECT_FALSE(decode_packet(bad));
  bad = wire;
  std::fill(bad.begin() + 44, bad.end(), '\x55');
  const auto packet = decode_packet(bad);
  ASSERT_TRUE(packet);
  EXPECT_FALSE(decode_mesh(*packet));
}

}  // namespace
}  // namespace corvid
