#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "corvid/error.h"
#include "corvid/mesh_stream.h"
#include "corvid/ports.h"

namespace corvid {

/// What goes over the wire of one mesh block: docs/formats.md, "Mesh stream".
struct MeshPacket {
  std::array<int, 3> index{};
  std::uint64_t version = 0;
  double voxel_size = 0;                     ///< [map units]
  int side_vox = 0;                          ///< voxels along an edge of the block
  int steps_per_voxel = 0;                   ///< of the lattice on which vertices lie
  std::shared_ptr<const std::string> draco;  ///< null: the block is removed
};

/// Of the packet as a message.
[[nodiscard]] std::size_t packet_bytes(const MeshPacket& packet);
/// The packet as one binary message.
[[nodiscard]] std::string encode_packet(const MeshPacket& packet);
/// Errors: corrupt.
[[nodiscard]] Expected<MeshPacket> decode_packet(std::string_view bytes);
/// The block's surface, in map units; empty if it is removed. A vertex is a function of its lattice
/// point alone, so blocks that meet share it bit for bit. Errors: corrupt.
[[nodiscard]] Expected<TriangleMesh> decode_mesh(const MeshPacket& packet);

struct MeshStreamOptions {
  int steps_per_voxel = 16;                    ///< lattice steps per voxel, 1 to 256
  int draco_speed = 7;                         ///< 0 small and slow to 10 fast (Draco's scale)
  int normal_bits = 8;                         ///< octahedral
  std::size_t max_waiting_bytes = 32UL << 20;  ///< of blocks that nobody has asked for yet
};

struct MeshStreamStatistics {
  std::uint64_t changes = 0;    ///< blocks that came in, removals included
  std::uint64_t encoded = 0;    ///< blocks compressed; others were replaced before they were sent
  std::uint64_t triangles = 0;  ///< of those
  std::uint64_t bytes = 0;      ///< of those
  double encode_s = 0;
  std::uint64_t failed = 0;  ///< blocks that could not be compressed, and were left out
};

/// Changed mesh blocks on their way to any number of receivers, each as fast as it can take them.
///
/// Only the newest state of each block is kept, compressed once somebody asks for it or too many
/// wait; so the size follows the map's surface, however slow the receivers are. Thread-safe.
class MeshStream final : public MeshSink {
 public:
  explicit MeshStream(const MeshStreamOptions& options = {});
  ~MeshStream() override;

  void on_block(const MeshBlock& block) override;

  /// One listener's view of the stream. Must not outlive the stream; one owner.
  class Receiver {
   public:
    ~Receiver();
    Receiver(const Receiver&) = delete;
    Receiver& operator=(const Receiver&) = delete;
    /// The blocks that have waited longest, in their newest state, until `budget_bytes` are spent:
    /// the last one may be larger than what was left. A block that was sent and has no surface any
    /// more comes as a removal, always. Empty: nothing to say, or no budget.
    [[nodiscard]] std::vector<MeshPacket> next(std::size_t budget_bytes);
    [[nodiscard]] bool up_to_date() const;

   private:
    friend class MeshStream;
    explicit Receiver(MeshStream& stream) : stream_(stream) {}
    void add(const std::array<int, 3>& index);
    [[nodiscard]] std::optional<MeshPacket> take_oldest();

    MeshStream& stream_;
    std::uint64_t next_place_ = 0;
    std::map<std::uint64_t, std::array<int, 3>> queue_;    ///< by place: the longest waiting first
    std::map<std::array<int, 3>, std::uint64_t> waiting_;  ///< their places
    std::set<std::array<int, 3>> sent_;                    ///< blocks that it has
  };
  /// A receiver that has nothing yet: it will get the whole map.
  [[nodiscard]] std::unique_ptr<Receiver> join();

  void on_complete(std::uint64_t version) override;
  /// The whole surface of one moment, in no order: the newest version that is complete, so empty
  /// before the first. Never waits for the map, nor the map for more than the copying.
  [[nodiscard]] std::vector<MeshPacket> snapshot() const;

  [[nodiscard]] MeshStreamStatistics statistics() const;
  /// Compressed and waiting blocks together, with those of the last complete version.
  [[nodiscard]] std::size_t kept_bytes() const;

 private:
  struct Kept;
  [[nodiscard]] Expected<std::string> compress(const MeshPacket& packet, TriangleMesh mesh) const;
  [[nodiscard]] std::shared_ptr<const std::string> compressed(const std::array<int, 3>& index,
                                                              Kept& kept);

  MeshStreamOptions options_;
  mutable std::mutex mutex_;
  std::map<std::array<int, 3>, Kept> blocks_;
  /// What blocks were in the last complete version that have changed since; without a surface where
  /// they were not there.
  std::map<std::array<int, 3>, Kept> replaced_;
  std::map<std::uint64_t, std::array<int, 3>> uncompressed_;  ///< by arrival
  std::uint64_t arrivals_ = 0;
  std::size_t waiting_bytes_ = 0, compressed_bytes_ = 0;
  MeshPacket newest_;  ///< of what a removal says, too
  std::vector<Receiver*> receivers_;
  MeshStreamStatistics statistics_;
};

/// Bytes that may be sent by now at a steady rate: a token bucket that may go into debt, so that a
/// packet larger than a moment's share still goes, and is paid off before the next.
class ByteAllowance {
 public:
  /// @param bytes_per_s  > 0; saved up for at most a second.
  ByteAllowance(double bytes_per_s, std::int64_t now_ns) : rate_(bytes_per_s), then_ns_(now_ns) {}
  [[nodiscard]] std::size_t available(std::int64_t now_ns);
  void spend(std::size_t bytes) { saved_ -= static_cast<double>(bytes); }

 private:
  double rate_, saved_ = 0;
  std::int64_t then_ns_;
};

}  // namespace corvid
