// Writes one mesh of each kind into the folder that is given.
#include <cstdio>
#include <filesystem>

#include "io/mesh_files.h"
#include "scenes/mesh_shapes.h"

int main(int argc, char** argv) {
  using namespace corvid;
  if (argc != 2) {
    std::fprintf(stderr, "usage: %s FOLDER\n", argv[0]);
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  const TriangleMesh full = coloured_sphere({1, -2, 8}, 2, 24, 36);
  TriangleMesh bare = full;
  bare.normals.clear();
  bare.colours.clear();
  TriangleMesh fins;  // non-manifold: Draco splits the vertices of the common edge
  fins.vertices = {{0, 0, 0}, {0, 0, 1}};
  for (int i = 0; i < 5; ++i) {
    fins.vertices.emplace_back(static_cast<float>(i - 2), 1.0f, 0.5f);
    fins.triangles.push_back({0, 1, static_cast<std::uint32_t>(i + 2)});
  }
  int faults = 0;
  const auto write = [&](const TriangleMesh& mesh, const char* name, MeshFormat format) {
    const auto ok = write_mesh(mesh, folder / name, format);
    if (ok) return;
    std::fprintf(stderr, "%s\n", ok.error().to_string().c_str());
    ++faults;
  };
  write(full, "plain.glb", MeshFormat::glb_plain);
  write(full, "draco.glb", MeshFormat::glb);
  write(bare, "bare_plain.glb", MeshFormat::glb_plain);
  write(bare, "bare_draco.glb", MeshFormat::glb);
  write(fins, "fins_draco.glb", MeshFormat::glb);
  write({}, "empty.glb", MeshFormat::glb);
  write(full, "full.drc", MeshFormat::drc);
  return faults == 0 ? 0 : 1;
}
