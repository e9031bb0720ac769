#include "io/atomic_file.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <string>

#include "scenes/temporary_folder.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;

std::size_t entries(const fs::path& dir) {
  return static_cast<std::size_t>(
      std::distance(fs::directory_iterator(dir), fs::directory_iterator()));
}

/// Starts a child that runs `work` for ever, and kills it after a while.
template <class F>
void kill_in_the_middle(F work, int milliseconds) {
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    while (true) work();
  }
  ::usleep(static_cast<useconds_t>(milliseconds) * 1000);
  ::kill(child, SIGKILL);
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFSIGNALED(status));
}

TEST(AtomicFile, WritesReplacesAndReads) {
  const TemporaryFolder folder;
  const fs::path path = folder / "a" / "b.txt";  // the parent is made
  ASSERT_TRUE(write_file_atomically(path, "one"));
  ASSERT_TRUE(write_file_atomically(path, std::string("two\0!", 5)));
  EXPECT_EQ(read_file_bytes(path).value(), std::string("two\0!", 5));
  EXPECT_EQ(entries(folder / "a"), 1u);
}

TEST(AtomicFile, Errors) {
  const TemporaryFolder folder;
  EXPECT_EQ(read_file_bytes(folder / "absent").error().code, ErrorCode::not_found);
  ASSERT_TRUE(write_file_atomically(folder / "file", "x"));
  const auto below = write_file_atomically(folder / "file" / "sub", "x");
  ASSERT_FALSE(below);
  EXPECT_NE(below.error().to_string().find("file"), std::string::npos);
  ASSERT_TRUE(fs::create_directory(folder / "dir"));
  EXPECT_FALSE(write_file_atomically(folder / "dir", "x"));
  EXPECT_EQ(entries(folder.path()), 2u);  // no temporary name is left
}

TEST(AtomicFile, WritesThroughLinksAndNeverOverWhatIsNoFile) {
  const TemporaryFolder folder;
  ASSERT_TRUE(write_file_atomically(folder / "real", "old"));
  ASSERT_TRUE(fs::create_directory(folder / "dir"));
  fs::create_symlink("../real", folder / "dir" / "link");  // relative to where it lies
  fs::create_symlink(folder / "dir" / "link", folder / "chain");
  ASSERT_TRUE(write_file_atomically(folder / "chain", "new"));
  EXPECT_EQ(read_file_bytes(folder / "real").value(), "new");
  EXPECT_TRUE(fs::is_symlink(folder / "chain"));
  EXPECT_TRUE(fs::is_symlink(folder / "dir" / "link"));
  fs::create_symlink("made", folder / "dangling");
  ASSERT_TRUE(write_file_atomically(folder / "dangling", "x"));
  EXPECT_EQ(read_file_bytes(folder / "made").value(), "x");
  fs::create_symlink("loop", folder / "loop");
  EXPECT_FALSE(write_file_atomically(folder / "loop", "x"));

  ASSERT_EQ(::mkfifo((folder / "pipe").c_str(), 0600), 0);
  fs::create_symlink("pipe", folder / "to_pipe");
  fs::create_symlink("/dev/full", folder / "to_device");
  for (const char* name : {"pipe", "to_pipe", "to_device", "dir"}) {
    const auto refused = write_file_atomically(folder / name, "x");
    ASSERT_FALSE(refused) << name;
    EXPECT_EQ(refused.error().code, ErrorCode::invalid_argument) << name;
  }
  EXPECT_TRUE(fs::is_fifo(folder / "pipe"));
}

TEST(AtomicFile, KilledWriterLeavesTheOldFileOrAWholeNewOne) {
  const TemporaryFolder folder;
  const fs::path path = folder / "file.bin";
  const std::string content[2] = {std::string(3'000'000, 'a'), std::string(3'000'000, 'b')};
  ASSERT_TRUE(write_file_atomically(path, content[0]));
  for (const int milliseconds : {5, 13, 29, 61}) {
    int turn = 0;
    kill_in_the_middle(
        [&] { (void)write_file_atomically(path, content[static_cast<std::size_t>(++turn % 2)]); },
        milliseconds);
    const auto bytes = read_file_bytes(path);
    ASSERT_TRUE(bytes);
    EXPECT_TRUE(*bytes == content[0] || *bytes == content[1]) << bytes->size();
  }
}

TEST(AtomicFolder, AppearsWholeOrNotAtAll) {
  const TemporaryFolder folder;
  const fs::path target = folder / "run";
  {
    auto out = AtomicFolder::create(target, "marker");
    ASSERT_TRUE(out) << out.error().to_string();
    ASSERT_TRUE(write_file_atomically(out->path() / "marker", "1"));
    EXPECT_FALSE(fs::exists(target));
    EXPECT_NE(out->path().filename().string().find("run.partial-"), std::string::npos);
  }  // not committed
  EXPECT_EQ(entries(folder.path()), 0u);
  auto out =
      AtomicFolder::create(target.string() + "/", "marker");  // a slash at the end is the same
  ASSERT_TRUE(out);
  ASSERT_TRUE(write_file_atomically(out->path() / "marker", "1"));
  ASSERT_TRUE(out->commit());
  EXPECT_TRUE(fs::exists(target / "marker"));
  EXPECT_EQ(entries(folder.path()), 1u);
}

TEST(AtomicFolder, ReplacesOnlyItsOwnOrEmptyFolders) {
  const TemporaryFolder folder;
  const fs::path target = folder / "run";
  ASSERT_TRUE(fs::create_directory(target));  // empty
  const auto write = [&](const char* name) -> Expected<void> {
    auto out = AtomicFolder::create(target, "marker");
    if (!out) return tl::unexpected(out.error());
    EXPECT_TRUE(write_file_atomically(out->path() / "marker", "1"));
    EXPECT_TRUE(write_file_atomically(out->path() / name, "1"));
    return out->commit();
  };
  ASSERT_TRUE(write("first"));
  ASSERT_TRUE(write("second"));
  EXPECT_FALSE(fs::exists(target / "first"));
  EXPECT_TRUE(fs::exists(target / "second"));
  EXPECT_EQ(entries(folder.path()), 1u);  // the old one is gone

  ASSERT_TRUE(fs::remove(target / "marker"));  // now it is somebody else's
  const auto refused = write("third");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::invalid_argument);
  EXPECT_NE(refused.error().to_string().find("marker"), std::string::npos);
  EXPECT_TRUE(fs::exists(target / "second"));

  ASSERT_TRUE(write_file_atomically(folder / "plain", "x"));
  for (const fs::path& wrong :
       {folder / "plain", folder / "plain" / "below", fs::path("/"), fs::path()}) {
    const auto out = AtomicFolder::create(wrong, "marker");
    ASSERT_FALSE(out) << wrong;
    EXPECT_EQ(out.error().code, ErrorCode::invalid_argument) << wrong;
  }
}

TEST(AtomicFolder, AFolderThatBecameForeignMeanwhileIsNotReplaced) {
  const TemporaryFolder folder;
  const fs::path target = folder / "run";
  auto out = AtomicFolder::create(target, "marker");
  ASSERT_TRUE(out);
  ASSERT_TRUE(write_file_atomically(target / "somebody's", "x"));
  EXPECT_FALSE(out->commit());
  EXPECT_TRUE(fs::exists(target / "somebody's"));
}

TEST(AtomicFolder, KilledWriterLeavesTheOldFolderAndTheNextOneCleansUp) {
  const TemporaryFolder folder;
  const fs::path target = folder / "run";
  const std::string content(400'000, 'x');
  const auto write = [&] {
    auto out = AtomicFolder::create(target, "marker");
    if (!out) return;
    for (int i = 0; i < 5; ++i) {
      (void)write_file_atomically(out->path() / std::to_string(i), content);
    }
    (void)write_file_atomically(out->path() / "marker", content);
    (void)out->commit();
  };
  for (const int milliseconds : {4, 11, 23, 47, 95}) {
    kill_in_the_middle(write, milliseconds);
    if (!fs::exists(target)) continue;
    for (const char* name : {"0", "1", "2", "3", "4", "marker"}) {
      const auto bytes = read_file_bytes(target / name);
      ASSERT_TRUE(bytes) << bytes.error().to_string();
      EXPECT_EQ(bytes->size(), content.size());
    }
  }
  write();
  EXPECT_EQ(entries(folder.path()), 1u);
  EXPECT_EQ(entries(target), 6u);
}

}  // namespace
}  // namespace corvid
