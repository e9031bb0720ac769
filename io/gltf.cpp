#include "io/gltf.h"

#include <bit>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "io/colour_space.h"

namespace corvid {
namespace {

using Json = nlohmann::ordered_json;
static_assert(std::endian::native == std::endian::little, "glTF is little-endian");

// glTF 2.0, 4.4.1 (binary container) and 5.1.3 (component types).
constexpr std::uint32_t kMagic = 0x46546C67, kJsonChunk = 0x4E4F534A, kBinChunk = 0x004E4942;
constexpr int kUnsignedShort = 5123, kUnsignedInt = 5125, kFloat = 5126;
constexpr int kArrayBuffer = 34962, kElementArrayBuffer = 34963;
constexpr std::size_t kColourStride = 8;  // three 16-bit values, padded to a multiple of four bytes

void append(std::string& out, const void* data, std::size_t size) {
  out.append(static_cast<const char*>(data), size);
}

void append_u32(std::string& out, std::uint32_t value) { append(out, &value, 4); }

std::string container(const Json& json, std::string binary) {
  std::string text = json.dump();
  text.resize((text.size() + 3) / 4 * 4, ' ');
  binary.resize((binary.size() + 3) / 4 * 4, '\0');
  std::string out;
  append_u32(out, kMagic);
  append_u32(out, 2);
  const std::size_t total = 12 + 8 + text.size() + (binary.empty() ? 0 : 8 + binary.size());
  append_u32(out, static_cast<std::uint32_t>(total));
  append_u32(out, static_cast<std::uint32_t>(text.size()));
  append_u32(out, kJsonChunk);
  out += text;
  if (!binary.empty()) {
    append_u32(out, static_cast<std::uint32_t>(binary.size()));
    append_u32(out, kBinChunk);
    out += binary;
  }
  return out;
}

/// Counts and bounds of the attributes: the same for both kinds of file.
Json accessors_of(const TriangleMesh& mesh) {
  Eigen::Vector3f low = mesh.vertices.front(), high = low;
  for (const Eigen::Vector3f& v : mesh.vertices) {
    low = low.cwiseMin(v);
    high = high.cwiseMax(v);
  }
  const std::size_t n = mesh.vertices.size();
  Json out = Json::array();
  out.push_back(
      {{"componentType", kUnsignedInt}, {"count", mesh.triangles.size() * 3}, {"type", "SCALAR"}});
  out.push_back({{"componentType", kFloat},
                 {"count", n},
                 {"type", "VEC3"},
                 {"min", {low.x(), low.y(), low.z()}},
                 {"max", {high.x(), high.y(), high.z()}}});
  if (!mesh.normals.empty()) {
    out.push_back({{"componentType", kFloat}, {"count", n}, {"type", "VEC3"}});
  }
  if (!mesh.colours.empty()) {
    out.push_back(
        {{"componentType", kUnsignedShort}, {"normalized", true}, {"count", n}, {"type", "VEC3"}});
  }
  return out;
}

Json frame_of_file(const TriangleMesh& mesh, bool z_up) {
  Json json;
  json["asset"] = {{"version", "2.0"}, {"generator", "corvid"}};
  json["scene"] = 0;
  if (mesh.empty()) {
    json["scenes"] = Json::array({{{"name", "empty"}}});
    return json;
  }
  json["scenes"] = Json::array({{{"nodes", {0}}}});
  // About x: half a turn makes y up, z backward of our y down, z forward; a quarter back of z up.
  const double quarter = std::sqrt(0.5);
  const Json rotation = z_up ? Json({-quarter, 0, 0, quarter}) : Json({1, 0, 0, 0});
  json["nodes"] = Json::array({{{"name", "world"}, {"mesh", 0}, {"rotation", rotation}}});
  Json attributes = {{"POSITION", 1}};
  int next = 2;
  if (!mesh.normals.empty()) attributes["NORMAL"] = next++;
  if (!mesh.colours.empty()) attributes["COLOR_0"] = next;
  Json primitive = {{"attributes", attributes}, {"indices", 0}, {"material", 0}, {"mode", 4}};
  json["meshes"] = Json::array({{{"primitives", Json::array({primitive})}}});
  Json material = {{"name", "surface"},
                   {"doubleSided", true},
                   {"pbrMetallicRoughness", {{"metallicFactor", 0}, {"roughnessFactor", 1}}}};
  json["extensionsUsed"] = Json::array();
  if (!mesh.colours.empty()) {
    material["extensions"] = {{"KHR_materials_unlit", Json::object()}};
    json["extensionsUsed"].push_back("KHR_materials_unlit");
  }
  json["materials"] = Json::array({material});
  json["accessors"] = accessors_of(mesh);
  return json;
}

std::string encode_plain(const TriangleMesh& mesh, bool z_up) {
  Json json = frame_of_file(mesh, z_up);
  if (json["extensionsUsed"].empty()) json.erase("extensionsUsed");
  std::string binary;
  Json views = Json::array();
  const auto add_view = [&](std::size_t begin, int target, std::size_t stride) {
    json["accessors"][views.size()]["bufferView"] = views.size();
    Json view = {{"buffer", 0}, {"byteOffset", begin}, {"byteLength", binary.size() - begin}};
    if (stride > 0) view["byteStride"] = stride;
    view["target"] = target;
    views.push_back(view);
  };
  append(binary, mesh.triangles.data(), mesh.triangles.size() * 12);
  add_view(0, kElementArrayBuffer, 0);
  std::size_t begin = binary.size();
  append(binary, mesh.vertices.data(), mesh.vertices.size() * 12);
  add_view(begin, kArrayBuffer, 12);
  if (!mesh.normals.empty()) {
    begin = binary.size();
    append(binary, mesh.normals.data(), mesh.normals.size() * 12);
    add_view(begin, kArrayBuffer, 12);
  }
  if (!mesh.colours.empty()) {
    begin = binary.size();
    for (const Rgb8& c : mesh.colours) {
      const std::uint16_t linear[4] = {srgb8_to_linear16(c.r), srgb8_to_linear16(c.g),
                                       srgb8_to_linear16(c.b), 0};
      append(binary, linear, kColourStride);
    }
    add_view(begin, kArrayBuffer, kColourStride);
  }
  json["bufferViews"] = views;
  json["buffers"] = Json::array({{{"byteLength", binary.size()}}});
  return container(json, std::move(binary));
}

Expected<std::string> encode_compressed(const TriangleMesh& mesh, const DracoOptions& options,
                                        bool z_up) {
  auto bytes = encode_draco(mesh, options, DracoColours::linear16);
  if (!bytes) return bytes;
  // The accessors must tell what a decoder will find, and Draco splits and drops vertices.
  const auto decoded = decode_draco(*bytes, DracoColours::linear16);
  if (!decoded) return tl::unexpected(decoded.error());
  Json json = frame_of_file(*decoded, z_up);
  if (!decoded->empty()) {
    Json ids = {{"POSITION", kDracoPositionId}};
    if (!decoded->normals.empty()) ids["NORMAL"] = kDracoNormalId;
    if (!decoded->colours.empty()) ids["COLOR_0"] = kDracoColourId;
    json["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"] = {
        {"bufferView", 0}, {"attributes", ids}};
    json["extensionsUsed"].push_back("KHR_draco_mesh_compression");
    json["extensionsRequired"] = {"KHR_draco_mesh_compression"};
    json["bufferViews"] =
        Json::array({{{"buffer", 0}, {"byteOffset", 0}, {"byteLength", bytes->size()}}});
    json["buffers"] = Json::array({{{"byteLength", bytes->size()}}});
  }
  return container(json, std::move(*bytes));
}

/// The bytes of one accessor, element by element; throws std::out_of_range where the file lies.
class Elements {
 public:
  Elements(const Json& json, std::string_view binary, std::size_t accessor,
           std::size_t element_size) {
    const Json& a = json.at("accessors").at(accessor);
    const Json& view = json.at("bufferViews").at(a.at("bufferView").get<std::size_t>());
    count_ = a.at("count").get<std::size_t>();
    stride_ = view.value("byteStride", element_size);
    size_ = element_size;
    const std::size_t begin = view.value("byteOffset", std::size_t{0});
    const std::size_t length = view.at("byteLength").get<std::size_t>();
    if (begin > binary.size() || length > binary.size() - begin) {
      throw std::out_of_range("a buffer view leaves the file");
    }
    bytes_ = binary.substr(begin, length);
    bytes_.remove_prefix(std::min(bytes_.size(), a.value("byteOffset", std::size_t{0})));
    if (stride_ < size_ ||
        (count_ > 0 && (bytes_.size() < size_ || (bytes_.size() - size_) / stride_ < count_ - 1))) {
      throw std::out_of_range("an accessor leaves its buffer view");
    }
  }
  [[nodiscard]] std::size_t count() const { return count_; }
  void read(std::size_t i, void* out) const {
    std::memcpy(out, bytes_.data() + i * stride_, size_);
  }

 private:
  std::string_view bytes_;
  std::size_t count_ = 0, stride_ = 0, size_ = 0;
};

TriangleMesh read_plain(const Json& json, std::string_view binary, const Json& primitive) {
  TriangleMesh mesh;
  const Json& attributes = primitive.at("attributes");
  const auto component = [&](std::size_t accessor) {
    return json.at("accessors").at(accessor).at("componentType").get<int>();
  };
  const auto position = attributes.at("POSITION").get<std::size_t>();
  const auto indices = primitive.at("indices").get<std::size_t>();
  if (component(position) != kFloat || component(indices) != kUnsignedInt) {
    throw std::out_of_range("component types other than corvid's");
  }
  const Elements vertices(json, binary, position, 12);
  mesh.vertices.resize(vertices.count());
  for (std::size_t i = 0; i < vertices.count(); ++i) vertices.read(i, mesh.vertices[i].data());
  if (attributes.contains("NORMAL")) {
    const Elements normals(json, binary, attributes["NORMAL"].get<std::size_t>(), 12);
    mesh.normals.resize(normals.count());
    for (std::size_t i = 0; i < normals.count(); ++i) normals.read(i, mesh.normals[i].data());
  }
  if (attributes.contains("COLOR_0")) {
    const auto id = attributes["COLOR_0"].get<std::size_t>();
    if (component(id) != kUnsignedShort) throw std::out_of_range("colours are not 16 bit");
    const Elements colours(json, binary, id, 6);
    mesh.colours.resize(colours.count());
    for (std::size_t i = 0; i < colours.count(); ++i) {
      std::uint16_t c[3];
      colours.read(i, c);
      mesh.colours[i] = {linear_to_srgb8(c[0] / 65535.0), linear_to_srgb8(c[1] / 65535.0),
                         linear_to_srgb8(c[2] / 65535.0)};
    }
  }
  const std::size_t n = mesh.vertices.size();
  if ((!mesh.normals.empty() && mesh.normals.size() != n) ||
      (!mesh.colours.empty() && mesh.colours.size() != n)) {
    throw std::out_of_range("attributes differ in length");
  }
  const Elements corners(json, binary, indices, 4);
  mesh.triangles.resize(corners.count() / 3);
  for (std::size_t i = 0; i < mesh.triangles.size() * 3; ++i) {
    std::uint32_t& corner = mesh.triangles[i / 3][i % 3];
    corners.read(i, &corner);
    if (corner >= n) throw std::out_of_range("an index leaves the vertices");
  }
  return mesh;
}

}  // namespace

Expected<std::string> encode_glb(const TriangleMesh& mesh, GlbCompression compression,
                                 const DracoOptions& options, bool z_up) {
  const TriangleMesh clean = clean_mesh(mesh, options.grid);
  if (clean.empty()) return container(frame_of_file(clean, z_up), {});
  // Sizes in the container are 32 bit: 36 bytes per vertex and 12 per triangle at most.
  if (clean.vertices.size() * 36 + clean.triangles.size() * 12 > 0xF0000000u) {
    return fail(ErrorCode::unsupported, "the mesh is too large for one glTF file", "mesh encoder",
                "export it as ply");
  }
  return compression == GlbCompression::draco ? encode_compressed(clean, options, z_up)
                                              : Expected<std::string>(encode_plain(clean, z_up));
}

Expected<TriangleMesh> decode_glb(std::string_view bytes) {
  const auto u32 = [&](std::size_t at) {
    std::uint32_t value = 0;
    std::memcpy(&value, bytes.data() + at, 4);
    return value;
  };
  if (bytes.size() < 20 || u32(0) != kMagic || u32(4) != 2 || u32(16) != kJsonChunk ||
      u32(12) > bytes.size() - 20) {
    return fail(ErrorCode::corrupt, "not a binary glTF 2.0 file, or one that was cut short");
  }
  const std::string_view text = bytes.substr(20, u32(12));
  std::string_view binary;
  const std::size_t next = 20 + text.size();
  if (bytes.size() >= next + 8 && u32(next + 4) == kBinChunk) {
    if (u32(next) > bytes.size() - next - 8) {
      return fail(ErrorCode::corrupt, "the glTF file was cut short");
    }
    binary = bytes.substr(next + 8, u32(next));
  }
  try {
    const Json json = Json::parse(text);
    if (!json.contains("meshes")) return TriangleMesh{};
    const Json& primitives = json.at("meshes").at(0).at("primitives");
    if (json["meshes"].size() != 1 || primitives.size() != 1) {
      return fail(ErrorCode::unsupported, "the glTF file has more than one mesh", {},
                  "only files that corvid wrote are read");
    }
    const Json& primitive = primitives.at(0);
    const Json* draco = nullptr;
    if (primitive.contains("extensions") &&
        primitive["extensions"].contains("KHR_draco_mesh_compression")) {
      draco = &primitive["extensions"]["KHR_draco_mesh_compression"];
    }
    if (!draco) return read_plain(json, binary, primitive);
    const Json& view = json.at("bufferViews").at(draco->at("bufferView").get<std::size_t>());
    const std::size_t begin = view.value("byteOffset", std::size_t{0});
    const std::size_t length = view.at("byteLength").get<std::size_t>();
    if (begin > binary.size() || length > binary.size() - begin) {
      return fail(ErrorCode::corrupt, "a buffer view leaves the file");
    }
    return decode_draco(binary.substr(begin, length), DracoColours::linear16);
  } catch (const std::exception& e) {
    return fail(ErrorCode::corrupt, std::string("the glTF file is not well-formed: ") + e.what());
  }
}

}  // namespace corvid
