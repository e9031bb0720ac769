#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace corvid {

/// Image pyramid, corners, tracking (algorithms.md 1 to 4).
struct FrontendOptions {
  int max_tracks = 800;           ///< features kept alive per frame
  int max_still_points = 3000;    ///< of photographs, in place of matching.max_points
  double corner_quality = 0.001;  ///< Q_c, share of the strongest lambda_min; 0.01 in thesis 4.2,
                                  ///< see docs/decisions/corner-quality.md
  double harris_kappa = 0.04;     ///< Harris-Stephens kappa (thesis 4.2)
  int template_px = 11;           ///< NCC template side (thesis 4.1)
  double min_score = 0.8;         ///< NCC score below which a track is lost
  double peak_quality = 0.85;     ///< Q_m: peaks kept, share of the window's best (thesis 3.2)
  double ratio_highest_scores = 1.1;  ///< tau_hsr (thesis 4.4.3)
  double max_epipolar_px = 1.5;       ///< inlier distance of the epipolar RANSAC [px]
  double corner_score_ratio = 5;      ///< tau_c: weak-corner removal (thesis 4.3)
  double keyframe_min_tracked = 0.7;  ///< new keyframe when fewer of the last one's tracks live
  double keyframe_parallax = 0.03;    ///< new keyframe at this median motion, share of the width
  std::uint64_t seed = 1;             ///< of RANSAC
  [[nodiscard]] std::vector<std::string> validate() const;
};

/// Which candidates of a feature are believed (algorithms.md 4).
struct DisambiguationOptions {
  /// Modules that run (thesis 4.4.4 to 4.4.11); `unique` and `fundamental` always do.
  bool highest_scores = true, epipolar = true, sectors = true, affine_transfer = true,
       topology = true, epipolar_transfer = true;
  /// tau_f [px]: Sampson distance (not squared) of a match to F; 0.2 in thesis 4.4.2.
  double max_epipolar_px = 0.2;
  double ratio_highest_scores = 1.1;  ///< tau_hsr (thesis 4.4.4)
  double ratio_epipolar = 10;         ///< tau_ratio of the epipolar module (thesis 4.4.5)
  double ratio = 1.5;                 ///< tau_ratio elsewhere (thesis 4.4.3)
  double global_px = 2.0;             ///< tau_global elsewhere [px] (thesis 4.4.3)
  double affine_px = 10;              ///< tau_affine (thesis 4.4.9) [px]
  int topology_neighbours = 1;        ///< n_m: as many common neighbours or fewer: withdrawn
  int min_matches = 16;               ///< fewer that agree on F: no geometry
  std::uint64_t seed = 1;             ///< of RANSAC
  [[nodiscard]] std::vector<std::string> validate() const;
};

/// Matching of image pairs: keyframes and stills (algorithms.md 3).
struct MatchingOptions {
  int max_points = 8000;           ///< interest points per image
  double corner_quality = 0.0002;  ///< Q_c; 0.01 in thesis 4.2, see docs/decisions/pair-matching.md
  double harris_kappa = 0.04;      ///< Harris-Stephens kappa (thesis 4.2)
  int template_px = 11;            ///< NCC template side (thesis 4.1)
  double peak_quality = 0.85;      ///< Q_m (thesis 4.3.1)
  double min_score = 0.7;          ///< NCC score below which nothing is a match
  int refine_template_px = 15;     ///< template side of the last measurement (known warps)
  double refine_min_score = 0.85;  ///< NCC score that a match needs in it
  double corner_score_ratio = 5;   ///< tau_c: weak-corner removal (thesis 4.3.2)
  int window_frames = 4;           ///< R_f: frames of the sliding window (thesis 4.1)
  DisambiguationOptions disambiguation;
  [[nodiscard]] std::vector<std::string> validate() const;
};

/// Start, resection, triangulation, windowed bundle adjustment (algorithms.md 6).
struct BackendOptions {
  double start_min_parallax_rad = 0.02;  ///< median ray angle of the two starting keyframes
  int start_min_inliers = 60;            ///< landmarks with positive depth and small error
  double max_error_px = 2.5;             ///< reprojection error of an inlier [px]
  double min_angle_rad = 0.01;           ///< widest ray angle under which nothing is triangulated
  double huber_px = 1.0;                 ///< robust loss width [px]
  int window_keyframes = 10;             ///< keyframes that the adjustment moves
  int max_iterations = 10;               ///< of one window adjustment
  int min_inliers = 20;                  ///< fewer agreeing landmarks: lost
  double max_scale_sigma = 0.02;   ///< positions make a map metric below this deviation [share]
  double max_position_gap_s = 2;   ///< positions are interpolated over gaps up to this long [s]
  bool final_adjustment = true;    ///< adjust everything once more at the end of the run
  int adjustment_views = 600'000;  ///< that it holds at once (about 1 KB each); a larger map is
                                   ///< adjusted in pieces
  /// Intrinsics that are estimated, too: auto, fixed, distortion (k1, k2) or all (focal length, k1,
  /// k2; at the end the whole lens). auto: all without a calibration, distortion where the
  /// calibration has none, else fixed.
  std::string intrinsics = "auto";
  double loop_max_drift = 0.1;  ///< a loop that moves the camera by more is refused; share of the
                                ///< way flown since the place was seen
  std::uint64_t seed = 1;       ///< of RANSAC
  [[nodiscard]] std::vector<std::string> validate() const;
};

/// Places seen before: relocalization, loops, map segments that meet (algorithms.md 6).
struct PlaceOptions {
  bool enabled = true;
  int candidates = 3;            ///< keyframes that a frame is matched with, at most
  double min_similarity = 0.35;  ///< of images, below which they are not matched; at most 1
  int min_landmarks = 30;        ///< of an old keyframe that must be found again
  double min_share = 0.5;        ///< of its landmarks that should be in view: repeated structure
                                 ///< agrees in parts only, see docs/decisions/places.md
  [[nodiscard]] std::vector<std::string> validate() const;
};

/// Depth maps, voxel map, mesh (algorithms.md 7 and 8).
struct MappingOptions {
  bool enabled = true;
  int neighbours = 4;      ///< M, views compared with a keyframe (thesis 6.4)
  int depth_samples = 96;  ///< inverse-depth samples per ray
  int depth_scale = 0;     ///< one ray per n x n pixels; 0: the least n that keeps a map within
                           ///< 640 x 480 rays
  int template_px = 11;    ///< NCC template side, Gaussian weight sigma = side/6 (thesis 6.2)
  double min_score = 0.6;  ///< tau: a neighbour counts above it (thesis 6.4)
  int min_views = 2;       ///< neighbours that must agree (thesis 6.4)
  double voxel_size = 0;   ///< [map units]; 0: median scene depth / 96
  int memory_mb = 256;     ///< depth maps and voxels in memory [MiB]; what is not in use goes to a
                           ///< file
  int disk_mb = 4096;      ///< of voxels in that file [MiB]; beyond it the oldest are lost
  double stream_bytes_per_s = 250000;  ///< of mesh, to each receiver
  /// Of the snapshot by graph cut (thesis 6.7, docs/decisions/surface-cut.md).
  double cut_voxel_size = 0;    ///< [unit of the results]; 0: the live map's
  double cut_decay = 15;        ///< mu: a face costs exp(-mu * sum of votes) (thesis 6.30)
  double cut_ballooning = 0.4;  ///< lambda * h: cost of a voxel's volume, share of its face's
  bool cut_closed = true;       ///< off: without caps and the parts that no point supports
  int cut_max_mb = 1000;        ///< memory for it [MB]; larger voxels where that would not do
  [[nodiscard]] std::vector<std::string> validate() const;
};

struct Options {
  FrontendOptions frontend;
  MatchingOptions matching;
  BackendOptions backend;
  PlaceOptions place;
  MappingOptions mapping;
  std::string device = "auto";  ///< OpenCL device: auto, cpu, gpu, or an index from `corvid doctor`
  int threads = 0;              ///< CPU budget of all stages; 0: all cores; 1: every stage inline
  int keyframe_images_mb = 128;  ///< of the newest keyframes; older ones go to the archive file
  /// Every problem of every stage, as "stage.field: what is wrong"; empty if none.
  [[nodiscard]] std::vector<std::string> validate() const;
};

}  // namespace corvid
