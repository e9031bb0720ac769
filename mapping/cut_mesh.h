#pragma once

#include <cstddef>
#include <span>
#include <stop_token>

#include "corvid/mesh_stream.h"
#include "mapping/cut_views.h"

namespace corvid {

/// A labelled volume.
struct CutLabels {
  const CutVolume& volume;
  const BitGrid& solid;       ///< inside the surface
  const CrustBlocks& blocks;  ///< of the crust
  const CutDistances& distances;
};

/// The border between solid and empty voxels by marching cubes. Which edges of the grid it crosses
/// is up to the labels alone; where on the edge, to the measured distances, smoothed by `smoothing`
/// passes in which every voxel keeps the sign of its label (after Whitaker, "Reducing aliasing
/// artifacts in iso-surfaces of binary volumes", 2000). So it is closed and manifold whatever was
/// measured. Outside of the volume counts as empty: where solid reaches the volume's border, flat
/// caps close it. Normals by area, towards empty space.
/// Pieces of the surface that hang together but that hardly any measurement supports (a quarter of
/// the vertices, and `min_island` of the largest support) are left out as a whole, never the
/// largest.
/// @param closed  false: leaves out the caps and every cell of the grid in which no crossing was
///        measured from both sides.
[[nodiscard]] TriangleMesh mesh_cut(const CutLabels& labels, int smoothing, double min_island,
                                    bool closed, int threads);

/// Colours the vertices from the views that see them, the more frontal ones more; grey where none
/// does, or where it was asked to stop.
/// @param colours  one per view; of the size of its depth map, or null.
void colour_cut(TriangleMesh& mesh, const CutVolume& volume, std::span<const CutView> views,
                std::span<const ColourImage* const> colours, int threads,
                const std::stop_token& stop = {});

/// Sides of faces that no other face runs along exactly once in the opposite direction; 0 for a
/// closed and oriented surface without edges of more than two faces.
[[nodiscard]] std::size_t unpaired_sides(const TriangleMesh& mesh);

}  // namespace corvid
