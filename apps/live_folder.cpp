#include "apps/live_folder.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <iterator>
#include <system_error>
#include <utility>

#include "apps/run_folder.h"
#include "core/log.h"
#include "io/trajectory_file.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
using std::chrono::steady_clock;

constexpr std::chrono::milliseconds kLinesInterval(200);
constexpr std::chrono::seconds kSyncInterval(5), kMapInterval(30);

}  // namespace

Expected<std::unique_ptr<LiveFolder>> LiveFolder::create(const fs::path& run,
                                                         const std::string& about) {
  const fs::path final_path = fs::absolute(run).lexically_normal();
  std::error_code trouble;
  fs::create_directories(final_path.parent_path(), trouble);
  fs::path path;
  for (int n = 1; !trouble; ++n) {
    path = final_path;
    path += n == 1 ? std::string(".live") : fmt::format(".live-{}", n);
    if (fs::create_directory(path, trouble)) break;
  }
  const fs::path poses = path / "poses.txt";
  int fd = -1;
  if (!trouble) {
    fd = open(poses.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
    if (fd < 0) trouble = {errno, std::generic_category()};
  }
  if (trouble)
    return fail(ErrorCode::io, "cannot be made: " + trouble.message(), path.string(),
                "check the folder's permissions and the free space");
  return std::unique_ptr<LiveFolder>(new LiveFolder(
      path, fd,
      fmt::format("{}\n# {}\n# poses as they were published: time [s] tx ty tz qx qy qz qw "
                  "(T_world_camera)\n",
                  kAppended, about)));
}

LiveFolder::LiveFolder(fs::path path, int fd, std::string first_lines)
    : path_(std::move(path)),
      fd_(fd),
      lines_(std::move(first_lines)),
      thread_([this](const std::stop_token& stop) { run(stop); }) {}

LiveFolder::~LiveFolder() {
  if (thread_.joinable()) {
    thread_.request_stop();
    thread_.join();
  }
}

void LiveFolder::on_pose(const PoseEvent& event) {
  if (!event.T_world_camera) return;
  const std::lock_guard lock(mutex_);
  if (event.segment != segment_ || event.resets != resets_) {
    lines_ += fmt::format("# segment {}, resets {}\n", event.segment, event.resets);
    segment_ = event.segment;
    resets_ = event.resets;
  }
  append_tum_line(lines_, {event.time_ns, *event.T_world_camera});
}

void LiveFolder::hurry() {
  const std::lock_guard lock(mutex_);
  hurried_ = true;
  changed_.notify_all();
}

bool LiveFolder::empty() const {
  const std::lock_guard lock(mutex_);
  return segment_ < 0;
}

void LiveFolder::on_map(const std::shared_ptr<const MapSnapshot>& map) {
  const std::lock_guard lock(mutex_);
  map_ = map;
}

void LiveFolder::run(const std::stop_token& stop) {
  auto synced = steady_clock::now(), mapped = synced;
  while (true) {
    std::string lines;
    std::shared_ptr<const MapSnapshot> map;
    const bool last = stop.stop_requested();
    {
      std::unique_lock lock(mutex_);
      if (!last) changed_.wait_for(lock, stop, kLinesInterval, [this] { return hurried_; });
      lines = std::exchange(lines_, {});
      const bool hurried = std::exchange(hurried_, false);
      if (hurried || steady_clock::now() - mapped >= kMapInterval)
        map = std::exchange(map_, nullptr);
    }
    if (!lines.empty()) write_lines(lines);
    if (map) {
      write_map(*map);
      mapped = steady_clock::now();
    }
    if (steady_clock::now() - synced >= kSyncInterval) {
      fdatasync(fd_.get());
      synced = steady_clock::now();
    }
    if (last) return;
  }
}

void LiveFolder::write_lines(const std::string& lines) {
  const off_t before = lseek(fd_.get(), 0, SEEK_END);
  const std::size_t written = write_all(fd_.get(), lines);
  if (written == lines.size()) return;
  trouble(std::generic_category().message(errno));
  // A line that is torn goes again, so that those after it can be read.
  const std::size_t whole = written == 0 ? 0 : lines.rfind('\n', written - 1) + 1;
  [[maybe_unused]] const int cut = ftruncate(fd_.get(), before + static_cast<off_t>(whole));
}

void LiveFolder::write_map(const MapSnapshot& map) {
  if (auto written = write_sparse_map(map, path_); !written) trouble(written.error().to_string());
}

void LiveFolder::trouble(const std::string& what) {
  if (std::exchange(in_trouble_, true)) return;
  log().warn("{}: what there is in case of a crash is not complete: {}", path_.string(), what);
}

void LiveFolder::remove() {
  thread_.request_stop();
  thread_.join();
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

}  // namespace corvid
