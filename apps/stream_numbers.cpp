#include "apps/stream_numbers.h"

namespace corvid {

StreamNumbers count_stream(MeshStream& stream, double wall_s, double bytes_per_s) {
  constexpr std::size_t kBudget_bytes = 1U << 20;
  StreamNumbers n;
  const auto receiver = stream.join();
  while (!receiver->up_to_date()) {
    for (const MeshPacket& packet : receiver->next(kBudget_bytes)) {
      ++n.blocks;
      n.bytes += packet_bytes(packet);
    }
  }
  const MeshStreamStatistics s = stream.statistics();
  n.changes = s.changes;
  if (wall_s > 0) n.changes_per_s = static_cast<double>(s.changes) / wall_s;
  if (s.triangles > 0)
    n.bytes_per_triangle = static_cast<double>(s.bytes) / static_cast<double>(s.triangles);
  if (s.encoded > 0) n.encode_ms = 1000 * s.encode_s / static_cast<double>(s.encoded);
  if (bytes_per_s > 0) n.send_s = static_cast<double>(n.bytes) / bytes_per_s;
  return n;
}

}  // namespace corvid
