#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "corvid/image.h"

namespace corvid {

/// An indexed triangle mesh. normals and colours are empty or one per vertex. Faces are
/// counter-clockwise seen from outside (right-handed world frame).
struct TriangleMesh {
  std::vector<Eigen::Vector3f> vertices;  ///< [map units]
  std::vector<Eigen::Vector3f> normals;
  std::vector<Rgb8> colours;
  std::vector<std::array<std::uint32_t, 3>> triangles;
  [[nodiscard]] bool empty() const { return triangles.empty(); }
};

/// The surface inside one cube of the voxel map. A block without triangles removes what was there.
/// Block (i,j,k) covers [i, i + 1] * side_vox * voxel_size on the x axis and so on; blocks that
/// meet share the vertices on their common face bit for bit.
struct MeshBlock {
  std::array<int, 3> index{};
  std::uint64_t version = 0;  ///< rises with every change of the map
  double voxel_size = 0;      ///< [map units]; where it changes, all older blocks are removed first
  int side_vox = 0;           ///< voxels along an edge of the cube
  TriangleMesh mesh;
};

}  // namespace corvid
