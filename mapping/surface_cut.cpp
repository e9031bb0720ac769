#include "mapping/surface_cut.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <thread>
#include <vector>

#include "core/parallel_rows.h"
#include "core/stopwatch.h"
#include "mapping/cut_mesh.h"
#include "mapping/cut_views.h"
#include "mapping/cut_volume.h"
#include "mapping/grid_flow.h"

namespace corvid {
namespace {

constexpr int kFull = SurfaceCut::kLinkSteps;

/// Capacity of a link by its votes: rho h^2 (thesis 6.30).
std::array<int, 256> link_capacities(double decay) {
  std::array<int, 256> out{};
  for (std::size_t votes = 0; votes < out.size(); ++votes) {
    const double rho = std::exp(-decay * static_cast<double>(votes) / kVoteSteps);
    out[votes] = std::max(1, static_cast<int>(std::lround(kFull * rho)));
  }
  return out;
}

/// What the capacities are made from.
struct CutEvidence {
  const BitGrid& crust;
  const CutCells& cells;
  const CrustBlocks& blocks;
  const LinkVotes& votes;
  const CutDistances& distances;
};

/// Cost of the label `outside` (positive) or `inside` (negative) of a voxel's volume.
int volume_cost(const CutDistances& distances, std::uint32_t place, double ballooning) {
  double share = 1;
  if (distances.weight[place] > 0) {
    share = -std::clamp(distances.distance[place] / double{CutDistances::kSteps}, -1.0, 1.0);
  }
  return static_cast<int>(std::lround(kFull * ballooning * share));
}

void set_capacities(GridFlow& flow, const CutEvidence& e, const SurfaceCutOptions& options,
                    int threads) {
  const std::array<int, 256> capacity = link_capacities(options.decay);
  parallel_rows(static_cast<int>(e.blocks.blocks()), 64, threads, [&](int first, int last) {
    const auto end = static_cast<std::uint32_t>(last) * CrustBlocks::kBlockVoxels;
    std::uint32_t place = static_cast<std::uint32_t>(first) * CrustBlocks::kBlockVoxels;
    for (place = std::max(place, CrustBlocks::kNone); place < end; ++place) {
      const Eigen::Vector3i voxel = e.blocks.voxel(place);
      if (!e.crust.contains(voxel) || !e.crust.test(voxel)) continue;
      int terminal = volume_cost(e.distances, place, options.ballooning);
      for (int d = 0; d < 6; ++d) {
        const Eigen::Vector3i next = voxel + (d & 1 ? -1 : 1) * Eigen::Vector3i::Unit(d >> 1);
        if (!e.crust.contains(next)) continue;  // the volume's border asks for nothing
        if (!e.crust.test(next)) {
          terminal += e.cells.inside(next) ? kFull : -kFull;
        } else if (!(d & 1)) {
          const int c = capacity[e.votes.sums[static_cast<std::size_t>(d >> 1)][place]];
          flow.set_link(place, d >> 1, c, c);
        }
      }
      flow.set_terminal(place, terminal);
    }
  });
}

/// The voxels inside the surface: by the cut in the crust, by the views elsewhere.
BitGrid solid_voxels(const GridFlow& flow, const CutEvidence& e, int threads) {
  BitGrid solid(e.crust.size());
  const Eigen::Vector3i& size = e.crust.size();
  parallel_rows(size.z(), 1, threads, [&](int first, int last) {
    Eigen::Vector3i p;
    for (p.z() = first; p.z() < last; ++p.z()) {
      for (p.y() = 0; p.y() < size.y(); ++p.y()) {
        for (p.x() = 0; p.x() < size.x(); ++p.x()) {
          if (e.crust.test(p) ? flow.on_source_side(e.blocks.place(p)) : e.cells.inside(p)) {
            solid.set(p);
          }
        }
      }
    }
  });
  return solid;
}

/// One cut, stage by stage.
class Cutter {
 public:
  Cutter(std::span<const SurfaceCutView> views, const SurfaceCutOptions& options,
         const SurfaceCutControl& control, int threads)
      : maps_(views), options_(options), control_(control), threads_(threads) {}

  Expected<SurfaceCut> run(const WantedVolume& wanted) {
    Stopwatch watch;
    if (auto found = find_crust(wanted); !found) return tl::unexpected(found.error());
    SurfaceCutStatistics& s = out_.statistics;
    if (!begin("labels")) return interrupted();
    const CutCells cells = label_cells(views_, volume_.voxel_size, crust_, options_.outside_share,
                                       options_.inside_share, threads_, control_.stop);
    if (!begin("votes")) return interrupted();
    LinkVotes votes = count_votes(views_, blocks_, threads_, control_.stop);
    if (!begin("distances")) return interrupted();
    const CutDistances distances =
        measure_distances(views_, volume_.voxel_size, crust_, blocks_, threads_, control_.stop);
    if (control_.stop.stop_requested()) return interrupted();
    const CutEvidence evidence{crust_, cells, blocks_, votes, distances};
    BitGrid solid;
    {
      GridFlow flow(blocks_);
      set_capacities(flow, evidence, options_, threads_);
      s.graph_s = 1e-3 * watch.lap_ms();
      votes = {};
      if (!begin("flow")) return interrupted();
      s.flow = flow.solve(control_.stop);
      if (s.flow < 0) return interrupted();
      s.maxflow_s = 1e-3 * watch.lap_ms();
      solid = solid_voxels(flow, evidence, threads_);
    }
    if (!begin("mesh")) return interrupted();
    out_.mesh = mesh_cut({volume_, solid, blocks_, distances}, options_.smoothing,
                         options_.min_island, options_.closed, threads_);
    if (!begin("colours")) return interrupted();
    std::vector<const ColourImage*> colours;
    for (const SurfaceCutView& view : maps_) colours.push_back(view.colour);
    if (std::any_of(colours.begin(), colours.end(), [](const auto* c) { return c != nullptr; })) {
      colour_cut(out_.mesh, volume_, views_, colours, threads_, control_.stop);
    }
    if (control_.stop.stop_requested()) return interrupted();
    s.mesh_s = 1e-3 * watch.lap_ms();
    return std::move(out_);
  }

 private:
  /// The voxels near points, in the wanted volume or, where memory does not do and the options say
  /// so, in the finest one that fits.
  Expected<void> find_crust(const WantedVolume& wanted) {
    SurfaceCutStatistics& s = out_.statistics;
    const auto most = static_cast<double>(options_.max_bytes);
    for (volume_ = volume_of(wanted.box, wanted.voxel_size);;) {
      if (!begin("points")) return interrupted();
      double bytes = dense_bytes(volume_, threads_);
      std::size_t places = 0;
      if (bytes <= most) {
        views_.clear();
        for (const SurfaceCutView& map : maps_) views_.emplace_back(*map.depth, volume_);
        const PointVoxels points = find_points(views_, volume_, threads_);
        if (points.points == 0) return no_points();
        crust_ = points.voxels.within_4();
        places = CrustBlocks::count_places(crust_);
        // The flow with its queues, votes, distances.
        constexpr std::size_t kPlaceBytes = GridFlow::kVoxelBytes + 4 + 3 + 2;
        bytes += static_cast<double>(kPlaceBytes * places);
        s.points = points.points;
      }
      s.peak_bytes = static_cast<std::uint64_t>(bytes);
      if (bytes <= most && places <= CrustBlocks::kMostPlaces) break;
      constexpr double kFactor = 1.26;  // half as many voxels
      const CutVolume next = volume_of(wanted.box, kFactor * volume_.voxel_size);
      if (!options_.coarsen || next.size.minCoeff() < 2) {
        return tl::unexpected(bytes <= most ? too_many(volume_, places)
                                            : too_large(volume_, bytes, options_.max_bytes));
      }
      volume_ = next;
    }
    if (auto ok = check_place(volume_); !ok) return ok;
    blocks_ = CrustBlocks(crust_);
    s.voxels = static_cast<std::uint64_t>(volume_.size.cast<std::int64_t>().prod());
    s.crust_voxels = crust_.count();
    out_.voxel_size = volume_.voxel_size;
    out_.box = box_of(volume_);
    return {};
  }

  /// Whether the next stage may begin.
  [[nodiscard]] bool begin(std::string_view stage) const {
    if (control_.stop.stop_requested()) return false;
    if (control_.on_stage) control_.on_stage(stage);
    return true;
  }
  static tl::unexpected<Error> interrupted() {
    return fail(ErrorCode::interrupted, "asked to stop", "surface cut");
  }
  [[nodiscard]] tl::unexpected<Error> no_points() const {
    const Eigen::AlignedBox3d box = box_of(volume_);
    const Eigen::Vector3d a = box.min(), b = box.max();
    return fail(ErrorCode::invalid_argument,
                fmt::format("none of the {} depth maps has a point in the volume from ({:.4g}, "
                            "{:.4g}, {:.4g}) to ({:.4g}, {:.4g}, {:.4g})",
                            maps_.size(), a.x(), a.y(), a.z(), b.x(), b.y(), b.z()),
                "surface cut", "is the volume in the frame and unit of the depth maps?");
  }

  const std::span<const SurfaceCutView> maps_;
  const SurfaceCutOptions& options_;
  const SurfaceCutControl& control_;
  const int threads_;
  CutVolume volume_;
  std::vector<CutView> views_;
  BitGrid crust_;
  CrustBlocks blocks_;
  SurfaceCut out_;
};

}  // namespace

Expected<SurfaceCut> cut_surface(std::span<const SurfaceCutView> views,
                                 const SurfaceCutOptions& options,
                                 const SurfaceCutControl& control) {
  if (auto ok = check_cut(views, options); !ok) return tl::unexpected(ok.error());
  const auto volume = choose_volume(views, options);
  if (!volume) return tl::unexpected(volume.error());
  const int threads = options.threads > 0
                          ? options.threads
                          : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  return Cutter(views, options, control, threads).run(*volume);
}

}  // namespace corvid
