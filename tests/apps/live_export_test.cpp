#include "apps/live_export.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>

#include "apps/program_fixture.h"
#include "io/mesh_files.h"
#include "scenes/temporary_folder.h"

namespace corvid {
namespace {

/// Two triangles over the whole of block (i, 0, 0) at height z, which its neighbours share.
MeshBlock tile(int i, std::uint64_t version, float z) {
  MeshBlock block{{i, 0, 0}, version, 0.25, 16, {}};
  const float x0 = 4.0F * static_cast<float>(i), x1 = x0 + 4;
  block.mesh.vertices = {{x0, 0, z}, {x1, 0, z}, {x0, 4, z}, {x1, 4, z}};
  block.mesh.normals.assign(4, Eigen::Vector3f(0, 0, 1));
  block.mesh.colours.assign(4, Rgb8{10, 20, 30});
  block.mesh.triangles = {{0, 1, 2}, {1, 3, 2}};
  return block;
}

void give(MeshStream& stream, std::uint64_t version, float z) {
  for (int i = -2; i < 3; ++i) stream.on_block(tile(i, version, z));
  stream.on_complete(version);
}

TEST(LiveExport, TheSurfaceOfOneMomentWelded) {
  const TemporaryFolder folder;
  MeshStream stream;
  const auto server = LiveExportServer::start(folder / "run", &stream);
  ASSERT_TRUE(server);
  const auto empty = fetch_live_surface(folder / "run");
  ASSERT_TRUE(empty && *empty);
  EXPECT_TRUE((*empty)->empty());
  give(stream, 1, 1.0F);
  const auto mesh = fetch_live_surface((folder / "run").string() + "/");
  ASSERT_TRUE(mesh && *mesh) << mesh.error().to_string();
  EXPECT_EQ((*mesh)->triangles.size(), 10U);
  EXPECT_EQ((*mesh)->vertices.size(), 12U);
  EXPECT_EQ((*mesh)->colours[0], (Rgb8{10, 20, 30}));
  for (const auto& v : (*mesh)->vertices) EXPECT_EQ(v.z(), 1.0F);
  EXPECT_TRUE(stream.join()->next(1).size() == 1) << "other receivers are not disturbed";
}

TEST(LiveExport, NoHalfVersionIsHandedOut) {
  const TemporaryFolder folder;
  MeshStream stream;
  const auto server = LiveExportServer::start(folder / "run", &stream);
  ASSERT_TRUE(server);
  give(stream, 1, 1.0F);
  const auto expect_all_at = [&](float z) {
    const auto mesh = fetch_live_surface(folder / "run");
    ASSERT_TRUE(mesh && *mesh);
    EXPECT_EQ((*mesh)->triangles.size(), 10U);
    for (const auto& v : (*mesh)->vertices) EXPECT_EQ(v.z(), z);
  };
  for (int i = -2; i < 0; ++i) stream.on_block(tile(i, 2, 2.0F));
  expect_all_at(1.0F);
  for (int i = 0; i < 3; ++i) stream.on_block(tile(i, 2, 2.0F));
  expect_all_at(1.0F);
  stream.on_complete(2);
  expect_all_at(2.0F);
}

TEST(LiveExport, NothingRunsNothingIsLeft) {
  const TemporaryFolder folder;
  const auto none = fetch_live_surface(folder / "run");
  ASSERT_TRUE(none);
  EXPECT_FALSE(none->has_value());
  MeshStream stream;
  {
    const auto server = LiveExportServer::start(folder / "run", &stream);
    ASSERT_TRUE(server);
    EXPECT_FALSE(LiveExportServer::start(folder / "run", &stream)) << "one at a time";
    EXPECT_TRUE(LiveExportServer::start(folder / "other", &stream));
  }
  const auto after = fetch_live_surface(folder / "run");
  ASSERT_TRUE(after);
  EXPECT_FALSE(after->has_value());
  // Nor after a kill that nobody can catch.
  const pid_t child = ::fork();
  if (child == 0) {
    const auto killed = LiveExportServer::start(folder / "run", &stream);
    ::raise(SIGKILL);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  ASSERT_TRUE(WIFSIGNALED(status));
  EXPECT_TRUE(LiveExportServer::start(folder / "run", &stream));
}

TEST(LiveExport, TheCommandWritesBesideTheFolderThatIsNotThereYet) {
  const TemporaryFolder folder;
  MeshStream stream;
  const auto server = LiveExportServer::start(folder / "run", &stream);
  const std::string run = (folder / "run").string();
  const Ran early = corvid_run({"export", run, "--format", "ply"});
  EXPECT_EQ(early.code, 3);
  EXPECT_THAT(early.err, ::testing::HasSubstr("no surface yet"));
  give(stream, 1, 1.0F);
  for (const char* format : {"ply", "obj", "drc", "glb"}) {
    const Ran ran = corvid_run({"export", run, "--format", format});
    ASSERT_EQ(ran.code, 0) << ran.err;
    const auto mesh = read_mesh(run + "-live." + format);
    ASSERT_TRUE(mesh) << mesh.error().to_string();
    EXPECT_EQ(mesh->triangles.size(), 10U);
  }
}

TEST(LiveExport, ARunWithoutMappingSaysSo) {
  const TemporaryFolder folder;
  const auto server = LiveExportServer::start(folder / "run", nullptr);
  ASSERT_TRUE(server);
  const Ran ran = corvid_run({"export", (folder / "run").string(), "--format", "ply"});
  EXPECT_EQ(ran.code, 3);
  EXPECT_THAT(ran.err, ::testing::HasSubstr("maps nothing"));
}

TEST(LiveExport, WhoeverElseTookTheNameIsNotBelieved) {
  if (::geteuid() != 0) GTEST_SKIP() << "only root can be somebody else for a moment";
  const TemporaryFolder folder;
  MeshStream stream;
  give(stream, 1, 1.0F);
  constexpr uid_t kNobody = 65534;
  ASSERT_EQ(::seteuid(kNobody), 0);
  const auto server = LiveExportServer::start(folder / "run", &stream);
  ASSERT_EQ(::seteuid(0), 0);
  ASSERT_TRUE(server);
  const auto mesh = fetch_live_surface(folder / "run");
  ASSERT_TRUE(mesh);
  EXPECT_FALSE(mesh->has_value());
}

}  // namespace
}  // namespace corvid
