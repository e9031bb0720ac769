#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "bench/mapping_report.h"
#include "bench/mapping_scene.h"
#include "bench/peak_meter.h"
#include "corvid/error.h"
#include "kernels/device.h"

namespace corvid {

/// Depth of one view against 4 neighbours, timed.
struct DepthWork {
  std::string workload;
  const MappingScene* scene = nullptr;
  std::size_t view = 0;
  /// The volume of interest [map units]; if it is empty, the depths are those of the scene's truth.
  Eigen::AlignedBox3d volume;
  /// With a volume: so many rays through its far sides, by the choice of the voxel size.
  /// Otherwise there is a ray per pixel.
  double rays = 0;
  int depths = 0;  ///< samples of a ray; 0: one per pixel of the longest epipolar segment
};

/// From images on the host to depth on the host: the view's upload, correlation, removal of
/// ambiguous answers and islands; with a volume the rays' look-up, too. The neighbours' images are
/// on the device already. The machine's peak is measured between the runs. Errors: device;
/// invalid_argument: the lens is distorted (nothing here undistorts), the view or volume has no
/// neighbours, no voxel size gives so many rays.
[[nodiscard]] Expected<void> time_depth(const std::shared_ptr<Device>& device, PeakMeter& peak,
                                        const std::vector<DepthWork>& works, int runs,
                                        const std::stop_token& stop, MappingReport& report);

/// Depth maps of all views that get one from the mapping stage, with true poses, against truth;
/// nothing if it was asked to stop. Errors: device.
[[nodiscard]] Expected<std::optional<MappingRow>> score_mapping(
    const std::shared_ptr<Device>& device, const MappingScene& scene, const std::stop_token& stop);

/// The minimal surface of calibrated views in a volume cut into so many voxels, from depth maps
/// made beforehand (`views`: how many have one). `seconds` is the time of cut_stills() as a whole:
/// the choice of the points that two views agree on, labels, votes, graph, maximum flow, mesh, and
/// the vertices' colours. Errors: of depth_of_stills() and cut_surface().
[[nodiscard]] Expected<void> time_snapshots(const std::shared_ptr<Device>& device,
                                            const MappingScene& scene,
                                            const Eigen::AlignedBox3d& volume,
                                            const std::vector<double>& voxels, int runs,
                                            const std::stop_token& stop, MappingReport& report);

}  // namespace corvid
