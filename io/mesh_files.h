#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "corvid/error.h"
#include "corvid/mesh_stream.h"

namespace corvid {

/// glb holds a Draco-compressed primitive, glb_plain an uncompressed one; both end in ".glb".
enum class MeshFormat { ply, obj, drc, glb, glb_plain };

/// "ply", "obj", "drc", "glb", "glb-plain"; nothing for other names.
[[nodiscard]] std::optional<MeshFormat> mesh_format_from_name(std::string_view name);

struct MeshWriteOptions {
  /// Largest rounding of a position in drc and compressed glb, in map units; 0: 14 bits over the
  /// mesh's longest side. An eighth of the voxel size is far below what the surface resolves.
  double max_step = 0;
  /// The mesh has z up (east, north, up) instead of the camera's axes: for glb, which has y up.
  bool z_up = false;
};

/// The file's bytes. An empty mesh gives a valid file without triangles (ply, obj, glb) or, where
/// the format has no such thing, a file of zero bytes (drc); read_mesh() takes all of them.
[[nodiscard]] Expected<std::string> encode_mesh(const TriangleMesh& mesh, MeshFormat format,
                                                const MeshWriteOptions& options = {});

/// Writes atomically. The format comes from the extension unless it is given.
/// Errors: invalid_argument for an unknown extension, io.
[[nodiscard]] Expected<void> write_mesh(const TriangleMesh& mesh, const std::filesystem::path& path,
                                        std::optional<MeshFormat> format = std::nullopt,
                                        const MeshWriteOptions& options = {});

/// Reads .ply, .obj, .drc, and .glb files that corvid wrote. Vertices as they stand in the file
/// (glb: in our world, without the node's turn). Errors: not_found, io, corrupt, unsupported.
[[nodiscard]] Expected<TriangleMesh> read_mesh(const std::filesystem::path& path);

}  // namespace corvid
