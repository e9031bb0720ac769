#include "io/gltf.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "io/mesh_files.h"
#include "scenes/mesh_shapes.h"

namespace corvid {
namespace {

using Json = nlohmann::json;

Json json_of(const std::string& glb) {
  std::uint32_t size = 0;
  std::memcpy(&size, glb.data() + 12, 4);
  return Json::parse(glb.substr(20, size));
}

std::string encode(const TriangleMesh& mesh, MeshFormat format) {
  const auto bytes = encode_mesh(mesh, format);
  EXPECT_TRUE(bytes);
  return bytes.value_or("");
}

TEST(Gltf, ContainerSizesAndAlignment) {
  const TriangleMesh mesh = coloured_sphere({0, 0, 5}, 1, 7, 9);
  for (const MeshFormat format : {MeshFormat::glb, MeshFormat::glb_plain}) {
    const std::string glb = encode(mesh, format);
    std::uint32_t word[5];
    std::memcpy(word, glb.data(), 20);
    EXPECT_EQ(glb.substr(0, 4), "glTF");
    EXPECT_EQ(word[1], 2u);
    EXPECT_EQ(word[2], glb.size());
    EXPECT_EQ(word[3] % 4, 0u);
    std::uint32_t binary[2];
    std::memcpy(binary, glb.data() + 20 + word[3], 8);
    EXPECT_EQ(binary[0] % 4, 0u);
    EXPECT_EQ(20 + word[3] + 8 + binary[0], glb.size());
  }
}

TEST(Gltf, DracoPrimitiveIsWrittenAsTheExtensionDemands) {
  const TriangleMesh mesh = coloured_sphere({0, 0, 5}, 1, 7, 9);
  const Json json = json_of(encode(mesh, MeshFormat::glb));
  EXPECT_EQ(json.at("extensionsRequired"), Json({"KHR_draco_mesh_compression"}));
  const Json used = json.at("extensionsUsed");
  EXPECT_NE(std::find(used.begin(), used.end(), "KHR_draco_mesh_compression"), used.end());
  const Json primitive = json.at("meshes").at(0).at("primitives").at(0);
  const Json draco = primitive.at("extensions").at("KHR_draco_mesh_compression");
  EXPECT_EQ(draco.at("bufferView"), 0);
  EXPECT_EQ(draco.at("attributes").size(), 3u);
  for (const auto& [name, id] : primitive.at("attributes").items()) {
    EXPECT_TRUE(draco.at("attributes").contains(name)) << name;
    const Json accessor = json.at("accessors").at(id.get<std::size_t>());
    EXPECT_FALSE(accessor.contains("bufferView")) << name;
    EXPECT_EQ(accessor.at("count"), mesh.vertices.size());
  }
  const Json indices = json.at("accessors").at(primitive.at("indices").get<std::size_t>());
  EXPECT_EQ(indices.at("count"), mesh.triangles.size() * 3);
  EXPECT_FALSE(indices.contains("bufferView"));
}

TEST(Gltf, NodeTurnsOurWorldIntoYUp) {
  const TriangleMesh mesh = coloured_sphere({0, 0, 5}, 1, 7, 9);
  const Json node = json_of(encode(mesh, MeshFormat::glb)).at("nodes").at(0);
  const auto q = node.at("rotation").get<std::array<double, 4>>();
  const Eigen::Quaterniond R(q[3], q[0], q[1], q[2]);
  EXPECT_LT((R * Eigen::Vector3d(0, -1, 0) - Eigen::Vector3d(0, 1, 0)).norm(), 1e-12);  // up
  EXPECT_LT((R * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(1, 0, 0)).norm(), 1e-12);   // right
  EXPECT_LT((R * Eigen::Vector3d(0, 0, 1) - Eigen::Vector3d(0, 0, -1)).norm(), 1e-12);  // ahead
}

TEST(Gltf, BoundsAreThoseOfTheStoredVertices) {
  const TriangleMesh mesh = coloured_sphere({0.3f, -0.2f, 5}, 1, 7, 9);
  for (const MeshFormat format : {MeshFormat::glb, MeshFormat::glb_plain}) {
    const std::string glb = encode(mesh, format);
    const auto back = decode_glb(glb);
    ASSERT_TRUE(back);
    const Json json = json_of(glb);
    const Json position = json.at("accessors").at(1);
    for (int i = 0; i < 3; ++i) {
      float low = 1e9f, high = -1e9f;
      for (const Eigen::Vector3f& v : back->vertices) {
        low = std::min(low, v[i]);
        high = std::max(high, v[i]);
      }
      EXPECT_EQ(position.at("min").at(static_cast<std::size_t>(i)).get<float>(), low);
      EXPECT_EQ(position.at("max").at(static_cast<std::size_t>(i)).get<float>(), high);
    }
  }
}

TEST(Gltf, EmptyMeshIsASceneWithoutNodes) {
  const Json json = json_of(encode(TriangleMesh{}, MeshFormat::glb));
  EXPECT_FALSE(json.contains("meshes"));
  EXPECT_FALSE(json.contains("extensionsRequired"));
  EXPECT_FALSE(json.at("scenes").at(0).contains("nodes"));
}

TEST(Gltf, OnlyColouredMeshesAreUnlit) {
  TriangleMesh mesh = coloured_sphere({0, 0, 5}, 1, 7, 9);
  EXPECT_TRUE(json_of(encode(mesh, MeshFormat::glb))["materials"][0].contains("extensions"));
  mesh.colours.clear();
  EXPECT_FALSE(json_of(encode(mesh, MeshFormat::glb))["materials"][0].contains("extensions"));
}

}  // namespace
}  // namespace corvid
