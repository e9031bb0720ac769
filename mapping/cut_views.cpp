#include "mapping/cut_views.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <mutex>

#include "core/parallel_rows.h"

namespace corvid {

CutView::CutView(const DepthMap& map, const CutVolume& volume)
    : depth_(map.depth.data()),
      confidence_(map.confidence.data()),
      stride_(map.depth.width()),
      rows_(map.depth.height()),
      fx_(static_cast<float>(map.camera.fx_px)),
      fy_(static_cast<float>(map.camera.fy_px)),
      cx_(static_cast<float>(map.camera.cx_px + 0.5)),
      cy_(static_cast<float>(map.camera.cy_px + 0.5)),
      width_(static_cast<float>(stride_)),
      height_(static_cast<float>(rows_)),
      nearest_(static_cast<float>(1e-3 * volume.voxel_size)),
      tiles_(map, kTile_px) {
  const Pose T_camera_world = map.T_world_camera.inverse();
  origin_ = (T_camera_world * volume.p_low).cast<float>();
  axes_ = (T_camera_world.rotation().toRotationMatrix() * volume.voxel_size).cast<float>();
  centre_ = (map.T_world_camera.translation() - volume.p_low) / volume.voxel_size;
  Eigen::Matrix3d unproject = Eigen::Matrix3d::Identity();
  unproject(0, 0) = 1 / map.camera.fx_px;
  unproject(1, 1) = 1 / map.camera.fy_px;
  unproject(0, 2) = -map.camera.cx_px / map.camera.fx_px;
  unproject(1, 2) = -map.camera.cy_px / map.camera.fy_px;
  rays_ = map.T_world_camera.rotation().toRotationMatrix() * unproject / volume.voxel_size;
}

float CutView::smooth_depth(const Eigen::Vector3f& p_camera, std::ptrdiff_t pixel,
                            float reach) const {
  const float here = depth(pixel);
  const float u = fx_ * p_camera.x() / p_camera.z() + cx_ - 0.5F;
  const float v = fy_ * p_camera.y() / p_camera.z() + cy_ - 0.5F;
  const float left = std::floor(u), top = std::floor(v);
  if (!(left >= 0 && top >= 0 && left < width_ - 1 && top < height_ - 1)) return here;
  const std::ptrdiff_t at =
      static_cast<std::ptrdiff_t>(top) * stride_ + static_cast<std::ptrdiff_t>(left);
  const float a = depth(at), b = depth(at + 1), c = depth(at + stride_),
              d = depth(at + stride_ + 1);
  const auto [low, high] = std::minmax({a, b, c, d});
  if (!(low > 0) || high - low > reach) return here;
  const float x = u - left, y = v - top;
  return (1 - y) * ((1 - x) * a + x * b) + y * ((1 - x) * c + x * d);
}

PointVoxels find_points(std::span<const CutView> views, const CutVolume& volume, int threads) {
  PointVoxels out{BitGrid(volume.size), 0};
  std::mutex mutex;
  const int n = static_cast<int>(views.size());
  parallel_rows(n, std::max(1, (n + threads - 1) / threads), threads, [&](int first, int last) {
    PointVoxels part{BitGrid(volume.size), 0};
    const Eigen::Array3d end = volume.size.cast<double>().array() - 0.5;
    for (int i = first; i < last; ++i) {
      views[static_cast<std::size_t>(i)].for_each_point([&](const Eigen::Vector3d& q, float) {
        if (!((q.array() > -0.5).all() && (q.array() < end).all())) return;
        part.voxels.set((q.array() + 0.5).cast<int>());
        ++part.points;
      });
    }
    const std::scoped_lock lock(mutex);
    out.voxels |= part.voxels;
    out.points += part.points;
  });
  return out;
}

namespace {

/// What the views say of one cell.
struct CellLooks {
  std::uint32_t in_view = 0;   ///< views in whose image it lies
  std::uint32_t in_front = 0;  ///< that see through it
  std::uint32_t behind = 0;    ///< for which it lies behind a point
  std::uint32_t just_behind = 0;
};

/// What the views say of one row of cells.
class CellRow {
 public:
  CellRow(std::span<const CutView> views, int cells, double voxel_size)
      : views_(views),
        held_up_(static_cast<float>(kHeldUp * voxel_size)),
        looks_(static_cast<std::size_t>(cells)) {}

  /// @param wanted  by x; others are left out.
  void look(int y, int z, const std::vector<std::uint8_t>& wanted) {
    std::fill(looks_.begin(), looks_.end(), CellLooks{});
    for (const CutView& view : views_) {
      const Eigen::Vector3f step = 2 * view.axes().col(0);
      const Eigen::Vector3f start =
          view.origin() + view.axes() * Eigen::Vector3f(0.5F, 2 * static_cast<float>(y) + 0.5F,
                                                        2 * static_cast<float>(z) + 0.5F);
      for (std::size_t x = 0; x < wanted.size(); ++x) {
        if (!wanted[x]) continue;
        const Eigen::Vector3f p = start + static_cast<float>(x) * step;
        const std::ptrdiff_t pixel = view.pixel(p);
        if (pixel < 0) continue;
        ++looks_[x].in_view;
        const float d = view.depth(pixel);
        if (!(d > 0)) continue;
        ++(p.z() < d ? looks_[x].in_front : looks_[x].behind);
        looks_[x].just_behind += p.z() >= d && p.z() < d + held_up_;
      }
    }
  }
  [[nodiscard]] const CellLooks& operator[](std::size_t x) const { return looks_[x]; }

 private:
  static constexpr double kHeldUp = 12;  ///< farther behind a point, a view does not look [voxels]
  std::span<const CutView> views_;
  float held_up_;
  std::vector<CellLooks> looks_;
};

/// Of the views in whose image a point lies, the share that has a depth there.
double answer_share(std::span<const CutView> views, const std::stop_token& stop) {
  constexpr std::size_t kStep = 997;
  std::size_t n = 0, in_view = 0, answered = 0;
  for (const CutView& from : views) {
    if (stop.stop_requested()) break;
    from.for_each_point([&](const Eigen::Vector3d& q, float) {
      if (++n % kStep != 0) return;
      for (const CutView& view : views) {
        const std::ptrdiff_t pixel = view.pixel(view.origin() + view.axes() * q.cast<float>());
        if (pixel < 0) continue;
        ++in_view;
        answered += view.depth(pixel) > 0;
      }
    });
  }
  return in_view > 0 ? static_cast<double>(answered) / static_cast<double>(in_view) : 0;
}

struct LabelRule {
  double outside_share, inside_share;
  double answered;  ///< share of the views that have a depth where there is a surface

  [[nodiscard]] CutLabel operator()(const CellLooks& c) const {
    constexpr double kAsManyAs = 0.75;
    const double looks = c.in_front + c.behind;
    if (looks == 0) return CutLabel::unknown;
    if (c.behind >= inside_share * looks) {
      return c.behind >= kAsManyAs * answered * c.in_view ? CutLabel::inside : CutLabel::unknown;
    }
    const bool seen_through = c.in_front >= outside_share * (c.in_front + c.just_behind);
    const bool agreed = c.in_front > 1 || c.behind == 0;
    return seen_through && agreed ? CutLabel::outside : CutLabel::unknown;
  }
};

/// Whether a cell lies wholly in the crust.
bool covered(const BitGrid& crust, int x, int y, int z) {
  for (int c = 0; c < 8; ++c) {
    const Eigen::Vector3i p(2 * x + (c & 1), 2 * y + (c >> 1 & 1), 2 * z + (c >> 2));
    if (crust.contains(p) && !crust.test(p)) return false;
  }
  return true;
}

/// Gives cells without a label that of the nearest one with.
/// @param likely  not unknown: the cell is not covered by the crust.
void spread_labels(CutCells& cells, const std::vector<CutLabel>& likely) {
  const auto sx = static_cast<std::size_t>(cells.size.x());
  const std::size_t sy = sx * static_cast<std::size_t>(cells.size.y());
  const auto open = [&](std::size_t i) {
    return likely[i] != CutLabel::unknown && cells.labels[i] == CutLabel::unknown;
  };
  const auto for_each_open_neighbour = [&](std::size_t i, auto&& call) {
    const auto visit = [&](bool there, std::size_t j) {
      if (there && open(j)) call(j);
    };
    const std::size_t x = i % sx, y = i % sy / sx;
    visit(x > 0, i - 1);
    visit(x + 1 < sx, i + 1);
    visit(y > 0, i - sx);
    visit(i % sy + sx < sy, i + sx);
    visit(i >= sy, i - sy);
    visit(i + sy < cells.labels.size(), i + sy);
  };
  // Only cells at the border of what is labelled: there are few of them.
  std::vector<std::size_t> front, next;
  for (std::size_t i = 0; i < cells.labels.size(); ++i) {
    if (cells.labels[i] == CutLabel::unknown) continue;
    bool at_border = false;
    for_each_open_neighbour(i, [&](std::size_t) { at_border = true; });
    if (at_border) front.push_back(i);
  }
  while (!front.empty()) {
    next.clear();
    for (const std::size_t i : front) {
      for_each_open_neighbour(i, [&](std::size_t j) {
        cells.labels[j] = cells.labels[i];
        next.push_back(j);
      });
    }
    front.swap(next);
  }
}

}  // namespace

CutCells label_cells(std::span<const CutView> views, double voxel_size, const BitGrid& crust,
                     double outside_share, double inside_share, int threads,
                     const std::stop_token& stop) {
  CutCells cells{(crust.size().array() + 1) / 2, {}};
  const LabelRule rule{outside_share, inside_share, answer_share(views, stop)};
  cells.labels.assign(cells.size.cast<std::size_t>().prod(), CutLabel::unknown);
  std::vector<CutLabel> likely(cells.labels.size(), CutLabel::unknown);  // of the open ones
  parallel_rows(cells.size.z(), 1, threads, [&](int first, int last) {
    if (stop.stop_requested()) return;
    CellRow row(views, cells.size.x(), voxel_size);
    std::vector<std::uint8_t> wanted(static_cast<std::size_t>(cells.size.x()));
    for (int z = first; z < last; ++z) {
      for (int y = 0; y < cells.size.y(); ++y) {
        for (int x = 0; x < cells.size.x(); ++x) {
          wanted[static_cast<std::size_t>(x)] = !covered(crust, x, y, z);
        }
        row.look(y, z, wanted);
        const std::size_t start = cells.index(0, y, z);
        for (std::size_t x = 0; x < wanted.size(); ++x) {
          if (!wanted[x]) continue;
          likely[start + x] =
              row[x].behind > row[x].in_front ? CutLabel::inside : CutLabel::outside;
          cells.labels[start + x] = rule(row[x]);
        }
      }
    }
  });
  if (!stop.stop_requested()) spread_labels(cells, likely);
  for (std::size_t i = 0; i < likely.size(); ++i) {
    if (cells.labels[i] == CutLabel::unknown) cells.labels[i] = likely[i];
  }
  return cells;
}

LinkVotes count_votes(std::span<const CutView> views, const CrustBlocks& blocks, int threads,
                      const std::stop_token& stop) {
  LinkVotes votes;
  constexpr std::size_t kNames = 255;
  std::array<std::vector<std::uint8_t>, 3> voter;  // name of the last view that voted for a link
  for (auto& v : votes.sums) v.assign(blocks.places(), 0);
  for (auto& v : voter) v.assign(blocks.places(), 0);
  // Every thread goes through all points and counts those of its own blocks.
  const auto n = static_cast<int>(blocks.blocks());
  parallel_rows(n, std::max(1, (n + threads - 1) / threads), threads, [&](int first, int last) {
    const std::uint32_t low = static_cast<std::uint32_t>(first) * CrustBlocks::kBlockVoxels;
    const std::uint32_t high = static_cast<std::uint32_t>(last) * CrustBlocks::kBlockVoxels;
    for (std::size_t i = 0; i < views.size(); ++i) {
      if (stop.stop_requested()) return;
      if (i > 0 && i % kNames == 0) {
        for (auto& v : voter) std::fill(v.begin() + low, v.begin() + high, std::uint8_t{0});
      }
      const auto name = static_cast<std::uint8_t>(i % kNames + 1);
      views[i].for_each_point([&](const Eigen::Vector3d& q, float confidence) {
        if (!(q.cwiseAbs().maxCoeff() < 1e8)) return;
        const int vote = static_cast<int>(std::lround(std::min(confidence, 1.F) * kVoteSteps));
        const Eigen::Vector3i nearest = (q.array() + 0.5).floor().cast<int>();
        for (int axis = 0; axis < 3; ++axis) {
          Eigen::Vector3i voxel = nearest;
          voxel[axis] = static_cast<int>(std::floor(q[axis]));
          const std::uint32_t place = blocks.place(voxel);
          if (place < std::max(low, CrustBlocks::kNone) || place >= high) continue;
          std::uint8_t& last_voter = voter[static_cast<std::size_t>(axis)][place];
          if (last_voter == name) continue;
          last_voter = name;
          std::uint8_t& sum = votes.sums[static_cast<std::size_t>(axis)][place];
          sum = static_cast<std::uint8_t>(std::min(255, sum + vote));
        }
      });
    }
  });
  return votes;
}

namespace {

/// Sums over the views for one block.
struct BlockSums {
  std::array<float, CrustBlocks::kBlockVoxels> distance, weight;

  /// @param rows  the voxels to measure: one byte per row along x, its lowest bit first.
  void add(const CutView& view, const Eigen::Vector3i& origin, float voxel_size,
           const std::array<std::uint8_t, 64>& rows) {
    constexpr float kReach = CutDistances::kReach;
    constexpr float kSmooth = 2;  // so near the surface, depth is interpolated [voxels]
    const float per_voxel = 1 / voxel_size;
    const Eigen::Vector3f step = view.axes().col(0);
    for (int row = 0; row < 64; ++row) {
      const Eigen::Vector3f start =
          view.origin() +
          view.axes() * (origin + Eigen::Vector3i(0, row & 7, row >> 3)).cast<float>();
      for (unsigned left = rows[static_cast<std::size_t>(row)]; left != 0; left &= left - 1) {
        const int x = std::countr_zero(left);
        const Eigen::Vector3f p = start + static_cast<float>(x) * step;
        const std::ptrdiff_t pixel = view.pixel(p);
        if (pixel < 0) continue;
        const float d = view.depth(pixel);
        if (!(d > 0)) continue;
        float in_front = (d - p.z()) * per_voxel;
        if (!(in_front > -kReach)) continue;
        if (std::abs(in_front) < kSmooth) {
          in_front = (view.smooth_depth(p, pixel, kReach * voxel_size) - p.z()) * per_voxel;
        }
        const float w = std::min(view.confidence(pixel), 1.F);
        if (!(in_front > -kReach && w > 0)) continue;
        const auto i = static_cast<std::size_t>(8 * row + x);
        distance[i] += w * std::min(in_front, kReach);
        weight[i] += w;
      }
    }
  }
};

}  // namespace

CutDistances measure_distances(std::span<const CutView> views, double voxel_size,
                               const BitGrid& crust, const CrustBlocks& blocks, int threads,
                               const std::stop_token& stop) {
  constexpr float kBlockRadius = 6.1F;  // of the middles of a block's voxels [voxels]
  CutDistances out;
  out.distance.assign(blocks.places(), 0);
  out.weight.assign(blocks.places(), 0);
  const auto h = static_cast<float>(voxel_size);
  parallel_rows(static_cast<int>(blocks.blocks()), 64, threads, [&](int first, int last) {
    BlockSums sums;
    std::array<std::uint8_t, 64> rows;
    if (stop.stop_requested()) return;
    for (int b = std::max(1, first); b < last; ++b) {
      const Eigen::Vector3i& low = blocks.origin(static_cast<std::uint32_t>(b));
      for (int row = 0; row < 64; ++row) {
        rows[static_cast<std::size_t>(row)] = static_cast<std::uint8_t>(
            crust.bits(low.x() / 64, low.y() + (row & 7), low.z() + (row >> 3)) >> (low.x() % 64));
      }
      sums.distance.fill(0);
      sums.weight.fill(0);
      const Eigen::Vector3f middle = low.cast<float>() + Eigen::Vector3f::Constant(3.5F);
      for (const CutView& view : views) {
        const Eigen::Vector3f p = view.origin() + view.axes() * middle;
        if (!view.tiles().hides(p, kBlockRadius * h, CutDistances::kReach * h)) {
          sums.add(view, low, h, rows);
        }
      }
      const std::size_t place = static_cast<std::size_t>(b) * CrustBlocks::kBlockVoxels;
      for (std::size_t i = 0; i < CrustBlocks::kBlockVoxels; ++i) {
        if (!(sums.weight[i] > 0)) continue;
        out.distance[place + i] = static_cast<std::int8_t>(
            std::lround(CutDistances::kSteps * sums.distance[i] / sums.weight[i]));
        out.weight[place + i] = static_cast<std::uint8_t>(
            std::clamp(std::lround(CutDistances::kWeightSteps * sums.weight[i]), 1L, 255L));
      }
    }
  });
  return out;
}

}  // namespace corvid
