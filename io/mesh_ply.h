#pragma once

#include <string>
#include <string_view>

#include "corvid/error.h"
#include "corvid/mesh_stream.h"

namespace corvid {

/// Binary little-endian PLY: x y z as float, nx ny nz, red green blue as uchar where the mesh has
/// them, and faces as lists of int. A mesh without triangles becomes a point cloud without a face
/// element.
[[nodiscard]] std::string encode_ply(const TriangleMesh& mesh);

/// Reads ascii and both binary forms, any order and type of properties; polygons become fans. A
/// file without faces gives vertices only. Errors: corrupt, unsupported.
[[nodiscard]] Expected<TriangleMesh> decode_ply(std::string_view bytes);

/// Wavefront OBJ: v (with 0..1 colours behind the position, as MeshLab and others take them), vn,
/// f.
[[nodiscard]] std::string encode_obj(const TriangleMesh& mesh);

/// Reads v, vn and f (polygons become fans, negative indices count back); the rest is skipped. A
/// vertex's normal is the last one that a face gave it. Errors: corrupt with the line.
[[nodiscard]] Expected<TriangleMesh> decode_obj(std::string_view text);

}  // namespace corvid
