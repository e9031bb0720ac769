#include "io/mesh_files.h"

#include <gtest/gtest.h>

#include <fstream>

#include "io/atomic_file.h"
#include "io/gltf.h"
#include "io/mesh_ply.h"
#include "scenes/mesh_shapes.h"
#include "scenes/temporary_folder.h"

namespace corvid {
namespace {

TEST(MeshFiles, PlyAndObjAndPlainGlbRoundTripExactly) {
  const TriangleMesh mesh = coloured_sphere({1, 2, 3}, 0.7f, 9, 14);
  const TemporaryFolder folder;
  for (const char* name : {"mesh.ply", "mesh.obj", "mesh.glb"}) {
    const bool glb = std::string(name).ends_with("glb");
    ASSERT_TRUE(
        write_mesh(mesh, folder / name, glb ? std::optional(MeshFormat::glb_plain) : std::nullopt));
    const auto back = read_mesh(folder / name);
    ASSERT_TRUE(back) << back.error().to_string();
    EXPECT_EQ(back->vertices, mesh.vertices) << name;
    EXPECT_EQ(back->triangles, mesh.triangles) << name;
    EXPECT_EQ(back->colours, mesh.colours) << name;
    ASSERT_EQ(back->normals.size(), mesh.normals.size()) << name;
    for (std::size_t i = 0; i < mesh.normals.size(); ++i) {
      EXPECT_LT((back->normals[i] - mesh.normals[i]).norm(), 1e-6f) << name;
    }
  }
}

TEST(MeshFiles, CompressedFilesStayWithinTheStep) {
  const TriangleMesh mesh = coloured_sphere({1, 2, 3}, 0.7f, 9, 14);
  const TemporaryFolder folder;
  for (const char* name : {"mesh.drc", "mesh.glb"}) {
    ASSERT_TRUE(write_mesh(mesh, folder / name, std::nullopt, {.max_step = 0.001}));
    const auto back = read_mesh(folder / name);
    ASSERT_TRUE(back) << back.error().to_string();
    EXPECT_EQ(back->triangles.size(), mesh.triangles.size());
    for (const Eigen::Vector3f& v : back->vertices) {
      EXPECT_NEAR((v - Eigen::Vector3f(1, 2, 3)).norm(), 0.7f, 0.001 * std::sqrt(0.75)) << name;
    }
    EXPECT_EQ(back->colours.size(), back->vertices.size());
    EXPECT_EQ(back->normals.size(), back->vertices.size());
  }
}

TEST(MeshFiles, BareGeometryHasNoOtherAttributes) {
  TriangleMesh mesh = coloured_sphere({0, 0, 0}, 1, 5, 6);
  mesh.normals.clear();
  mesh.colours.clear();
  for (const MeshFormat format : {MeshFormat::ply, MeshFormat::obj, MeshFormat::drc,
                                  MeshFormat::glb, MeshFormat::glb_plain}) {
    const auto bytes = encode_mesh(mesh, format);
    ASSERT_TRUE(bytes) << bytes.error().to_string();
    const auto back = format == MeshFormat::ply   ? decode_ply(*bytes)
                      : format == MeshFormat::obj ? decode_obj(*bytes)
                      : format == MeshFormat::drc ? decode_draco(*bytes)
                                                  : decode_glb(*bytes);
    ASSERT_TRUE(back) << back.error().to_string();
    EXPECT_EQ(back->triangles.size(), mesh.triangles.size());
    EXPECT_TRUE(back->normals.empty());
    EXPECT_TRUE(back->colours.empty());
  }
}

TEST(MeshFiles, EmptyMeshIsAValidFile) {
  const TemporaryFolder folder;
  for (const char* name : {"mesh.ply", "mesh.obj", "mesh.drc", "mesh.glb"}) {
    ASSERT_TRUE(write_mesh(TriangleMesh{}, folder / name)) << name;
    const auto back = read_mesh(folder / name);
    ASSERT_TRUE(back) << back.error().to_string();
    EXPECT_TRUE(back->empty());
  }
}

TEST(MeshFiles, PointCloudHasNoFaceElement) {
  TriangleMesh cloud;
  cloud.vertices = {{1, 2, 3}, {4, 5, 6}};
  cloud.colours = {{1, 2, 3}, {250, 251, 252}};
  const std::string bytes = encode_ply(cloud);
  EXPECT_EQ(bytes.find("element face"), std::string::npos);
  const auto back = decode_ply(bytes);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->vertices, cloud.vertices);
  EXPECT_EQ(back->colours, cloud.colours);
}

TEST(MeshFiles, ReadsForeignPly) {
  const std::string ascii =
      "ply\r\nformat ascii 1.0\r\ncomment by another program\r\nelement vertex 4\r\n"
      "property double y\r\nproperty double x\r\nproperty float z\r\nproperty float intensity\r\n"
      "property float red\r\nproperty float green\r\nproperty float blue\r\n"
      "element camera 1\r\nproperty list uchar float view\r\nproperty int n\r\n"
      "element face 1\r\nproperty uchar flag\r\nproperty list uchar uint vertex_index\r\n"
      "end_header\r\n2 1 3 9 0 0.5 1\r\n0 0 0 9 0 0 0\r\n1 0 0 9 0 0 0\r\n1 1 0 9 1 1 1\r\n"
      "3 0.5 0.5 0.5 7\r\n1 4 0 1 2 3\r\n";
  const auto mesh = decode_ply(ascii);
  ASSERT_TRUE(mesh) << mesh.error().to_string();
  ASSERT_EQ(mesh->vertices.size(), 4u);
  EXPECT_EQ(mesh->vertices[0], Eigen::Vector3f(1, 2, 3));
  EXPECT_EQ(mesh->colours[0], (Rgb8{0, 128, 255}));
  ASSERT_EQ(mesh->triangles.size(), 2u);  // the square as a fan
  EXPECT_EQ(mesh->triangles[1], (std::array<std::uint32_t, 3>{0, 2, 3}));

  std::string big =
      "ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty float x\n"
      "property float y\nproperty float z\nend_header\n";
  for (const unsigned char c : {0x3f, 0x80, 0, 0, 0x40, 0, 0, 0, 0xc0, 0x40, 0, 0}) {
    big.push_back(static_cast<char>(c));
  }
  const auto point = decode_ply(big);
  ASSERT_TRUE(point);
  EXPECT_EQ(point->vertices.at(0), Eigen::Vector3f(1, 2, -3));
}

TEST(MeshFiles, BrokenFilesAreErrors) {
  const TriangleMesh mesh = coloured_sphere({0, 0, 0}, 1, 6, 8);
  const std::string ply = encode_ply(mesh);
  for (std::size_t size = 0; size < ply.size(); size += 11) {
    EXPECT_FALSE(decode_ply(std::string_view(ply).substr(0, size))) << size;
  }
  const auto glb = encode_mesh(mesh, MeshFormat::glb_plain);
  ASSERT_TRUE(glb);
  for (std::size_t size = 0; size < glb->size(); size += 11) {
    EXPECT_FALSE(decode_glb(std::string_view(*glb).substr(0, size))) << size;
  }
  const std::string header =
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n"
      "property float y\nproperty float z\n";
  EXPECT_FALSE(decode_ply(header + "element face 1\nproperty list uchar int vertex_indices\n"
                                   "end_header\n0 0 0\n3 0 0 7\n"));
  EXPECT_FALSE(
      decode_ply("ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\n"
                 "property float y\nproperty float z\nend_header\n1 2 3\n"));
  EXPECT_FALSE(
      decode_ply("ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n"));
  EXPECT_FALSE(decode_obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"));
  EXPECT_FALSE(decode_obj("v 0 zero 0\n"));
  EXPECT_FALSE(decode_obj("v 0 0 0\nf 1 1\n"));

  const TemporaryFolder folder;
  EXPECT_EQ(read_mesh(folder / "absent.ply").error().code, ErrorCode::not_found);
  EXPECT_EQ(read_mesh(folder / "mesh.stl").error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(write_mesh(mesh, folder / "mesh.stl").error().code, ErrorCode::invalid_argument);
  ASSERT_TRUE(write_file_atomically(folder / "bad.drc", "nonsense"));
  const auto bad = read_mesh(folder / "bad.drc");
  ASSERT_FALSE(bad);
  EXPECT_NE(bad.error().to_string().find("bad.drc"), std::string::npos);
}

TEST(MeshFiles, ObjWithNegativeIndicesAndTextures) {
  const auto mesh = decode_obj(
      "# quad\nmtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n"
      "f -4/1/1 -3/1/1 -2/1/1 -1/1/1\n");
  ASSERT_TRUE(mesh) << mesh.error().to_string();
  EXPECT_EQ(mesh->triangles.size(), 2u);
  EXPECT_EQ(mesh->triangles[0], (std::array<std::uint32_t, 3>{0, 1, 2}));
  ASSERT_EQ(mesh->normals.size(), 4u);
  EXPECT_EQ(mesh->normals[3], Eigen::Vector3f(0, 0, 1));
  EXPECT_TRUE(mesh->colours.empty());
}

}  // namespace
}  // namespace corvid
