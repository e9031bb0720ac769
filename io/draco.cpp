#include "io/draco.h"

#include <draco/compression/decode.h>
#include <draco/compression/expert_encode.h>
#include <draco/mesh/mesh.h>
#include <fmt/format.h>

#include <cmath>
#include <exception>
#include <memory>

#include "io/colour_space.h"

namespace corvid {
namespace {

int add_attribute(draco::Mesh& target, draco::GeometryAttribute::Type type, draco::DataType data,
                  bool normalized, int unique_id, std::size_t count) {
  draco::GeometryAttribute attribute;
  attribute.Init(type, nullptr, 3, data, normalized, 3 * draco::DataTypeLength(data), 0);
  const int id = target.AddAttribute(attribute, true, static_cast<std::uint32_t>(count));
  target.attribute(id)->set_unique_id(static_cast<std::uint32_t>(unique_id));
  return id;
}

template <class T>
void set_values(draco::Mesh& target, int id, const std::vector<T>& values) {
  for (std::uint32_t i = 0; i < values.size(); ++i) {
    target.attribute(id)->SetAttributeValue(draco::AttributeValueIndex(i), &values[i]);
  }
}

/// Unsigned integer value of a colour channel as a share of 1.
double channel(const draco::PointAttribute& attribute, draco::AttributeValueIndex index,
               int component) {
  float value[4] = {};
  if (!attribute.ConvertValue<float, 4>(index, value)) return 0;
  const double full = attribute.data_type() == draco::DT_UINT8    ? 255.0
                      : attribute.data_type() == draco::DT_UINT16 ? 65535.0
                                                                  : 1.0;
  // Draco itself scales normalized integers when it converts them to float.
  return attribute.normalized() ? value[component] : value[component] / full;
}

}  // namespace

Expected<std::string> encode_draco(const TriangleMesh& mesh, const DracoOptions& options,
                                   DracoColours colours) {
  const QuantizationGrid& grid = options.grid;
  if (grid.bits < 1 || grid.bits > 30 || !(grid.range > 0) || !std::isfinite(grid.range) ||
      !grid.origin.allFinite() || options.speed < 0 || options.speed > 10 ||
      options.normal_bits < 2 || options.normal_bits > 30) {
    return fail(ErrorCode::invalid_argument, "Draco options are out of range", "mesh encoder",
                "bits 1 to 30, range above 0, speed 0 to 10, normal bits 2 to 30");
  }
  const TriangleMesh clean = clean_mesh(mesh, grid);
  if (clean.empty()) return std::string();
  for (const Eigen::Vector3f& v : clean.vertices) {
    if (grid.encloses(v)) continue;
    return fail(
        ErrorCode::invalid_argument,
        fmt::format("vertex ({}, {}, {}) lies outside the quantization cube", v.x(), v.y(), v.z()),
        "mesh encoder");
  }

  draco::Mesh target;
  const std::size_t n = clean.vertices.size();
  target.set_num_points(static_cast<std::uint32_t>(n));
  target.SetNumFaces(clean.triangles.size());
  for (std::uint32_t i = 0; i < clean.triangles.size(); ++i) {
    const auto& t = clean.triangles[i];
    target.SetFace(draco::FaceIndex(i),
                   {draco::PointIndex(t[0]), draco::PointIndex(t[1]), draco::PointIndex(t[2])});
  }
  const int position = add_attribute(target, draco::GeometryAttribute::POSITION, draco::DT_FLOAT32,
                                     false, kDracoPositionId, n);
  set_values(target, position, clean.vertices);
  int normal = -1;
  if (!clean.normals.empty()) {
    normal = add_attribute(target, draco::GeometryAttribute::NORMAL, draco::DT_FLOAT32, false,
                           kDracoNormalId, n);
    set_values(target, normal, clean.normals);
  }
  if (!clean.colours.empty() && colours == DracoColours::srgb8) {
    const int id = add_attribute(target, draco::GeometryAttribute::COLOR, draco::DT_UINT8, true,
                                 kDracoColourId, n);
    set_values(target, id, clean.colours);
  } else if (!clean.colours.empty()) {
    std::vector<std::array<std::uint16_t, 3>> linear(n);
    for (std::size_t i = 0; i < n; ++i) {
      const Rgb8 c = clean.colours[i];
      linear[i] = {srgb8_to_linear16(c.r), srgb8_to_linear16(c.g), srgb8_to_linear16(c.b)};
    }
    const int id = add_attribute(target, draco::GeometryAttribute::COLOR, draco::DT_UINT16, true,
                                 kDracoColourId, n);
    set_values(target, id, linear);
  }

  const auto encode = [&](int method, draco::EncoderBuffer& out) {
    draco::ExpertEncoder encoder(target);
    encoder.SetSpeedOptions(options.speed, options.speed);
    encoder.SetAttributeExplicitQuantization(position, grid.bits, 3, grid.origin.data(),
                                             grid.range);
    if (normal >= 0) encoder.SetAttributeQuantization(normal, options.normal_bits);
    encoder.SetEncodingMethod(method);
    return encoder.EncodeToBuffer(&out);
  };
  draco::EncoderBuffer buffer;
  draco::Status status = encode(draco::MESH_EDGEBREAKER_ENCODING, buffer);
  if (!status.ok()) {  // connectivity that edgebreaker cannot walk; plain indices always work
    buffer.Clear();
    status = encode(draco::MESH_SEQUENTIAL_ENCODING, buffer);
  }
  if (!status.ok()) {
    return fail(ErrorCode::io, fmt::format("Draco refuses the mesh: {}", status.error_msg_string()),
                "mesh encoder");
  }
  return std::string(buffer.data(), buffer.size());
}

Expected<TriangleMesh> decode_draco(std::string_view bytes, DracoColours colours) {
  if (bytes.empty()) return TriangleMesh{};
  std::unique_ptr<draco::Mesh> source;
  try {
    draco::DecoderBuffer buffer;
    buffer.Init(bytes.data(), bytes.size());
    draco::Decoder decoder;
    auto decoded = decoder.DecodeMeshFromBuffer(&buffer);
    if (!decoded.ok()) {
      return fail(ErrorCode::corrupt,
                  fmt::format("not a Draco mesh: {}", decoded.status().error_msg_string()));
    }
    source = std::move(decoded).value();
  } catch (const std::exception& e) {  // a corrupt count asks for more memory than there is
    return fail(ErrorCode::corrupt, fmt::format("not a Draco mesh: {}", e.what()));
  }
  const auto* position = source->GetNamedAttribute(draco::GeometryAttribute::POSITION);
  if (!position || position->num_components() != 3) {
    return fail(ErrorCode::corrupt, "the Draco mesh has no positions");
  }
  const auto* normal = source->GetNamedAttribute(draco::GeometryAttribute::NORMAL);
  const auto* colour = source->GetNamedAttribute(draco::GeometryAttribute::COLOR);
  if (colour && colour->num_components() < 3) colour = nullptr;

  TriangleMesh mesh;
  const std::uint32_t n = source->num_points();
  mesh.vertices.resize(n);
  if (normal) mesh.normals.resize(n);
  if (colour) mesh.colours.resize(n);
  for (std::uint32_t i = 0; i < n; ++i) {
    const draco::PointIndex point(i);
    if (!position->ConvertValue<float, 3>(position->mapped_index(point), mesh.vertices[i].data()) ||
        !mesh.vertices[i].allFinite()) {
      return fail(ErrorCode::corrupt, fmt::format("position of vertex {} is not valid", i));
    }
    if (normal) normal->ConvertValue<float, 3>(normal->mapped_index(point), mesh.normals[i].data());
    if (colour) {
      const auto index = colour->mapped_index(point);
      std::uint8_t* out[3] = {&mesh.colours[i].r, &mesh.colours[i].g, &mesh.colours[i].b};
      for (int c = 0; c < 3; ++c) {
        const double value = channel(*colour, index, c);
        *out[c] = colours == DracoColours::linear16
                      ? linear_to_srgb8(value)
                      : static_cast<std::uint8_t>(
                            std::lround(value > 0 ? 255.0 * std::min(value, 1.0) : 0.0));
      }
    }
  }
  mesh.triangles.reserve(source->num_faces());
  for (std::uint32_t i = 0; i < source->num_faces(); ++i) {
    const auto& face = source->face(draco::FaceIndex(i));
    std::array<std::uint32_t, 3> t{};
    for (std::size_t k = 0; k < 3; ++k) {
      t[k] = face[k].value();
      if (t[k] >= n) return fail(ErrorCode::corrupt, fmt::format("triangle {} is not valid", i));
    }
    mesh.triangles.push_back(t);
  }
  return mesh;
}

}  // namespace corvid
