#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "corvid/error.h"
#include "corvid/mesh_stream.h"
#include "io/mesh_clean.h"

namespace corvid {

struct DracoOptions {
  QuantizationGrid grid;  ///< of the positions; must enclose every vertex
  int speed = 5;          ///< 0 small and slow to 10 fast; 5 to 7 suits blocks (Draco's scale)
  int normal_bits = 8;    ///< octahedral, 2 to 30
};

/// How the colours of a bare .drc and of a glTF primitive differ: browsers take the former as sRGB
/// bytes, the glTF standard demands linear values (stored in 16 bits, so that no sRGB value is
/// lost).
enum class DracoColours { srgb8, linear16 };

/// Draco mesh (edgebreaker) with positions, and normals and colours where the mesh has them.
/// The mesh is cleaned first (clean_mesh), for the encoder stumbles over degenerate input. The
/// decoder gives vertices and triangles in another order, and splits non-manifold vertices. A mesh
/// without triangles gives zero bytes: Draco has no empty mesh.
/// Errors: invalid_argument if the grid does not enclose the mesh or is not valid; io if the
/// encoder refuses.
[[nodiscard]] Expected<std::string> encode_draco(const TriangleMesh& mesh,
                                                 const DracoOptions& options,
                                                 DracoColours colours = DracoColours::srgb8);

/// The inverse; zero bytes give an empty mesh. Takes Draco meshes of other programs too (their
/// other attributes are left out). Errors: corrupt.
[[nodiscard]] Expected<TriangleMesh> decode_draco(std::string_view bytes,
                                                  DracoColours colours = DracoColours::srgb8);

/// Unique ids that encode_draco gives its attributes, as glTF's extension names them.
inline constexpr int kDracoPositionId = 0, kDracoNormalId = 1, kDracoColourId = 2;

}  // namespace corvid
