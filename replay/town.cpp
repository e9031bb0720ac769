#include "replay/town.h"

#include <cmath>

#include "replay/random.h"

namespace corvid {
namespace {
constexpr double kBend_m = 5, kBendPerM = 1.0 / 47;
}

TownPlan::TownPlan(std::uint64_t seed) {
  Random random(seed);
  phase_x_ = random.uniform(0, 6.28);
  phase_y_ = random.uniform(0, 6.28);
  for (BlockKind& kind : kinds_) {
    kind = random.uniform() < 0.13  ? BlockKind::park
           : random.uniform() < 0.1 ? BlockKind::apartments
                                    : BlockKind::houses;
  }
  // North of the middle street: the row of identical windows. South of it: the tower's square.
  for (std::size_t i = 0; i < kBlocks; ++i)
    kinds_[kBlocks / 2 * kBlocks + i] = BlockKind::apartments;
  kinds_[(kBlocks / 2 - 1) * kBlocks + kBlocks / 2] = BlockKind::square;
}

Eigen::Vector2d TownPlan::to_plan(double x, double y) const {
  return {x + kBend_m * std::sin(kBendPerM * y + phase_x_),
          y + kBend_m * std::sin(kBendPerM * x + phase_y_)};
}

Eigen::Vector2d TownPlan::to_world(double plan_x, double plan_y) const {
  const Eigen::Vector2d goal(plan_x, plan_y);
  Eigen::Vector2d p = goal;
  for (int i = 0; i < 12; ++i) p += goal - to_plan(p.x(), p.y());  // contracts by 0.11 a step
  return p;
}

double TownPlan::yaw_rad(double plan_x, double plan_y) const {
  const Eigen::Vector2d step = to_world(plan_x + 0.5, plan_y) - to_world(plan_x - 0.5, plan_y);
  return std::atan2(step.y(), step.x());
}

Town::Town(std::uint64_t seed)
    : plan(mix64(seed ^ 1)),
      terrain(mix64(seed ^ 2)),
      solids(build_solids(plan, terrain, mix64(seed ^ 3))),
      clouds(TileTexture::clouds(mix64(seed ^ 4))),
      leaves(TileTexture::leaves(mix64(seed ^ 5))),
      light(solids, terrain) {}

TriangleMesh Town::surface() const {
  TriangleMesh mesh;
  terrain.append_mesh(mesh);
  for (const Solid& solid : solids) append_mesh(solid, mesh);
  return mesh;
}

}  // namespace corvid
