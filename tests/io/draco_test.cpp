#include "io/draco.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>

#include "io/atomic_file.h"
#include "io/mesh_files.h"
#include "scenes/mesh_shapes.h"
#include "scenes/temporary_folder.h"

namespace corvid {
namespace {

DracoOptions options_for(const TriangleMesh& mesh, double step = 0) {
  DracoOptions options;
  options.grid = grid_around(mesh, step);
  return options;
}

/// Index of the vertex of `mesh` nearest to p, and its distance.
std::pair<std::size_t, double> nearest(const TriangleMesh& mesh, const Eigen::Vector3f& p) {
  std::size_t best = 0;
  for (std::size_t i = 1; i < mesh.vertices.size(); ++i) {
    if ((mesh.vertices[i] - p).norm() < (mesh.vertices[best] - p).norm()) best = i;
  }
  return {best, (mesh.vertices[best] - p).norm()};
}

TEST(Draco, RoundTripStaysWithinTheQuantization) {
  const TriangleMesh mesh = coloured_sphere({3, -2, 10}, 2.5f, 20, 30);
  for (const int speed : {0, 5, 10}) {
    DracoOptions options = options_for(mesh, 0.002);
    options.speed = speed;
    options.normal_bits = 10;
    const auto bytes = encode_draco(mesh, options);
    ASSERT_TRUE(bytes) << bytes.error().to_string();
    const auto back = decode_draco(*bytes);
    ASSERT_TRUE(back) << back.error().to_string();
    EXPECT_EQ(back->triangles.size(), mesh.triangles.size());
    ASSERT_EQ(back->vertices.size(), mesh.vertices.size());
    ASSERT_EQ(back->normals.size(), mesh.vertices.size());
    ASSERT_EQ(back->colours.size(), mesh.vertices.size());
    EXPECT_LE(options.grid.step(), 0.002);
    for (std::size_t i = 0; i < back->vertices.size(); ++i) {
      const auto [k, distance] = nearest(mesh, back->vertices[i]);
      EXPECT_LE(distance, options.grid.step() * std::sqrt(0.75) * 1.01);
      EXPECT_EQ(back->colours[i], mesh.colours[k]);
      EXPECT_GT(back->normals[i].dot(mesh.normals[k]), 0.999f);
    }
    const double volume = signed_volume(mesh);
    EXPECT_GT(volume, 0);
    EXPECT_NEAR(signed_volume(*back), volume, 0.002 * volume);
    EXPECT_LT(bytes->size() * 4, mesh.vertices.size() * 27 + mesh.triangles.size() * 12);
  }
}

TEST(Draco, LinearColoursComeBackAsTheSameSrgbBytes) {
  TriangleMesh mesh;
  for (int i = 0; i < 256; ++i) {  // a strip with every value once
    mesh.vertices.emplace_back(static_cast<float>(i), static_cast<float>(i % 2), 0.0f);
    const auto v = static_cast<std::uint8_t>(i);
    mesh.colours.push_back({v, static_cast<std::uint8_t>(255 - i), v});
    const auto k = static_cast<std::uint32_t>(i);
    if (i >= 2) {
      mesh.triangles.push_back(i % 2 == 0 ? std::array{k - 2, k - 1, k}
                                          : std::array{k - 1, k - 2, k});
    }
  }
  const auto bytes = encode_draco(mesh, options_for(mesh), DracoColours::linear16);
  ASSERT_TRUE(bytes);
  const auto back = decode_draco(*bytes, DracoColours::linear16);
  ASSERT_TRUE(back);
  ASSERT_EQ(back->vertices.size(), 256u);
  for (std::size_t i = 0; i < 256; ++i) {
    EXPECT_EQ(back->colours[i], mesh.colours[nearest(mesh, back->vertices[i]).first]);
  }
}

TEST(Draco, MeshesOnOneLatticeShareTheirSeamExactly) {
  // Two sheets that meet at x = 1, of different extent: their own boxes would tear the seam.
  const auto sheet = [](float x0, float x1) {
    TriangleMesh mesh;
    for (int i = 0; i <= 40; ++i) {
      const float y = 0.0371f * static_cast<float>(i);
      mesh.vertices.emplace_back(x0, y, 0.3f * y);
      mesh.vertices.emplace_back(x1, y, 0.3f * y);
      const auto k = static_cast<std::uint32_t>(2 * i);
      if (i > 0) {
        mesh.triangles.push_back({k - 2, k - 1, k});
        mesh.triangles.push_back({k - 1, k + 1, k});
      }
    }
    return mesh;
  };
  DracoOptions options;
  options.grid = {{-5, -5, -5}, 20, 16};
  std::vector<std::array<float, 3>> seams[2];
  for (int side = 0; side < 2; ++side) {
    const TriangleMesh mesh = side == 0 ? sheet(0.123f, 1) : sheet(1, 4.567f);
    const auto bytes = encode_draco(mesh, options);
    ASSERT_TRUE(bytes);
    const auto back = decode_draco(*bytes);
    ASSERT_TRUE(back);
    for (const Eigen::Vector3f& v : back->vertices) {
      if (std::abs(v.x() - 1) < 0.01f) seams[side].push_back({v.x(), v.y(), v.z()});
    }
    std::sort(seams[side].begin(), seams[side].end());
  }
  EXPECT_EQ(seams[0].size(), 41u);
  EXPECT_EQ(seams[0], seams[1]);
}

TEST(Draco, TakesDirtyMeshes) {
  TriangleMesh mesh = coloured_sphere({0, 0, 0}, 1, 8, 12);
  const std::size_t clean_triangles = mesh.triangles.size();
  const auto n = static_cast<std::uint32_t>(mesh.vertices.size());
  mesh.triangles.push_back(mesh.triangles[3]);  // twice
  mesh.triangles.push_back({5, 5, 6});          // no area
  mesh.triangles.push_back({0, 1, n + 100});    // out of range
  mesh.vertices.emplace_back(std::numeric_limits<float>::quiet_NaN(), 0.0f, 0.0f);
  mesh.normals.emplace_back(0.0f, 0.0f, 0.0f);
  mesh.colours.push_back({});
  mesh.triangles.push_back({0, 1, n});           // not finite
  mesh.vertices.emplace_back(9.0f, 9.0f, 9.0f);  // unused
  mesh.normals.emplace_back(0.0f, 0.0f, 0.0f);
  mesh.colours.push_back({});
  const TriangleMesh clean = clean_mesh(mesh, grid_around(mesh));
  EXPECT_EQ(clean.triangles.size(), clean_triangles);
  EXPECT_EQ(clean.vertices.size(), n);
  const auto bytes = encode_draco(mesh, options_for(mesh));
  ASSERT_TRUE(bytes) << bytes.error().to_string();
  const auto back = decode_draco(*bytes);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->triangles.size(), clean_triangles);
}

TEST(Draco, TakesNonManifoldMeshes) {
  TriangleMesh mesh;  // seven fins on one edge, some turned round
  mesh.vertices = {{0, 0, 0}, {0, 0, 1}};
  for (int i = 0; i < 7; ++i) {
    mesh.vertices.emplace_back(std::cos(0.9f * static_cast<float>(i)),
                               std::sin(0.9f * static_cast<float>(i)), 0.5f);
    const auto k = static_cast<std::uint32_t>(mesh.vertices.size() - 1);
    mesh.triangles.push_back(i % 3 ? std::array<std::uint32_t, 3>{0, 1, k}
                                   : std::array<std::uint32_t, 3>{1, 0, k});
  }
  const auto bytes = encode_draco(mesh, options_for(mesh));
  ASSERT_TRUE(bytes) << bytes.error().to_string();
  const auto back = decode_draco(*bytes);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->triangles.size(), mesh.triangles.size());
}

TEST(Draco, EmptyAndWrongInputs) {
  const auto empty = encode_draco(TriangleMesh{}, DracoOptions{});
  ASSERT_TRUE(empty);
  EXPECT_TRUE(empty->empty());
  const auto nothing = decode_draco("");
  ASSERT_TRUE(nothing);
  EXPECT_TRUE(nothing->empty());

  const TriangleMesh mesh = coloured_sphere({0, 0, 0}, 1, 6, 8);
  DracoOptions options = options_for(mesh);
  options.grid.range = 0.5f;  // does not hold the mesh
  const auto outside = encode_draco(mesh, options);
  ASSERT_FALSE(outside);
  EXPECT_EQ(outside.error().code, ErrorCode::invalid_argument);
  options.grid.bits = 31;
  EXPECT_FALSE(encode_draco(mesh, options));
}

TEST(Draco, CorruptBytesAreAnErrorNotACrash) {
  const TriangleMesh mesh = coloured_sphere({0, 0, 0}, 1, 12, 16);
  const auto bytes = encode_draco(mesh, options_for(mesh));
  ASSERT_TRUE(bytes);
  for (std::size_t size = 1; size < bytes->size(); size += 7) {
    const auto cut = decode_draco(std::string_view(*bytes).substr(0, size));
    if (!cut) {
      EXPECT_EQ(cut.error().code, ErrorCode::corrupt);
    }
  }
  EXPECT_FALSE(decode_draco(std::string_view(*bytes).substr(0, bytes->size() / 2)));
  EXPECT_FALSE(decode_draco("this is not a mesh at all"));
}

TEST(Draco, ReferenceDecoderReadsOurFiles) {
  if (!has_program("draco_decoder")) GTEST_SKIP() << "draco_decoder is absent (package draco)";
  const TemporaryFolder folder;
  const TriangleMesh mesh = coloured_sphere({3, -2, 10}, 2.5f, 16, 24);
  ASSERT_TRUE(write_mesh(mesh, folder / "mesh.drc"));
  ASSERT_EQ(run_command("draco_decoder -i '" + (folder / "mesh.drc").string() + "' -o '" +
                        (folder / "mesh.ply").string() + "'"),
            0);
  const auto back = read_mesh(folder / "mesh.ply");
  ASSERT_TRUE(back) << back.error().to_string();
  EXPECT_EQ(back->triangles.size(), mesh.triangles.size());
  EXPECT_NEAR(signed_volume(*back), signed_volume(mesh), 0.002 * signed_volume(mesh));
  EXPECT_EQ(back->colours.size(), back->vertices.size());
}

}  // namespace
}  // namespace corvid
