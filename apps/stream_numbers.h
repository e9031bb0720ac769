#pragma once

#include <cstddef>
#include <cstdint>

#include "io/mesh_stream.h"

namespace corvid {

/// What the mesh stream of a run was like, and what a receiver that joins at its end gets.
struct StreamNumbers {
  std::uint64_t changes = 0;  ///< blocks that changed over the run, removals included
  double changes_per_s = 0;   ///< of the run's wall time
  std::size_t blocks = 0;     ///< of the whole surface
  std::size_t bytes = 0;      ///< of those as packets
  double bytes_per_triangle = 0;
  double encode_ms = 0;  ///< per block
  double send_s = 0;     ///< the whole surface at mapping.stream_bytes_per_s
};
[[nodiscard]] StreamNumbers count_stream(MeshStream& stream, double wall_s, double bytes_per_s);

}  // namespace corvid
