#include "io/mesh_files.h"

#include <algorithm>
#include <cctype>

#include "io/atomic_file.h"
#include "io/draco.h"
#include "io/gltf.h"
#include "io/mesh_ply.h"

namespace corvid {
namespace {

std::optional<MeshFormat> format_of(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension.empty() ? std::nullopt : mesh_format_from_name(extension.substr(1));
}

tl::unexpected<Error> unknown_format(const std::filesystem::path& path) {
  return fail(ErrorCode::invalid_argument, "the file name does not tell a mesh format",
              path.string(), "end it in .ply, .obj, .drc or .glb");
}

}  // namespace

std::optional<MeshFormat> mesh_format_from_name(std::string_view name) {
  if (name == "ply") return MeshFormat::ply;
  if (name == "obj") return MeshFormat::obj;
  if (name == "drc") return MeshFormat::drc;
  if (name == "glb") return MeshFormat::glb;
  if (name == "glb-plain") return MeshFormat::glb_plain;
  return std::nullopt;
}

Expected<std::string> encode_mesh(const TriangleMesh& mesh, MeshFormat format,
                                  const MeshWriteOptions& options) {
  DracoOptions draco;
  draco.grid = grid_around(mesh, options.max_step);
  switch (format) {
    case MeshFormat::ply:
      return encode_ply(mesh);
    case MeshFormat::obj:
      return encode_obj(mesh);
    case MeshFormat::drc:
      return encode_draco(mesh, draco);
    case MeshFormat::glb:
      return encode_glb(mesh, GlbCompression::draco, draco, options.z_up);
    case MeshFormat::glb_plain:
      return encode_glb(mesh, GlbCompression::none, draco, options.z_up);
  }
  return fail(ErrorCode::invalid_argument, "unknown mesh format");
}

Expected<void> write_mesh(const TriangleMesh& mesh, const std::filesystem::path& path,
                          std::optional<MeshFormat> format, const MeshWriteOptions& options) {
  if (!format) format = format_of(path);
  if (!format) return unknown_format(path);
  const auto bytes = encode_mesh(mesh, *format, options);
  if (!bytes) return tl::unexpected(bytes.error());
  return write_file_atomically(path, *bytes);
}

Expected<TriangleMesh> read_mesh(const std::filesystem::path& path) {
  const auto format = format_of(path);
  if (!format) return unknown_format(path);
  const auto bytes = read_file_bytes(path);
  if (!bytes) return tl::unexpected(bytes.error());
  Expected<TriangleMesh> mesh = *format == MeshFormat::ply   ? decode_ply(*bytes)
                                : *format == MeshFormat::obj ? decode_obj(*bytes)
                                : *format == MeshFormat::drc ? decode_draco(*bytes)
                                                             : decode_glb(*bytes);
  if (!mesh) {
    Error error = mesh.error();
    error.where = path.string();
    return tl::unexpected(std::move(error));
  }
  return mesh;
}

}  // namespace corvid
