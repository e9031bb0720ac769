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

/// The surface inside one block of the voxel map. A block without triangles removes what was there.
struct MeshBlock {
  std::array<int, 3> index{};  ///< block coordinates in the voxel grid
  std::uint64_t version = 0;   ///< rises with every change of the map
  TriangleMesh mesh;
};

}  // namespace corvid
