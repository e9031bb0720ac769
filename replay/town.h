#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "replay/solid.h"
#include "replay/terrain.h"
#include "replay/tile_texture.h"

namespace corvid {

enum class BlockKind : std::uint8_t { houses, apartments, park, square };

/// The town's plan: a grid of streets, bent a little. "Plan" coordinates are straight along the
/// streets; a street's middle line is where a plan coordinate is a multiple of kBlock_m.
struct TownPlan {
  static constexpr int kBlocks = 6;  ///< per side
  static constexpr double kBlock_m = 46;
  static constexpr double kHalf_m = kBlock_m * kBlocks / 2;
  static constexpr double kRoadHalf_m = 3.9;  ///< middle line to kerb
  static constexpr double kStreetHalf_m = 6;  ///< middle line to the blocks

  explicit TownPlan(std::uint64_t seed);
  [[nodiscard]] Eigen::Vector2d to_plan(double x, double y) const;
  [[nodiscard]] Eigen::Vector2d to_world(double plan_x, double plan_y) const;
  /// Direction of increasing plan x in the world.
  [[nodiscard]] double yaw_rad(double plan_x, double plan_y) const;
  /// Blocks are counted from 0 at the lower left.
  [[nodiscard]] BlockKind kind(int i, int j) const {
    return kinds_[static_cast<std::size_t>(j * kBlocks + i)];
  }

 private:
  double phase_x_, phase_y_;
  std::array<BlockKind, kBlocks * kBlocks> kinds_{};
};

/// The light of one place, independent of who looks: baked once.
class Light {
 public:
  Light(const std::vector<Solid>& solids, const Terrain& terrain);
  /// Unit vector towards the sun.
  [[nodiscard]] static Eigen::Vector3d to_sun();
  /// Share of the sun that reaches a point; 0 in a cast shadow, soft over about 0.5 m.
  [[nodiscard]] float sun(const Eigen::Vector3d& point, const Eigen::Vector3d& normal) const;
  /// Share of the sky that the ground sees near buildings.
  [[nodiscard]] float ground_sky(double x, double y) const;

 private:
  void bake_shadow(const std::vector<Solid>& solids);
  void bake_sky(const std::vector<Solid>& solids, const Terrain& terrain);
  std::vector<float> shadow_;  ///< highest solid towards the sun, per texel of the plane across it
  std::vector<float> sky_;
};

/// Everything there is to see. Immutable.
struct Town {
  explicit Town(std::uint64_t seed);
  TownPlan plan;
  Terrain terrain;
  std::vector<Solid> solids;
  TileTexture clouds, leaves;
  Light light;

  [[nodiscard]] TriangleMesh surface() const;
};

/// Buildings, trees, cars and clutter on the plan.
[[nodiscard]] std::vector<Solid> build_solids(const TownPlan& plan, const Terrain& terrain,
                                              std::uint64_t seed);

}  // namespace corvid
