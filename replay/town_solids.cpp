#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "replay/random.h"
#include "replay/town.h"

namespace corvid {
namespace {
using Colour = Eigen::Vector3f;

const std::array<Colour, 7> kPlaster = {Colour{0.62f, 0.55f, 0.42f}, {0.66f, 0.63f, 0.58f},
                                        {0.55f, 0.36f, 0.25f},       {0.60f, 0.48f, 0.30f},
                                        {0.48f, 0.50f, 0.52f},       {0.64f, 0.52f, 0.46f},
                                        {0.42f, 0.22f, 0.16f}};
const std::array<Colour, 5> kTiles = {Colour{0.34f, 0.12f, 0.07f},
                                      {0.28f, 0.13f, 0.09f},
                                      {0.19f, 0.18f, 0.19f},
                                      {0.40f, 0.19f, 0.11f},
                                      {0.25f, 0.20f, 0.17f}};
const std::array<Colour, 7> kPaint = {Colour{0.55f, 0.55f, 0.56f}, {0.03f, 0.03f, 0.035f},
                                      {0.35f, 0.03f, 0.03f},       {0.04f, 0.08f, 0.25f},
                                      {0.70f, 0.70f, 0.70f},       {0.15f, 0.16f, 0.17f},
                                      {0.10f, 0.20f, 0.12f}};
const std::array<Colour, 4> kGreen = {Colour{0.10f, 0.17f, 0.05f},
                                      {0.14f, 0.20f, 0.06f},
                                      {0.08f, 0.13f, 0.05f},
                                      {0.20f, 0.20f, 0.06f}};

template <std::size_t N>
Colour pick(Random& random, const std::array<Colour, N>& palette) {
  return palette[static_cast<std::size_t>(random.below(static_cast<int>(N)))] *
         static_cast<float>(random.uniform(0.85, 1.15));
}
Style plain(Material material, const Colour& colour) {
  Style style;
  style.material = material;
  style.colour = colour;
  return style;
}

class Builder {
 public:
  Builder(const TownPlan& plan, const Terrain& terrain, std::uint64_t seed)
      : plan_(plan), terrain_(terrain), random_(seed) {}

  std::vector<Solid> build() {
    for (int j = 0; j < TownPlan::kBlocks; ++j)
      for (int i = 0; i < TownPlan::kBlocks; ++i) block(i, j);
    for (int k = 0; k <= TownPlan::kBlocks; ++k) {
      const double middle = k * TownPlan::kBlock_m - TownPlan::kHalf_m;
      street(middle, true);
      street(middle, false);
    }
    outskirts();
    return std::move(solids_);
  }

 private:
  /// Foot of a thing at plan coordinates, aligned with the streets plus `turn`.
  Placement at(double plan_x, double plan_y, double turn = 0) const {
    const Eigen::Vector2d p = plan_.to_world(plan_x, plan_y);
    return {{p.x(), p.y(), terrain_.height(p.x(), p.y())}, plan_.yaw_rad(plan_x, plan_y) + turn};
  }
  static Placement shifted(const Placement& place, double dx, double dy) {
    const double c = std::cos(place.yaw_rad), s = std::sin(place.yaw_rad);
    Placement moved = place;
    moved.foot += Eigen::Vector3d(c * dx - s * dy, s * dx + c * dy, 0);
    return moved;
  }
  /// Lowest and highest ground under a footprint.
  std::pair<double, double> ground(const Placement& place, double length, double width) const {
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (const double a : {-0.5, 0.0, 0.5})
      for (const double b : {-0.5, 0.0, 0.5}) {
        const Eigen::Vector3d p = shifted(place, a * length, b * width).foot;
        low = std::min(low, terrain_.height(p.x(), p.y()));
        high = std::max(high, terrain_.height(p.x(), p.y()));
      }
    return {low, high};
  }
  Style wall_style() {
    Style style = plain(Material::facade, pick(random_, kPlaster));
    style.trim = Colour::Constant(static_cast<float>(random_.uniform(0.55, 0.8)));
    style.floor_height_m = static_cast<float>(random_.uniform(2.9, 3.3));
    style.window_pitch_m = static_cast<float>(random_.uniform(2.3, 3.2));
    style.window_width_m = static_cast<float>(random_.uniform(0.95, 1.35));
    style.window_height_m = static_cast<float>(random_.uniform(1.2, 1.65));
    return style;
  }

  void house(const Placement& place) {
    const double length = random_.uniform(9.5, 13), width = random_.uniform(7, 9);
    const auto [low, base] = ground(place, length, width);
    Style walls = wall_style();
    const int floors = 1 + random_.below(2);
    const double eaves = base + floors * static_cast<double>(walls.floor_height_m) + 0.3;
    const double ridge = eaves + width * random_.uniform(0.33, 0.5);
    const Style tiles = plain(Material::roof_tile, pick(random_, kTiles));
    const Style gable = plain(Material::plaster, walls.colour);
    solids_.push_back(make_box(place, length, width, low - 1, eaves, walls, gable, false, base));
    const double hip = random_.uniform() < 0.4 ? random_.uniform(2, 0.45 * length) : 0;
    solids_.push_back(
        make_roof(place, length + 0.8, width + 0.9, eaves - 0.12, ridge, hip, tiles, gable, base));
    const Placement stack = shifted(place, random_.uniform(-0.25, 0.25) * length, 0.12 * width);
    solids_.push_back(make_box(stack, 0.9, 0.7, eaves, ridge + random_.uniform(0.5, 1.1),
                               plain(Material::plaster, {0.33f, 0.17f, 0.13f}),
                               plain(Material::plaster, {0.06f, 0.06f, 0.06f}), true, base));
    if (random_.uniform() < 0.5) {  // a dormer or a porch
      const Placement porch = shifted(place, random_.uniform(-0.3, 0.3) * length, -width / 2 - 0.9);
      solids_.push_back(make_box(porch, 2.6, 2.2, low - 1, base + 2.5, gable,
                                 plain(Material::gravel, {0.3f, 0.29f, 0.28f}), true, base));
    }
  }

  void apartments(const Placement& place, double length, int floors, const Style& walls) {
    const double width = 11;
    const auto [low, base] = ground(place, length, width);
    const double top = base + floors * static_cast<double>(walls.floor_height_m) + 0.5;
    const Style roof = plain(Material::gravel, {0.36f, 0.35f, 0.33f});
    const Style concrete = plain(Material::plaster, {0.5f, 0.49f, 0.47f});
    solids_.push_back(make_box(place, length, width, low - 1, top, walls, roof, true, base));
    for (const double side : {-1.0, 1.0}) {  // parapets
      solids_.push_back(make_box(shifted(place, 0, side * (width / 2 - 0.1)), length + 0.2, 0.4,
                                 top - 0.2, top + 0.6, concrete, concrete, true, base));
      solids_.push_back(make_box(shifted(place, side * (length / 2 - 0.1), 0), 0.4, width - 0.6,
                                 top - 0.2, top + 0.6, concrete, concrete, true, base));
    }
    for (int i = 0; i < 4; ++i) {  // plant on the roof
      const Placement box =
          shifted(place, random_.uniform(-0.4, 0.4) * length, random_.uniform(-0.28, 0.28) * width);
      const Style grey = plain(Material::plaster,
                               Colour::Constant(static_cast<float>(random_.uniform(0.15, 0.6))));
      solids_.push_back(make_box(box, random_.uniform(1, 3), random_.uniform(0.8, 2.4), top - 0.1,
                                 top + random_.uniform(0.7, 2.4), grey, grey, true, base));
    }
    // Balconies under some of the windows of both long sides.
    const auto pitch = static_cast<double>(walls.window_pitch_m);
    const int columns = static_cast<int>((length - 0.8) / pitch);
    for (int c = 1; c < columns; c += 3)
      for (int f = 1; f < floors; ++f)
        for (const double side : {-1.0, 1.0}) {
          const double x = (c + 0.5) * pitch - columns * pitch / 2;
          const double z = base + f * static_cast<double>(walls.floor_height_m);
          solids_.push_back(make_box(shifted(place, x, side * (width / 2 + 0.5)), 2.2, 1.0, z - 0.1,
                                     z + 0.85, concrete, concrete, true, base));
        }
  }

  void tower(const Placement& place) {
    const double base = place.foot.z();
    const Style white = plain(Material::smooth, {0.62f, 0.60f, 0.56f});
    const Style slate = plain(Material::smooth, {0.12f, 0.14f, 0.18f});
    solids_.push_back(make_cone(place.foot, 4.2, 3.6, base - 2, base + 19, 96, white, false, base));
    solids_.push_back(make_cone(place.foot, 4.3, 0.4, base + 19, base + 25, 96, slate, true, base));
  }

  void tree(const Placement& place, double scale) {
    const Eigen::Vector3d& foot = place.foot;
    const double trunk = scale * random_.uniform(1.6, 2.6);
    const Colour green = pick(random_, kGreen);
    solids_.push_back(make_cone(foot, 0.22 * scale, 0.16 * scale, foot.z() - 0.5,
                                foot.z() + trunk + scale, 6,
                                plain(Material::bark, {0.16f, 0.12f, 0.09f}), false, foot.z()));
    const int crowns = 1 + random_.below(3);
    for (int i = 0; i < crowns; ++i) {
      const Eigen::Vector3d half(scale * random_.uniform(1.2, 1.9),
                                 scale * random_.uniform(1.2, 1.9),
                                 scale * random_.uniform(1.1, 1.8));
      const Eigen::Vector3d shift(random_.uniform(-0.9, 0.9) * (crowns > 1 ? scale : 0),
                                  random_.uniform(-0.9, 0.9) * (crowns > 1 ? scale : 0),
                                  trunk + 0.75 * half.z() + 0.6 * i * scale);
      solids_.push_back(make_blob(foot + shift, half, 18, random_.next(),
                                  plain(Material::foliage, green), foot.z()));
    }
  }
  void bush(const Placement& place) {
    const double size = random_.uniform(0.5, 1.1);
    solids_.push_back(make_blob(place.foot + Eigen::Vector3d(0, 0, 0.4 * size),
                                {size, size, 0.9 * size}, 12, random_.next(),
                                plain(Material::foliage, pick(random_, kGreen)), place.foot.z()));
  }
  void crate(const Placement& place) {
    const double height = random_.uniform(0.4, 1.6);
    const Style style = plain(Material::plaster, pick(random_, kPlaster));
    solids_.push_back(make_box(place, random_.uniform(0.6, 2.5), random_.uniform(0.6, 1.6),
                               place.foot.z() - 0.5, place.foot.z() + height, style, style, true,
                               place.foot.z()));
  }
  void hedge(const Placement& place, double length) {
    const auto [low, high] = ground(place, length, 0.7);
    const Style green = plain(Material::foliage, pick(random_, kGreen));
    solids_.push_back(
        make_box(place, length, 0.7, low - 0.5, high + 1.1, green, green, true, high));
  }
  void car(const Placement& place) {
    const double z = place.foot.z();
    const Style paint = plain(Material::paint, pick(random_, kPaint));
    const Style glass = plain(Material::paint, {0.03f, 0.035f, 0.04f});
    const double length = random_.uniform(3.9, 4.7);
    solids_.push_back(make_box(place, length, 1.75, z - 0.3, z + 0.85, paint, paint, true, z));
    const double cabin = length * 0.55;
    Solid top =
        make_roof(shifted(place, -0.2, 0), cabin, 1.6, z + 0.84, z + 2.4, 1.2, glass, glass, z);
    // The glasshouse is a hip roof cut flat by the car's top.
    std::vector<Face> faces;
    for (Face& face : top.faces) {
      face.polygon.clear();
      faces.push_back(std::move(face));
    }
    Face lid;
    lid.offset = z + 1.42;
    lid.style = paint;
    faces.push_back(std::move(lid));
    solids_.push_back(make_solid(std::move(faces), z));
  }

  void block(int i, int j) {
    const double cx = (i + 0.5) * TownPlan::kBlock_m - TownPlan::kHalf_m;
    const double cy = (j + 0.5) * TownPlan::kBlock_m - TownPlan::kHalf_m;
    constexpr double kInner = TownPlan::kBlock_m / 2 - TownPlan::kStreetHalf_m;  // 17 m
    const auto anywhere = [&] {
      return at(cx + random_.uniform(-kInner, kInner), cy + random_.uniform(-kInner, kInner),
                random_.uniform(0, 3.1));
    };
    switch (plan_.kind(i, j)) {
      case BlockKind::houses: {
        for (const double side : {-1.0, 1.0}) {
          const bool across = random_.uniform() < 0.3;
          house(at(cx + side * 8.5, cy - 9 + random_.uniform(-1.5, 1.5),
                   across ? std::numbers::pi / 2 : 0));
          const Placement garden =
              at(cx + side * 8.5 + random_.uniform(-4, 4), cy + random_.uniform(4, 13));
          if (random_.uniform() < 0.25) {
            crate(shifted(garden, 2, 0));
            crate(shifted(garden, 0, 2.5));
          } else {
            tree(garden, random_.uniform(0.8, 1.35));
          }
          for (int k = 0; k < 3; ++k)
            bush(at(cx + side * random_.uniform(2, 16), cy + random_.uniform(1, 16)));
        }
        hedge(at(cx, cy + 4, std::numbers::pi / 2), 22);
        hedge(at(cx, cy + kInner - 0.4), 2 * kInner - 2);
        break;
      }
      case BlockKind::apartments: {
        // The south side is the street of identical windows, whatever the seed.
        Style walls = wall_style();
        walls.window_pitch_m = 2.8f;
        apartments(at(cx, cy - kInner + 0.6 + 5.5), 31, 4, walls);
        for (int k = 0; k < 4; ++k) tree(at(cx - 13 + 8.5 * k, cy + random_.uniform(5, 14)), 1.1);
        for (int k = 0; k < 5; ++k) car(at(cx - 12 + 5.5 * k, cy + 0.5, std::numbers::pi / 2));
        break;
      }
      case BlockKind::park:
        for (int k = 0; k < 11; ++k) tree(anywhere(), random_.uniform(0.9, 1.6));
        for (int k = 0; k < 10; ++k) bush(anywhere());
        break;
      case BlockKind::square:
        tower(at(cx, cy));
        for (int k = 0; k < 8; ++k) {
          const double angle = k * std::numbers::pi / 4 + 0.3;
          tree(at(cx + 14 * std::cos(angle), cy + 14 * std::sin(angle)), 0.8);
        }
        for (int k = 0; k < 8; ++k)
          crate(at(cx + random_.uniform(7, 12) * (k % 2 ? 1 : -1), cy + random_.uniform(-11, 11)));
        break;
    }
  }

  /// Parked cars and street trees along one street.
  void street(double middle, bool along_x) {
    const bool windows = along_x && middle == 0;  // kept free: the facade path flies there
    for (double s = -TownPlan::kHalf_m + 10; s < TownPlan::kHalf_m - 8; s += 6.5) {
      const double from_crossing =
          std::abs(s - TownPlan::kBlock_m * std::round(s / TownPlan::kBlock_m));
      if (from_crossing < 10) continue;
      for (const double side : {-1.0, 1.0}) {
        const double chance = random_.uniform();
        const auto place = [&](double offset, double turn) {
          const double d = middle + side * offset;
          return along_x ? at(s, d, turn) : at(d, s, turn + std::numbers::pi / 2);
        };
        if (chance < 0.3) car(place(2.9, random_.uniform() < 0.5 ? std::numbers::pi : 0));
        if (chance > 0.75 && !windows) tree(place(5.3, 0), random_.uniform(0.55, 0.8));
      }
    }
  }

  void outskirts() {
    for (int k = 0; k < 130; ++k) {
      const double angle = random_.uniform(0, 2 * std::numbers::pi);
      const double radius = random_.uniform(150, 330);
      const double x = radius * std::cos(angle), y = radius * std::sin(angle);
      if (std::max(std::abs(x), std::abs(y)) < TownPlan::kHalf_m + 12) continue;
      const double chance = random_.uniform();
      const Placement place{{x, y, terrain_.height(x, y)}, angle};
      if (chance < 0.6) {
        tree(place, random_.uniform(0.9, 1.9));
      } else if (chance < 0.8) {
        bush(place);
      } else {
        crate(place);
      }
    }
  }

  const TownPlan& plan_;
  const Terrain& terrain_;
  Random random_;
  std::vector<Solid> solids_;
};
}  // namespace

std::vector<Solid> build_solids(const TownPlan& plan, const Terrain& terrain, std::uint64_t seed) {
  return Builder(plan, terrain, seed).build();
}

}  // namespace corvid
