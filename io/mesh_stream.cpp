#include "io/mesh_stream.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <utility>

#include "core/check.h"
#include "core/log.h"
#include "core/stopwatch.h"
#include "io/draco.h"

namespace corvid {
namespace {

constexpr char kMagic[4] = {'C', 'M', 'B', '1'};
constexpr std::size_t kHeaderBytes = 40;
static_assert(std::endian::native == std::endian::little, "packets are little-endian");

std::size_t raw_bytes(const TriangleMesh& mesh) {
  return mesh.vertices.size() * sizeof(Eigen::Vector3f) +
         mesh.normals.size() * sizeof(Eigen::Vector3f) + mesh.colours.size() * sizeof(Rgb8) +
         mesh.triangles.size() * sizeof(mesh.triangles[0]);
}

/// The whole lattice of a block, step 1: positions are integers, which Draco's quantization and
/// float numbers keep exactly.
QuantizationGrid lattice_of(int side_vox, int steps_per_voxel) {
  QuantizationGrid grid;
  grid.bits = std::bit_width(static_cast<unsigned>(side_vox * steps_per_voxel));
  grid.range = static_cast<float>((1U << grid.bits) - 1U);
  return grid;
}

}  // namespace

struct MeshStream::Kept {
  MeshPacket packet;                         ///< draco: null while `mesh` waits to be compressed
  std::shared_ptr<const TriangleMesh> mesh;  ///< null once it is compressed
  std::uint64_t arrival = 0;
};

std::size_t packet_bytes(const MeshPacket& packet) {
  return kHeaderBytes + (packet.draco ? packet.draco->size() : 0);
}

std::string encode_packet(const MeshPacket& packet) {
  const std::size_t size = packet.draco ? packet.draco->size() : 0;
  std::string out(kHeaderBytes, '\0');
  const auto put = [&](std::size_t at, const auto& value) {
    std::memcpy(out.data() + at, &value, sizeof(value));
  };
  put(0, kMagic);
  for (std::size_t i = 0; i < 3; ++i) put(4 + 4 * i, static_cast<std::int32_t>(packet.index[i]));
  put(16, packet.version);
  put(24, packet.voxel_size);
  put(32, static_cast<std::uint16_t>(packet.side_vox));
  put(34, static_cast<std::uint16_t>(packet.steps_per_voxel));
  put(36, static_cast<std::uint32_t>(size));
  if (packet.draco) out += *packet.draco;
  return out;
}

Expected<MeshPacket> decode_packet(std::string_view bytes) {
  if (bytes.size() < kHeaderBytes || std::memcmp(bytes.data(), kMagic, sizeof(kMagic)) != 0)
    return fail(ErrorCode::corrupt, "not a packet of a mesh stream");
  const auto get = [&]<class T>(std::size_t at, T value) {
    std::memcpy(&value, bytes.data() + at, sizeof(value));
    return value;
  };
  MeshPacket packet;
  for (std::size_t i = 0; i < 3; ++i) packet.index[i] = get(4 + 4 * i, std::int32_t{});
  packet.version = get(16, std::uint64_t{});
  packet.voxel_size = get(24, double{});
  packet.side_vox = get(32, std::uint16_t{});
  packet.steps_per_voxel = get(34, std::uint16_t{});
  const std::size_t size = get(36, std::uint32_t{});
  if (size != bytes.size() - kHeaderBytes || !(packet.voxel_size > 0) ||
      !std::isfinite(packet.voxel_size) || packet.side_vox < 1 || packet.steps_per_voxel < 1)
    return fail(ErrorCode::corrupt, "the header of a mesh packet is not valid");
  if (size > 0) packet.draco = std::make_shared<const std::string>(bytes.substr(kHeaderBytes));
  return packet;
}

Expected<TriangleMesh> decode_mesh(const MeshPacket& packet) {
  if (!packet.draco) return TriangleMesh{};
  auto mesh = decode_draco(*packet.draco);
  if (!mesh) return mesh;
  const std::int64_t side = std::int64_t{packet.side_vox} * packet.steps_per_voxel;
  const double step = packet.voxel_size / packet.steps_per_voxel;
  for (Eigen::Vector3f& v : mesh->vertices) {
    for (int axis = 0; axis < 3; ++axis) {
      const std::int64_t at = packet.index[static_cast<std::size_t>(axis)] * side +
                              std::llround(std::clamp(v[axis], 0.0F, 1e9F));
      v[axis] = static_cast<float>(static_cast<double>(at) * step);
    }
  }
  return mesh;
}

MeshStream::MeshStream(const MeshStreamOptions& options) : options_(options) {
  CORVID_CHECK(options.steps_per_voxel >= 1 && options.steps_per_voxel <= 256,
               "1 to 256 lattice steps per voxel");
}
MeshStream::~MeshStream() = default;

void MeshStream::on_block(const MeshBlock& block) {
  const std::lock_guard lock(mutex_);
  ++statistics_.changes;
  const auto old = blocks_.find(block.index);
  if (old != blocks_.end()) {
    uncompressed_.erase(old->second.arrival);
    if (old->second.mesh) waiting_bytes_ -= raw_bytes(*old->second.mesh);
    if (old->second.packet.draco) compressed_bytes_ -= old->second.packet.draco->size();
  }
  replaced_.try_emplace(block.index, old != blocks_.end() ? std::move(old->second) : Kept());
  if (old != blocks_.end()) blocks_.erase(old);
  newest_.version = std::max(newest_.version, block.version);
  if (!block.mesh.empty()) {
    newest_ = {block.index,    newest_.version,          block.voxel_size,
               block.side_vox, options_.steps_per_voxel, nullptr};
    Kept& kept = blocks_[block.index];
    kept.packet = newest_;
    kept.packet.version = block.version;
    kept.mesh = std::make_shared<const TriangleMesh>(block.mesh);
    kept.arrival = ++arrivals_;
    waiting_bytes_ += raw_bytes(*kept.mesh);
    uncompressed_[kept.arrival] = block.index;
  }
  for (Receiver* receiver : receivers_) receiver->add(block.index);
  while (waiting_bytes_ > options_.max_waiting_bytes) {
    const auto index = uncompressed_.begin()->second;
    (void)compressed(index, blocks_.at(index));
  }
}

void MeshStream::on_complete(std::uint64_t /*version*/) {
  const std::lock_guard lock(mutex_);
  replaced_.clear();
}

Expected<std::string> MeshStream::compress(const MeshPacket& packet, TriangleMesh mesh) const {
  const QuantizationGrid lattice = lattice_of(packet.side_vox, packet.steps_per_voxel);
  const double step = packet.voxel_size / packet.steps_per_voxel;
  for (Eigen::Vector3f& v : mesh.vertices) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double origin =
          static_cast<double>(packet.index[axis]) * packet.side_vox * packet.steps_per_voxel;
      float& at = v[static_cast<Eigen::Index>(axis)];
      at = static_cast<float>(std::round(static_cast<double>(at) / step) - origin);
    }
  }
  return encode_draco(mesh, {lattice, options_.draco_speed, options_.normal_bits});
}

std::shared_ptr<const std::string> MeshStream::compressed(const std::array<int, 3>& index,
                                                          Kept& kept) {
  if (kept.packet.draco) return kept.packet.draco;
  Stopwatch watch;
  const TriangleMesh& mesh = *kept.mesh;
  auto bytes = compress(kept.packet, mesh);
  statistics_.encode_s += watch.lap_ms() / 1000;
  if (bytes) {
    ++statistics_.encoded;
    statistics_.triangles += mesh.triangles.size();
    statistics_.bytes += bytes->size();
  } else {
    log().warn("mesh stream: block ({}, {}, {}) is left out: {}", index[0], index[1], index[2],
               bytes.error().to_string());
    ++statistics_.failed;
    bytes = std::string();
  }
  waiting_bytes_ -= raw_bytes(mesh);
  uncompressed_.erase(kept.arrival);
  kept.mesh = nullptr;
  kept.packet.draco = std::make_shared<const std::string>(std::move(*bytes));
  compressed_bytes_ += kept.packet.draco->size();
  return kept.packet.draco;
}

std::unique_ptr<MeshStream::Receiver> MeshStream::join() {
  const std::lock_guard lock(mutex_);
  std::unique_ptr<Receiver> receiver(new Receiver(*this));
  std::vector<std::pair<std::uint64_t, std::array<int, 3>>> oldest_first;
  for (const auto& [index, kept] : blocks_) oldest_first.emplace_back(kept.arrival, index);
  std::sort(oldest_first.begin(), oldest_first.end());
  for (const auto& [arrival, index] : oldest_first) receiver->add(index);
  receivers_.push_back(receiver.get());
  return receiver;
}

std::vector<MeshPacket> MeshStream::snapshot() const {
  std::vector<Kept> all;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [index, kept] : blocks_)
      if (!replaced_.contains(index)) all.push_back(kept);
    for (const auto& [index, kept] : replaced_)
      if (kept.mesh || kept.packet.draco) all.push_back(kept);
  }
  std::vector<MeshPacket> out;
  for (Kept& kept : all) {
    if (kept.mesh) {
      auto bytes = compress(kept.packet, *kept.mesh);
      if (!bytes) continue;
      kept.packet.draco = std::make_shared<const std::string>(std::move(*bytes));
    }
    if (!kept.packet.draco->empty()) out.push_back(std::move(kept.packet));
  }
  return out;
}

MeshStreamStatistics MeshStream::statistics() const {
  const std::lock_guard lock(mutex_);
  return statistics_;
}

std::size_t MeshStream::kept_bytes() const {
  const std::lock_guard lock(mutex_);
  std::size_t replaced_bytes = 0;
  for (const auto& [index, kept] : replaced_) {
    if (kept.mesh) replaced_bytes += raw_bytes(*kept.mesh);
    if (kept.packet.draco) replaced_bytes += kept.packet.draco->size();
  }
  return waiting_bytes_ + compressed_bytes_ + replaced_bytes;
}

MeshStream::Receiver::~Receiver() {
  const std::lock_guard lock(stream_.mutex_);
  std::erase(stream_.receivers_, this);
}

void MeshStream::Receiver::add(const std::array<int, 3>& index) {
  if (!waiting_.try_emplace(index, next_place_).second) return;  // keeps its place
  queue_[next_place_++] = index;
}

std::optional<MeshPacket> MeshStream::Receiver::take_oldest() {
  const std::array<int, 3> index = queue_.begin()->second;
  queue_.erase(queue_.begin());
  waiting_.erase(index);
  const auto kept = stream_.blocks_.find(index);
  // Triangles without extent on the lattice leave nothing behind.
  if (kept != stream_.blocks_.end() && !stream_.compressed(index, kept->second)->empty()) {
    sent_.insert(index);
    return kept->second.packet;
  }
  if (sent_.erase(index) == 0) return std::nullopt;
  MeshPacket removal = stream_.newest_;
  removal.index = index;
  return removal;
}

std::vector<MeshPacket> MeshStream::Receiver::next(std::size_t budget_bytes) {
  std::vector<MeshPacket> out;
  std::size_t spent = 0;
  while (spent < budget_bytes) {
    // Locked for each block alone, so that the map never waits for more than one compression.
    const std::lock_guard lock(stream_.mutex_);
    if (queue_.empty()) break;
    if (auto packet = take_oldest()) {
      spent += packet_bytes(*packet);
      out.push_back(std::move(*packet));
    }
  }
  return out;
}

bool MeshStream::Receiver::up_to_date() const {
  const std::lock_guard lock(stream_.mutex_);
  return queue_.empty();
}

std::size_t ByteAllowance::available(std::int64_t now_ns) {
  saved_ = std::min(rate_, saved_ + rate_ * static_cast<double>(now_ns - then_ns_) * 1e-9);
  then_ns_ = now_ns;
  return saved_ > 0 ? static_cast<std::size_t>(saved_) : 0;
}

}  // namespace corvid
