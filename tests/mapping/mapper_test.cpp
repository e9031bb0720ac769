#include "mapping/mapper.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "core/median.h"
#include "mapping/mesh_checks.h"
#include "mapping/voxel_block.h"
#include "scenes/memory_archive.h"
#include "scenes/true_map.h"

namespace corvid {
namespace {

using testing::PlaneScene;

std::shared_ptr<Device> device() {
  static const auto opened = Device::open("auto");
  if (!opened) throw std::runtime_error(opened.error().to_string());
  return *opened;
}

std::unique_ptr<Mapper> make_mapper(MeshSink* sink = nullptr, int memory_mb = 256,
                                    std::shared_ptr<Archive> archive = nullptr) {
  MappingOptions options;
  options.depth_scale = 1;
  options.memory_mb = memory_mb;
  auto mapper = Mapper::create(device(), options, sink, std::move(archive));
  if (!mapper) throw std::runtime_error(mapper.error().to_string());
  return std::move(*mapper);
}

/// Keeps the newest mesh of every block, as a viewer would.
struct Viewer final : MeshSink {
  std::map<std::array<int, 3>, TriangleMesh> blocks;
  std::uint64_t version = 0;
  int removals = 0;
  bool emptied = false;                      ///< since the last complete version
  std::vector<std::size_t> complete;         ///< triangles of each complete version
  std::optional<std::size_t> after_emptied;  ///< position in it
  void on_complete(std::uint64_t) override {
    if (std::exchange(emptied, false)) after_emptied = complete.size();
    complete.push_back(triangles());
  }
  void on_block(const MeshBlock& block) override {
    EXPECT_GE(block.version, version);
    version = block.version;
    if (block.mesh.empty()) {
      EXPECT_EQ(blocks.erase(block.index), 1U) << "removed, but it was never sent";
      ++removals;
      emptied |= blocks.empty();
    } else {
      blocks[block.index] = block.mesh;
    }
  }
  [[nodiscard]] std::size_t triangles() const {
    std::size_t n = 0;
    for (const auto& [index, mesh] : blocks) n += mesh.triangles.size();
    return n;
  }
};

/// A ball in front of a wall over a floor.
PlaneScene room() {
  PlaneScene scene;
  scene.planes = {{Eigen::Vector3d(0, 0, 1), 5}, {Eigen::Vector3d(0, 1, 0), 1.2}};
  scene.spheres = {{Eigen::Vector3d(0.3, 0.2, 3.2), 0.7}};
  scene.finest = 0.07;
  return scene;
}

double distance_to_room(const Eigen::Vector3d& p) {
  return std::min({std::abs(p.z() - 5), std::abs(p.y() - 1.2),
                   std::abs((p - Eigen::Vector3d(0.3, 0.2, 3.2)).norm() - 0.7)});
}

const MapSnapshot& room_map() {
  static const MapSnapshot map = [] {
    std::vector<Pose> poses;
    for (int i = 0; i < 7; ++i) {
      poses.emplace_back(so3_exp({-0.1, -0.04 * (i - 3), 0}),
                         Eigen::Vector3d(0.18 * (i - 3), 0.03 * (i % 2), 0.05 * i));
    }
    return testing::true_map(room(), testing::pinhole(160, 120, 130), poses);
  }();
  return map;
}

MapSnapshot first_keyframes(const MapSnapshot& map, std::size_t n) {
  MapSnapshot out = map;
  out.keyframes.resize(n);
  return out;
}

template <class Move>
Landmarks moved(const Landmarks& landmarks, const Move& move) {
  std::vector<Landmark> out(landmarks.begin(), landmarks.end());
  for (Landmark& landmark : out) landmark.p_world = move(landmark.p_world);
  return Landmarks(std::move(out));
}

MapSnapshot moved(const MapSnapshot& map, const Pose& T_new_old) {
  MapSnapshot out = map;
  ++out.version;
  for (auto& keyframe : out.keyframes) {
    auto copy = std::make_shared<Keyframe>(*keyframe);
    copy->T_world_camera = T_new_old * copy->T_world_camera;
    keyframe = copy;
  }
  out.landmarks = moved(map.landmarks, [&](const Eigen::Vector3d& p) { return T_new_old * p; });
  return out;
}

double median_error_vox(const TriangleMesh& mesh, double voxel_size, const Pose& T_old_new = {}) {
  std::vector<double> errors;
  for (const auto& v : mesh.vertices) {
    errors.push_back(distance_to_room(T_old_new * v.cast<double>()) / voxel_size);
  }
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2),
                   errors.end());
  return errors[errors.size() / 2];
}

TEST(Mapper, DepthAndSurfaceOfAKnownRoom) {
  Viewer viewer;
  auto mapper = make_mapper(&viewer);
  mapper->finish(room_map());
  const MapperStatistics statistics = mapper->statistics();
  EXPECT_EQ(statistics.depth_maps, 7U);
  EXPECT_GT(statistics.answered, 0.6);
  int answers = 0, within_2_percent = 0, near_top = 0;
  for (const StoredDepth& stored : mapper->depth_maps()) {
    const auto map = stored.scaled();
    const FloatImage truth = room().depth(map->camera, map->T_world_camera);
    for (std::size_t i = 0; i < truth.size(); ++i) {
      if (!(map->depth.data()[i] > 0)) continue;
      ++answers;
      near_top += i < 10 * static_cast<std::size_t>(truth.width());
      within_2_percent += std::abs(map->depth.data()[i] / truth.data()[i] - 1) < 0.02;
      EXPECT_GT(map->confidence.data()[i], 0);
      EXPECT_LE(map->confidence.data()[i], 1);
    }
  }
  EXPECT_GT(within_2_percent, 0.9 * answers);
  EXPECT_GT(near_top, 0.3 * 7 * 5 * 160) << "rows 5 to 9, the first with whole templates";
  const TriangleMesh mesh = mapper->mesh();
  ASSERT_GT(mesh.triangles.size(), 5000U);
  EXPECT_LT(median_error_vox(mesh, mapper->voxel_size()), 0.5);
  EXPECT_EQ(testing::topology(mesh).crowded_edges, 0);
  EXPECT_EQ(viewer.triangles(), mesh.triangles.size()) << "what was sent is the whole surface";
}

TEST(Mapper, AKeyframeWaitsForItsLaterNeighbours) {
  auto mapper = make_mapper();
  EXPECT_FALSE(mapper->step({}));
  EXPECT_FALSE(mapper->step(first_keyframes(room_map(), 2)));
  EXPECT_TRUE(mapper->step(first_keyframes(room_map(), 3)));
  EXPECT_FALSE(mapper->step(first_keyframes(room_map(), 3)));
  EXPECT_EQ(mapper->depth_maps().size(), 1U);
  EXPECT_TRUE(mapper->step(first_keyframes(room_map(), 4)));
  EXPECT_EQ(mapper->depth_maps().back().keyframe, KeyframeId(1));
  mapper->finish(first_keyframes(room_map(), 4));
  EXPECT_EQ(mapper->depth_maps().size(), 4U);
}

TEST(Mapper, TheSurfaceFollowsTheKeyframes) {
  Viewer viewer;
  auto mapper = make_mapper(&viewer);
  mapper->finish(room_map());
  const std::size_t blocks = mapper->statistics().blocks;
  const Pose T_new_old(so3_exp({0.02, 0.2, -0.1}), Eigen::Vector3d(0.7, -0.3, 0.4));
  const MapSnapshot after = moved(room_map(), T_new_old);
  mapper->finish(after);
  EXPECT_EQ(mapper->statistics().refusions, 7U);
  EXPECT_EQ(mapper->depth_maps().size(), 7U) << "no depth is estimated twice";
  const TriangleMesh mesh = mapper->mesh();
  EXPECT_LT(median_error_vox(mesh, mapper->voxel_size(), T_new_old.inverse()), 0.5);
  EXPECT_GT(median_error_vox(mesh, mapper->voxel_size()), 2);
  EXPECT_GT(viewer.removals, 0);
  EXPECT_EQ(viewer.triangles(), mesh.triangles.size());
  // Back again: nothing of the excursion is left.
  mapper->finish(room_map());
  EXPECT_NEAR(static_cast<double>(mapper->statistics().blocks), static_cast<double>(blocks),
              0.02 * static_cast<double>(blocks));
  EXPECT_LT(median_error_vox(mapper->mesh(), mapper->voxel_size()), 0.5);
}

/// The same keyframes once more, long after, from beside where they were.
MapSnapshot with_another_lap(const MapSnapshot& map, double beside) {
  MapSnapshot out = map;
  ++out.version;
  for (const auto& keyframe : map.keyframes) {
    auto again = std::make_shared<Keyframe>(*keyframe);
    again->id = KeyframeId(keyframe->id.value + 100);
    again->T_world_camera = {again->T_world_camera.rotation(),
                             again->T_world_camera.translation() + Eigen::Vector3d(0, beside, 0)};
    out.keyframes.push_back(again);
  }
  return out;
}

TEST(Mapper, KnownGroundIsNotMappedAgain) {
  auto mapper = make_mapper();
  mapper->finish(room_map());
  ASSERT_EQ(mapper->statistics().depth_maps, 7U);
  const MapSnapshot again = with_another_lap(room_map(), 0.05);
  mapper->finish(again);
  EXPECT_EQ(mapper->statistics().depth_maps, 7U);
  EXPECT_EQ(mapper->statistics().skipped, 7U);
  auto other = make_mapper();
  other->finish(room_map());
  other->finish(with_another_lap(room_map(), 0.6));
  EXPECT_EQ(other->statistics().skipped, 0U) << "a view from elsewhere is new";
}

MapSnapshot scaled(const MapSnapshot& map, double scale, std::size_t keyframes) {
  MapSnapshot out = map;
  out.keyframes.resize(keyframes);
  for (auto& keyframe : out.keyframes) {
    auto copy = std::make_shared<Keyframe>(*keyframe);
    copy->T_world_camera =
        Pose(keyframe->T_world_camera.rotation(), scale * keyframe->T_world_camera.translation());
    keyframe = copy;
  }
  out.landmarks = moved(map.landmarks, [&](const Eigen::Vector3d& p) { return scale * p; });
  return out;
}

TEST(Mapper, VoxelsAndDepthFollowTheScaleOfTheMap) {
  // The first keyframes are mapped when the map is a tenth as large as it turns out to be.
  Viewer viewer;
  const auto mapper = make_mapper(&viewer);
  const MapSnapshot small = scaled(room_map(), 0.1, 5);
  while (mapper->step(small)) {
  }
  const double before = mapper->voxel_size();
  ASSERT_GE(mapper->depth_maps().size(), 3U);
  mapper->finish(room_map());
  EXPECT_EQ(mapper->statistics().refits, 1U);
  ASSERT_TRUE(viewer.after_emptied);
  EXPECT_GT(viewer.complete[*viewer.after_emptied], viewer.complete.back() / 2)
      << "no complete version before the keyframes are back";
  EXPECT_NEAR(mapper->voxel_size() / before, 10, 3);
  const auto straight = make_mapper();
  straight->finish(room_map());
  const TriangleMesh mesh = mapper->mesh(), expected = straight->mesh();
  EXPECT_NEAR(static_cast<double>(mesh.triangles.size()),
              static_cast<double>(expected.triangles.size()), 0.5 * expected.triangles.size());
  std::vector<double> distances;
  for (const auto& v : mesh.vertices) distances.push_back(distance_to_room(v.cast<double>()));
  std::nth_element(distances.begin(), distances.begin() + distances.size() / 2, distances.end());
  EXPECT_LT(distances[distances.size() / 2], mapper->voxel_size());
  EXPECT_GE(viewer.triangles(), mesh.triangles.size());  // border triangles are not shared
  EXPECT_GT(viewer.removals, 0);
}

TEST(Mapper, KeyframesThatLeaveTheMapTakeTheirSurfaceAlong) {
  Viewer viewer;
  auto mapper = make_mapper(&viewer);
  mapper->finish(first_keyframes(room_map(), 5));
  ASSERT_GT(viewer.triangles(), 0U);
  MapSnapshot other = room_map();
  other.keyframes.erase(other.keyframes.begin(), other.keyframes.begin() + 6);
  mapper->finish(other);
  EXPECT_EQ(mapper->statistics().blocks, 0U);
  EXPECT_TRUE(viewer.blocks.empty());
  EXPECT_TRUE(mapper->mesh().empty());
}

/// Share of the mesh farther than two voxels from the room: the second surface of an overlap whose
/// two passes do not agree.
double astray(const TriangleMesh& mesh, double voxel_size) {
  std::size_t far = 0;
  for (const auto& v : mesh.vertices) far += distance_to_room(v.cast<double>()) > 2 * voxel_size;
  return static_cast<double>(far) / static_cast<double>(mesh.vertices.size());
}

/// Two passes over one place: keyframes and landmarks of both, those of `second` in `segment`.
MapSnapshot both_passes(const MapSnapshot& first, const MapSnapshot& second, int segment) {
  constexpr std::uint32_t kNew = 100000;  // ids of the second pass begin here
  MapSnapshot out = first;
  std::vector<Landmark> landmarks(first.landmarks.begin(), first.landmarks.end());
  for (Landmark landmark : second.landmarks) {
    landmark.id = LandmarkId(landmark.id.value + kNew);
    landmarks.push_back(landmark);
  }
  out.landmarks = Landmarks(std::move(landmarks));
  for (const auto& keyframe : second.keyframes) {
    auto copy = std::make_shared<Keyframe>(*keyframe);
    copy->id = KeyframeId(copy->id.value + kNew);
    copy->segment = segment;
    for (Observation& o : copy->observations) o.landmark = LandmarkId(o.landmark.value + kNew);
    out.keyframes.push_back(copy);
  }
  return out;
}

TEST(Mapper, AfterALoopClosureTheOverlapHasOneSurface) {
  // The room seen twice: the second time from poses that have drifted, in the first segment or in
  // one of its own. Then the loop closes.
  const Pose drift(so3_exp({0.01, 0.05, -0.02}), Eigen::Vector3d(0.1, -0.05, 0.45));
  const auto one_pass = make_mapper();
  one_pass->finish(room_map());
  const double astray_once = astray(one_pass->mesh(), one_pass->voxel_size());
  for (const int second_segment : {0, 1}) {
    Viewer viewer;
    const auto mapper = make_mapper(&viewer);
    mapper->finish(both_passes(room_map(), moved(room_map(), drift), second_segment));
    const MapperStatistics before = mapper->statistics();
    const double astray_before = astray(mapper->mesh(), mapper->voxel_size());
    if (second_segment == 0) {
      EXPECT_GT(astray_before, astray_once + 0.2) << "there must be a second surface to remove";
    } else {
      EXPECT_NEAR(astray_before, astray_once, 0.01) << "segments have no common frame";
    }
    mapper->finish(both_passes(room_map(), room_map(), 0));
    EXPECT_EQ(mapper->statistics().depth_maps, before.depth_maps) << "no depth is estimated twice";
    EXPECT_NEAR(astray(mapper->mesh(), mapper->voxel_size()), astray_once, 0.01);
    EXPECT_LT(median_error_vox(mapper->mesh(), mapper->voxel_size()), 0.5);
    EXPECT_EQ(viewer.triangles(), mapper->mesh().triangles.size());
  }
}

TEST(Mapper, ASpentBudgetChangesNothingButWhereThingsLie) {
  const auto archive = std::make_shared<testing::MemoryArchive>();
  const Pose T_new_old(so3_exp({0.02, 0.2, -0.1}), Eigen::Vector3d(0.7, -0.3, 0.4));
  std::unique_ptr<Mapper> mappers[] = {make_mapper(), make_mapper(nullptr, 1, archive)};
  for (const auto& mapper : mappers) {
    mapper->finish(room_map());
    mapper->finish(moved(room_map(), T_new_old));
    EXPECT_EQ(mapper->statistics().refusions, 7U);
    EXPECT_EQ(mapper->statistics().lost_blocks, 0U);
  }
  const auto statistics = mappers[1]->statistics();
  EXPECT_LT(statistics.blocks_in_memory, statistics.blocks / 2);
  const auto maps = mappers[1]->depth_maps(), expected = mappers[0]->depth_maps();
  ASSERT_EQ(maps.size(), expected.size());
  std::size_t in_memory = 0;
  for (std::size_t i = 0; i < maps.size(); ++i) {
    in_memory += maps[i].in_memory();
    EXPECT_EQ(maps[i].load().depth, expected[i].load().depth);
    EXPECT_EQ(maps[i].load().confidence, expected[i].load().confidence);
  }
  EXPECT_LT(in_memory, 3U);
  const TriangleMesh mesh = mappers[1]->mesh(), same = mappers[0]->mesh();
  EXPECT_EQ(mesh.vertices, same.vertices);
  EXPECT_EQ(mesh.triangles, same.triangles);
  EXPECT_EQ(mesh.colours, same.colours);
}

TEST(Mapper, DepthMapsAreHandedOutInThePoseAndScaleOfTheMapAsked) {
  // The unit of length changes after the last keyframe, of the main segment and of another one.
  const MapSnapshot small = scaled(room_map(), 0.1, 7);
  const auto mapper = make_mapper();
  mapper->finish(both_passes(small, small, 1));
  const MapSnapshot after = both_passes(room_map(), room_map(), 1);
  const auto check = [&] {
    const std::vector<StoredDepth> maps = mapper->depth_maps(after);
    ASSERT_EQ(maps.size(), 14U);
    for (std::size_t i = 0; i < maps.size(); ++i) {
      const DepthMap map = maps[i].load();
      const Pose& T = after.keyframes[i]->T_world_camera;
      EXPECT_EQ(map.T_world_camera.translation(), T.translation());
      const FloatImage truth = room().depth(map.camera, T);
      std::vector<double> errors;
      for (std::size_t k = 0; k < truth.size(); ++k) {
        if (map.depth.data()[k] > 0)
          errors.push_back(std::abs(map.depth.data()[k] / truth.data()[k] - 1));
      }
      ASSERT_GT(errors.size(), 5000U);
      EXPECT_LT(upper_median(std::move(errors)), 0.01) << i;
    }
  };
  check();
  mapper->finish(after);
  check();
  EXPECT_EQ(mapper->depth_maps().size(), 14U);
}

TEST(Mapper, DepthMapsThatCannotBeReadBackAreGivenUp) {
  // Fused already, and not yet: the second pass lies in a segment of its own until it joins.
  for (const bool joins : {false, true}) {
    const auto archive = std::make_shared<testing::MemoryArchive>();
    const auto mapper = make_mapper(nullptr, 1, archive);
    mapper->finish(joins ? both_passes(room_map(), room_map(), 1) : room_map());
    const std::size_t all = mapper->depth_maps().size();
    archive->broken = true;
    mapper->finish(joins
                       ? both_passes(room_map(), room_map(), 0)
                       : moved(room_map(), Pose(so3_exp({0, 0.1, 0}), Eigen::Vector3d(0.5, 0, 0))));
    const MapperStatistics statistics = mapper->statistics();
    EXPECT_GE(statistics.lost_depth_maps, 6U);
    EXPECT_EQ(mapper->depth_maps().size() + statistics.lost_depth_maps, all);
    EXPECT_GT(mapper->depth_maps().size(), 0U) << "the newest is in memory";
    mapper->finish(room_map());
    EXPECT_FALSE(mapper->mesh().empty());
  }
}

TEST(Mapper, BlocksLostWhileMeshingAreAnnounced) {
  // The later keyframes look to the right: beside what they see lies what only the archive has.
  std::vector<Pose> poses;
  for (int i = 0; i < 10; ++i) {
    poses.emplace_back(so3_exp({-0.1, i < 5 ? -0.45 : 0.25, 0}),
                       Eigen::Vector3d(0.15 * (i % 5), 0.03 * (i % 2), 0.05 * i));
  }
  const MapSnapshot map = testing::true_map(room(), testing::pinhole(160, 120, 130), poses);
  Viewer viewer;
  const auto archive = std::make_shared<testing::MemoryArchive>();
  const auto mapper = make_mapper(&viewer, 1, archive);
  mapper->finish(first_keyframes(map, 5));
  EXPECT_EQ(mapper->statistics().lost_blocks, 0U);
  archive->broken = true;
  mapper->finish(map);
  archive->broken = false;
  EXPECT_GT(mapper->statistics().lost_blocks, 0U);
  EXPECT_EQ(viewer.triangles(), mapper->mesh().triangles.size());
}

TEST(Mapper, WithoutAnArchiveTheBudgetHolds) {
  auto mapper = make_mapper(nullptr, 1);
  mapper->finish(room_map());
  EXPECT_LE(mapper->statistics().blocks * sizeof(VoxelBlock), 1U << 20);
  EXPECT_GT(mapper->statistics().lost_blocks, 0U);
}

TEST(Mapper, ResultsRepeatBitForBit) {
  std::vector<TriangleMesh> meshes;
  for (int i = 0; i < 2; ++i) {
    auto mapper = make_mapper();
    for (std::size_t n = 1; n <= room_map().keyframes.size(); ++n) {
      while (mapper->step(first_keyframes(room_map(), n))) {
      }
    }
    mapper->finish(room_map());
    meshes.push_back(mapper->mesh());
  }
  EXPECT_EQ(meshes[0].vertices, meshes[1].vertices);
  EXPECT_EQ(meshes[0].triangles, meshes[1].triangles);
  EXPECT_EQ(meshes[0].colours, meshes[1].colours);
}

TEST(Mapper, LensesAreUndistorted) {
  Camera lens = testing::pinhole(160, 120, 110);
  lens.model = CameraModel::radtan;
  lens.distortion = {-0.28, 0.07, 0.0002, -0.0003, 0};
  std::vector<Pose> poses;
  for (const auto& keyframe : room_map().keyframes) poses.push_back(keyframe->T_world_camera);
  poses.resize(5);
  auto mapper = make_mapper();
  mapper->finish(testing::true_map(room(), lens, poses));
  ASSERT_EQ(mapper->depth_maps().size(), 5U);
  EXPECT_EQ(mapper->depth_maps()[0].scaled()->camera.model, CameraModel::pinhole);
  EXPECT_LT(median_error_vox(mapper->mesh(), mapper->voxel_size()), 0.5);
}

TEST(Mapper, BadViewsGiveNoDepthAndNoFault) {
  const auto surface_of = [](const MapSnapshot& map) {
    auto mapper = make_mapper();
    mapper->finish(map);
    return mapper->depth_maps().size() + mapper->mesh().triangles.size();
  };
  const Camera camera = testing::pinhole(80, 60, 65);
  const Pose here;
  EXPECT_EQ(surface_of(testing::true_map(room(), camera, {here, here, here, here})), 0U)
      << "identical views";
  const Pose away(so3_exp({0, M_PI, 0}), Eigen::Vector3d(0.2, 0, 0));
  EXPECT_EQ(surface_of(testing::true_map(room(), camera, {here, away, here})), 0U)
      << "the only view from elsewhere looks away";
  PlaneScene blank = room();
  blank.contrast = 0;
  std::vector<Pose> poses;
  for (int i = 0; i < 4; ++i) {
    poses.emplace_back(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.2 * i, 0, 0));
  }
  EXPECT_EQ(surface_of(testing::true_map(blank, camera, poses)), 0U) << "no texture";
  MapSnapshot no_landmarks = testing::true_map(room(), camera, poses, 0);
  EXPECT_EQ(surface_of(no_landmarks), 0U);
  // Poses and landmarks that disagree by a factor of a thousand.
  MapSnapshot wrong = testing::true_map(room(), camera, poses);
  wrong.landmarks = moved(wrong.landmarks, [](const Eigen::Vector3d& p) { return 1000 * p; });
  EXPECT_EQ(surface_of(wrong), 0U) << "landmarks that do not fit the poses";
  // An image of another size than the camera says.
  MapSnapshot odd = testing::true_map(room(), camera, poses);
  for (auto& keyframe : odd.keyframes) {
    auto frame = std::make_shared<Frame>(*keyframe->frame->load());
    frame->grey = GreyImage(30, 20);
    auto copy = std::make_shared<Keyframe>(*keyframe);
    copy->frame = std::make_shared<const StoredFrame>(frame);
    keyframe = copy;
  }
  EXPECT_EQ(surface_of(odd), 0U);
}

TEST(Mapper, VoxelsOfAWrongScaleGiveNoSurface) {
  for (const double scale : {1e-3, 1e3}) {
    MappingOptions options;
    options.voxel_size = 0.05 * scale;
    auto mapper = Mapper::create(device(), options, nullptr);
    ASSERT_TRUE(mapper);
    (*mapper)->finish(first_keyframes(room_map(), 3));
    const MapperStatistics statistics = (*mapper)->statistics();
    EXPECT_GT(statistics.depth_maps, 0U);
    EXPECT_LT(statistics.blocks, 10U);
    EXPECT_TRUE((*mapper)->mesh().empty());
  }
}

TEST(Mapper, WrongOptionsAreRefused) {
  MappingOptions options;
  options.template_px = 8;
  EXPECT_FALSE(Mapper::create(device(), options, nullptr).has_value());
}

}  // namespace
}  // namespace corvid
