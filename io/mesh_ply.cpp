#include "io/mesh_ply.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <optional>
#include <vector>

namespace corvid {
namespace {

enum class Type { i8, u8, i16, u16, i32, u32, f32, f64 };

std::optional<Type> type_from_name(std::string_view name) {
  if (name == "char" || name == "int8") return Type::i8;
  if (name == "uchar" || name == "uint8") return Type::u8;
  if (name == "short" || name == "int16") return Type::i16;
  if (name == "ushort" || name == "uint16") return Type::u16;
  if (name == "int" || name == "int32") return Type::i32;
  if (name == "uint" || name == "uint32") return Type::u32;
  if (name == "float" || name == "float32") return Type::f32;
  if (name == "double" || name == "float64") return Type::f64;
  return std::nullopt;
}

struct Property {
  std::string name;
  Type type = Type::f32;
  std::optional<Type> count;  ///< of a list
};

struct Element {
  std::string name;
  std::uint64_t count = 0;
  std::vector<Property> properties;
};

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> out;
  std::size_t i = 0;
  while (i < line.size()) {
    const std::size_t begin = line.find_first_not_of(" \t\r", i);
    if (begin == std::string_view::npos) break;
    i = std::min(line.find_first_of(" \t\r", begin), line.size());
    out.push_back(line.substr(begin, i - begin));
  }
  return out;
}

/// Values of the body one after the other; `ok` turns false at the end of the bytes.
class Body {
 public:
  enum class Form { ascii, little, big };
  Body(std::string_view bytes, Form form) : bytes_(bytes), form_(form) {}
  bool ok = true;
  /// Bytes that a value takes at least: bounds counts before memory is taken for them.
  [[nodiscard]] std::size_t left() const { return bytes_.size(); }

  double next(Type type) {
    if (form_ == Form::ascii) return next_word();
    switch (type) {
      case Type::i8:
        return raw<std::int8_t>();
      case Type::u8:
        return raw<std::uint8_t>();
      case Type::i16:
        return raw<std::int16_t>();
      case Type::u16:
        return raw<std::uint16_t>();
      case Type::i32:
        return raw<std::int32_t>();
      case Type::u32:
        return raw<std::uint32_t>();
      case Type::f32:
        return raw<float>();
      case Type::f64:
        return raw<double>();
    }
    return 0;
  }

 private:
  double next_word() {
    const std::size_t begin = bytes_.find_first_not_of(" \t\r\n");
    if (begin == std::string_view::npos) return ok = false, 0;
    bytes_.remove_prefix(begin);
    double value = 0;
    const auto [end, fault] = std::from_chars(bytes_.data(), bytes_.data() + bytes_.size(), value);
    if (fault != std::errc{}) return ok = false, 0;
    bytes_.remove_prefix(static_cast<std::size_t>(end - bytes_.data()));
    return value;
  }
  template <class T>
  double raw() {
    if (bytes_.size() < sizeof(T)) return ok = false, 0;
    char buffer[sizeof(T)];
    std::memcpy(buffer, bytes_.data(), sizeof(T));
    bytes_.remove_prefix(sizeof(T));
    if ((form_ == Form::big) == (std::endian::native == std::endian::little)) {
      std::reverse(buffer, buffer + sizeof(T));
    }
    T value;
    std::memcpy(&value, buffer, sizeof(T));
    return static_cast<double>(value);
  }
  std::string_view bytes_;
  Form form_;
};

std::optional<std::string_view> next_line(std::string_view& bytes) {
  const std::size_t end = bytes.find('\n');
  if (end == std::string_view::npos) return std::nullopt;
  const std::string_view line = bytes.substr(0, end);
  bytes.remove_prefix(end + 1);
  return line;
}

std::uint8_t colour_byte(double value, Type type) {
  if (type == Type::f32 || type == Type::f64) value *= 255;
  if (type == Type::u16) value /= 257;
  return value > 0 ? static_cast<std::uint8_t>(std::lround(std::min(value, 255.0))) : 0;
}

Expected<void> read_vertices(Body& body, const Element& element, TriangleMesh& mesh) {
  constexpr std::string_view kNames[9] = {"x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"};
  int slot_seen[9] = {};
  std::vector<int> slots;
  for (const Property& p : element.properties) {
    int slot = -1;
    for (int i = 0; i < 9; ++i) {
      if (p.name == kNames[i] && !p.count) slot = i;
    }
    if (slot >= 0) ++slot_seen[slot];
    slots.push_back(slot);
  }
  const auto has = [&](int first) {
    return slot_seen[first] && slot_seen[first + 1] && slot_seen[first + 2];
  };
  if (!has(0)) return fail(ErrorCode::corrupt, "the vertices have no x, y, z");
  for (std::uint64_t i = 0; i < element.count; ++i) {
    float value[6] = {};
    std::uint8_t colour[3] = {};
    for (std::size_t k = 0; k < slots.size(); ++k) {
      const Property& p = element.properties[k];
      if (p.count) {
        for (double left = body.next(*p.count); left >= 1 && body.ok; --left) body.next(p.type);
        continue;
      }
      const double v = body.next(p.type);
      if (slots[k] >= 6) colour[slots[k] - 6] = colour_byte(v, p.type);
      if (slots[k] >= 0 && slots[k] < 6) value[slots[k]] = static_cast<float>(v);
    }
    if (!body.ok) {
      return fail(ErrorCode::corrupt, fmt::format("the file ends or is garbled at vertex {}", i));
    }
    mesh.vertices.emplace_back(value[0], value[1], value[2]);
    if (has(3)) mesh.normals.emplace_back(value[3], value[4], value[5]);
    if (has(6)) mesh.colours.push_back({colour[0], colour[1], colour[2]});
  }
  return {};
}

Expected<void> read_faces(Body& body, const Element& element, TriangleMesh& mesh) {
  for (std::uint64_t i = 0; i < element.count; ++i) {
    for (const Property& p : element.properties) {
      if (!p.count) {
        body.next(p.type);
        continue;
      }
      const bool corners = p.name == "vertex_indices" || p.name == "vertex_index";
      const double count = body.next(*p.count);
      std::uint32_t first = 0, last = 0;
      for (double k = 0; k < count && body.ok; ++k) {
        const double v = body.next(p.type);
        if (!corners || !body.ok) continue;
        if (!(v >= 0) || v >= static_cast<double>(mesh.vertices.size())) {
          return fail(ErrorCode::corrupt,
                      fmt::format("face {} names a vertex that is not there", i));
        }
        const auto corner = static_cast<std::uint32_t>(v);
        if (k == 0) first = corner;
        if (k >= 2) mesh.triangles.push_back({first, last, corner});
        last = corner;
      }
    }
    if (!body.ok) {
      return fail(ErrorCode::corrupt, fmt::format("the file ends or is garbled at face {}", i));
    }
  }
  return {};
}

}  // namespace

std::string encode_ply(const TriangleMesh& mesh) {
  const std::size_t n = mesh.vertices.size();
  const bool normals = n > 0 && mesh.normals.size() == n;
  const bool colours = n > 0 && mesh.colours.size() == n;
  std::string out = fmt::format(
      "ply\nformat binary_little_endian 1.0\ncomment corvid; x right, y down, z forward of the "
      "first camera\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n",
      n);
  if (normals) out += "property float nx\nproperty float ny\nproperty float nz\n";
  if (colours) out += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
  if (!mesh.triangles.empty()) {
    out += fmt::format("element face {}\nproperty list uchar int vertex_indices\n",
                       mesh.triangles.size());
  }
  out += "end_header\n";
  static_assert(std::endian::native == std::endian::little);
  for (std::size_t i = 0; i < n; ++i) {
    out.append(reinterpret_cast<const char*>(mesh.vertices[i].data()), 12);
    if (normals) out.append(reinterpret_cast<const char*>(mesh.normals[i].data()), 12);
    if (colours) out.append(reinterpret_cast<const char*>(&mesh.colours[i]), 3);
  }
  for (const auto& t : mesh.triangles) {
    out.push_back(3);
    out.append(reinterpret_cast<const char*>(t.data()), 12);
  }
  return out;
}

Expected<TriangleMesh> decode_ply(std::string_view bytes) {
  auto line = next_line(bytes);
  if (!line || !line->starts_with("ply")) return fail(ErrorCode::corrupt, "not a PLY file");
  std::optional<Body::Form> form;
  std::vector<Element> elements;
  while (true) {
    line = next_line(bytes);
    if (!line) return fail(ErrorCode::corrupt, "the PLY header has no end");
    const auto words = words_of(*line);
    if (words.empty() || words[0] == "comment" || words[0] == "obj_info") continue;
    if (words[0] == "end_header") break;
    const auto wrong = [&] {
      return fail(ErrorCode::corrupt, fmt::format("PLY header line not understood: {}", *line));
    };
    if (words[0] == "format" && words.size() >= 2) {
      if (words[1] == "ascii") form = Body::Form::ascii;
      if (words[1] == "binary_little_endian") form = Body::Form::little;
      if (words[1] == "binary_big_endian") form = Body::Form::big;
    } else if (words[0] == "element" && words.size() == 3) {
      Element element{std::string(words[1]), 0, {}};
      const char* end = words[2].data() + words[2].size();
      if (std::from_chars(words[2].data(), end, element.count).ptr != end) return wrong();
      elements.push_back(element);
    } else if (words[0] == "property" && !elements.empty() && words.size() == 3) {
      const auto type = type_from_name(words[1]);
      if (!type) return wrong();
      elements.back().properties.push_back({std::string(words[2]), *type, std::nullopt});
    } else if (words[0] == "property" && !elements.empty() && words.size() == 5 &&
               words[1] == "list") {
      const auto count = type_from_name(words[2]), type = type_from_name(words[3]);
      if (!type || !count) return wrong();
      elements.back().properties.push_back({std::string(words[4]), *type, count});
    } else {
      return wrong();
    }
  }
  if (!form) return fail(ErrorCode::corrupt, "the PLY header names no known format");

  TriangleMesh mesh;
  Body body(bytes, *form);
  for (const Element& element : elements) {
    if (element.properties.empty()) continue;
    if (element.count > body.left()) {
      return fail(ErrorCode::corrupt, fmt::format("the file ends before its {} elements \"{}\"",
                                                  element.count, element.name));
    }
    Expected<void> ok;
    if (element.name == "vertex") {
      ok = read_vertices(body, element, mesh);
    } else if (element.name == "face") {
      ok = read_faces(body, element, mesh);
    } else {
      TriangleMesh skipped;  // lists in elements that we do not know are walked as faces are
      Element unknown = element;
      for (Property& p : unknown.properties) p.name.clear();
      ok = read_faces(body, unknown, skipped);
    }
    if (!ok) return tl::unexpected(ok.error());
  }
  return mesh;
}

std::string encode_obj(const TriangleMesh& mesh) {
  const std::size_t n = mesh.vertices.size();
  const bool normals = n > 0 && mesh.normals.size() == n;
  const bool colours = n > 0 && mesh.colours.size() == n;
  std::string out = "# corvid; x right, y down, z forward of the first camera\n";
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Vector3f& v = mesh.vertices[i];
    out += fmt::format("v {} {} {}", v.x(), v.y(), v.z());
    if (colours) {
      const Rgb8 c = mesh.colours[i];
      out += fmt::format(" {:.6f} {:.6f} {:.6f}", c.r / 255.0, c.g / 255.0, c.b / 255.0);
    }
    out += '\n';
  }
  for (std::size_t i = 0; normals && i < n; ++i) {
    const Eigen::Vector3f& v = mesh.normals[i];
    out += fmt::format("vn {} {} {}\n", v.x(), v.y(), v.z());
  }
  for (const auto& t : mesh.triangles) {
    out += normals ? fmt::format("f {0}//{0} {1}//{1} {2}//{2}\n", t[0] + 1, t[1] + 1, t[2] + 1)
                   : fmt::format("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1);
  }
  return out;
}

Expected<TriangleMesh> decode_obj(std::string_view text) {
  TriangleMesh mesh;
  std::vector<Eigen::Vector3f> normals;
  std::vector<int> normal_of;
  bool coloured = true;
  const auto number = [](std::string_view word, auto& value) {
    const char* end = word.data() + word.size();
    const auto r = std::from_chars(word.data(), end, value);
    return r.ec == std::errc{} && r.ptr == end;
  };
  /// "7", "-1": position in a list of `size`, or -1.
  const auto resolve = [&](std::string_view word, std::size_t size) -> std::int64_t {
    std::int64_t i = 0;
    if (!number(word, i)) return -1;
    i = i < 0 ? static_cast<std::int64_t>(size) + i : i - 1;
    return i >= 0 && i < static_cast<std::int64_t>(size) ? i : -1;
  };
  int line_number = 0;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    const auto words = words_of(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
    ++line_number;
    const auto wrong = [&](const char* what) {
      return fail(ErrorCode::corrupt, fmt::format("line {}: {}", line_number, what));
    };
    if (words.empty()) continue;
    if (words[0] == "v" || words[0] == "vn") {
      double value[6] = {};
      const std::size_t count = std::min<std::size_t>(words.size() - 1, 6);
      for (std::size_t i = 0; i < count; ++i) {
        if (!number(words[i + 1], value[i])) return wrong("not a number");
      }
      if (count < 3) return wrong("fewer than three numbers");
      const Eigen::Vector3f p = Eigen::Vector3d(value[0], value[1], value[2]).cast<float>();
      if (words[0] == "vn") {
        normals.push_back(p);
        continue;
      }
      mesh.vertices.push_back(p);
      normal_of.push_back(-1);
      coloured = coloured && count == 6;
      mesh.colours.push_back({colour_byte(value[3], Type::f64), colour_byte(value[4], Type::f64),
                              colour_byte(value[5], Type::f64)});
    } else if (words[0] == "f") {
      std::vector<std::uint32_t> corners;
      for (std::size_t k = 1; k < words.size(); ++k) {
        const std::size_t slash = words[k].find('/');
        const std::int64_t v = resolve(words[k].substr(0, slash), mesh.vertices.size());
        if (v < 0) return wrong("a face names a vertex that is not there");
        corners.push_back(static_cast<std::uint32_t>(v));
        const std::size_t last = words[k].rfind('/');
        if (last == std::string_view::npos || last == slash || last + 1 == words[k].size())
          continue;
        const std::int64_t vn = resolve(words[k].substr(last + 1), normals.size());
        if (vn < 0) return wrong("a face names a normal that is not there");
        normal_of[static_cast<std::size_t>(v)] = static_cast<int>(vn);
      }
      if (corners.size() < 3) return wrong("a face with fewer than three corners");
      for (std::size_t k = 2; k < corners.size(); ++k) {
        mesh.triangles.push_back({corners[0], corners[k - 1], corners[k]});
      }
    }
  }
  if (!coloured) mesh.colours.clear();
  const bool all_normals =
      std::all_of(normal_of.begin(), normal_of.end(), [](int i) { return i >= 0; });
  if (all_normals) {
    for (const int i : normal_of) mesh.normals.push_back(normals[static_cast<std::size_t>(i)]);
  }
  return mesh;
}

}  // namespace corvid
