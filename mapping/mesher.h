#pragma once

#include <cstdint>
#include <vector>

#include "corvid/mesh_stream.h"
#include "mapping/voxel_blocks.h"

namespace corvid {

struct MesherOptions {
  /// Observed weight that a voxel needs to take part in the surface; one sharp, frontal, confident
  /// observation weighs Voxel::kMaxWeight.
  std::uint32_t min_weight = 8;
};

/// Mesh blocks are cubes of 2x2x2 voxel blocks: what is compressed and sent in one piece.
inline constexpr int kMeshBlockSide = 2;

/// The zero surface of one mesh block by marching cubes (Lorensen and Cline 1987; the tables are
/// made by tracing the contour over the faces of a cell, so that ambiguous faces are cut the same
/// way by both cells that share them).
///
/// Mesh block (i,j,k) holds the voxel blocks from (2i,2j,2k). Its mesh covers the cells whose
/// lowest corner is one of their voxels; the upper corners may belong to the next blocks. A vertex
/// is a function of the two voxels at the ends of its grid edge and of nothing else, so blocks that
/// share a border share its vertices bit for bit. Cells with an unobserved corner are left open. No
/// degenerate faces; every edge has at most two faces, and exactly two where all around is
/// observed. Vertices in world coordinates, normals from the gradient (towards free space), colours
/// interpolated; no colour: mid-grey.
[[nodiscard]] TriangleMesh mesh_block(const VoxelBlocks& volume, const BlockIndex& mesh_block,
                                      const MesherOptions& options = {});

/// The whole surface: every voxel block, with the vertices on shared borders welded.
[[nodiscard]] TriangleMesh mesh_all(const VoxelBlocks& volume, const MesherOptions& options = {});

/// The mesh blocks that depend on one of the `changed` voxel blocks (on those and their
/// neighbours), sorted.
[[nodiscard]] std::vector<BlockIndex> blocks_to_remesh(const std::vector<BlockIndex>& changed);

}  // namespace corvid
