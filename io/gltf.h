#pragma once

#include <string>
#include <string_view>

#include "corvid/error.h"
#include "corvid/mesh_stream.h"
#include "io/draco.h"

namespace corvid {

enum class GlbCompression { none, draco };

/// A binary glTF 2.0 file of one mesh, with KHR_draco_mesh_compression if asked for.
///
/// glTF has y up and looks along -z; our world is the first camera's (x right, y down, z forward).
/// The vertices stay in our world, and the file's one node turns them by half a turn about x; by a
/// quarter of a turn back if `z_up` says that the world has z up.
/// Vertex colours are linear (16 bit), as the standard demands; a coloured mesh gets an unlit
/// material, for its colours hold the light already. An empty mesh gives a valid file whose scene
/// is empty.
[[nodiscard]] Expected<std::string> encode_glb(const TriangleMesh& mesh, GlbCompression compression,
                                               const DracoOptions& options, bool z_up = false);

/// Reads what encode_glb() wrote, back into our world. Errors: corrupt; unsupported for the files
/// of other programs that have more than one mesh.
[[nodiscard]] Expected<TriangleMesh> decode_glb(std::string_view bytes);

}  // namespace corvid
