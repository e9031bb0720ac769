#include "io/camera/libcamera_manager.h"

#include <fmt/format.h>
#include <libcamera/camera.h>
#include <libcamera/camera_manager.h>
#include <libcamera/logging.h>
#include <sys/sysmacros.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <mutex>
#include <ostream>
#include <streambuf>
#include <string_view>

#include "core/log.h"

namespace corvid {
namespace {

/// Hands each text that is written on to the log. libcamera writes one message at a time, from
/// several threads.
class LogBuffer final : public std::streambuf {
 protected:
  std::streamsize xsputn(const char* text, std::streamsize size) override {
    std::string_view message(text, static_cast<std::size_t>(size));
    while (message.ends_with('\n')) message.remove_suffix(1);
    log().debug("{}", message);
    return size;
  }
  int overflow(int c) override { return c == traits_type::eof() ? 0 : c; }
};

void route_log() {
  static std::once_flag once;
  std::call_once(once, [] {
    if (std::getenv("LIBCAMERA_LOG_FILE") != nullptr) return;
    // Never destroyed: libcamera logs to it until the process ends.
    static auto* stream = new std::ostream(new LogBuffer);
    libcamera::logSetStream(stream);
  });
}

/// Never destroyed: what holds the manager may be.
struct Shared {
  std::mutex mutex;
  std::unique_ptr<libcamera::CameraManager> manager;
  int holders = 0;
};

Shared& shared() {
  static auto* instance = new Shared;
  return *instance;
}

}  // namespace

Expected<std::shared_ptr<libcamera::CameraManager>> hold_camera_manager() {
  const std::scoped_lock lock(shared().mutex);
  if (!shared().manager) {
    route_log();
    auto manager = std::make_unique<libcamera::CameraManager>();
    if (const int status = manager->start(); status < 0) {
      return fail(ErrorCode::io,
                  fmt::format("libcamera does not start: {}", std::strerror(-status)), "libcamera",
                  "is udev there, and may this user open /dev/media*?");
    }
    shared().manager = std::move(manager);
  }
  ++shared().holders;
  // The count is kept under the lock, because a second manager must not begin before the first has
  // ended.
  return std::shared_ptr<libcamera::CameraManager>(
      shared().manager.get(), [](libcamera::CameraManager*) {
        const std::scoped_lock release_lock(shared().mutex);
        if (--shared().holders == 0) shared().manager.reset();
      });
}

std::vector<std::filesystem::path> device_folders(libcamera::CameraManager& manager,
                                                  const libcamera::Camera& camera) {
  std::vector<std::filesystem::path> folders;
  std::error_code error;
  std::filesystem::directory_iterator at("/sys/class/video4linux", error);
  for (; !error && at != std::filesystem::directory_iterator(); at.increment(error)) {
    unsigned major_number = 0, minor_number = 0;
    char colon = 0;
    std::ifstream file(at->path() / "dev");
    if (!(file >> major_number >> colon >> minor_number)) continue;
    if (manager.get(makedev(major_number, minor_number)).get() != &camera) continue;
    folders.emplace_back(fmt::format("/sys/dev/char/{}:{}", major_number, minor_number));
  }
  std::sort(folders.begin(), folders.end());
  return folders;
}

bool is_plugged_in(const std::vector<std::filesystem::path>& folders) {
  return std::all_of(folders.begin(), folders.end(), [](const std::filesystem::path& folder) {
    std::error_code error;
    return std::filesystem::exists(folder, error);
  });
}

}  // namespace corvid
