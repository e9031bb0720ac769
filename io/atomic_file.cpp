#include "io/atomic_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <system_error>
#include <utility>
#include <vector>

#include "io/descriptor.h"
#include "io/io_fault.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

Expected<void> sync_path(const fs::path& path) {
  const Descriptor d(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (d.get() < 0) return io_fault("cannot be opened to sync it", path, errno);
  // Some file systems cannot sync a directory (EINVAL); then there is nothing more to be done.
  if (::fsync(d.get()) != 0 && errno != EINVAL) return io_fault("cannot be synced", path, errno);
  return {};
}

fs::path parent_of(const fs::path& path) {
  return path.has_parent_path() ? path.parent_path() : fs::path(".");
}

Expected<void> make_parent(const fs::path& path) {
  std::error_code ec;
  fs::create_directories(parent_of(path), ec);
  if (ec == std::errc::not_a_directory || ec == std::errc::file_exists) {
    return fail(ErrorCode::invalid_argument, "is or lies below a file, where a folder must be",
                parent_of(path).string(), "choose another output folder");
  }
  if (ec) return io_fault("folder cannot be made", parent_of(path), ec.value());
  return {};
}

/// The path that a chain of symbolic links ends at, there or not; refuses what is no file.
Expected<fs::path> file_behind(fs::path path) {
  constexpr int kMaxLinks = 40;  // as the kernel
  std::error_code ec;
  const fs::file_status status = fs::status(path, ec);
  if (fs::exists(status) && !fs::is_regular_file(status)) {
    return fail(ErrorCode::invalid_argument,
                fs::is_directory(status) ? "is a folder" : "is not a regular file", path.string(),
                "name a file to write");
  }
  for (int i = 0; fs::is_symlink(path, ec); ++i) {
    const fs::path target = fs::read_symlink(path, ec);
    if (ec || i == kMaxLinks)
      return io_fault("link cannot be followed", path, ec ? ec.value() : ELOOP);
    path = parent_of(path) / target;
  }
  return path;
}

/// The file that writing to `name` replaces, in a folder that is there.
Expected<fs::path> target_of(const fs::path& name) {
  auto path = file_behind(name);
  if (!path) return path;
  const fs::path last = path->filename();
  if (last.empty() || last == "." || last == "..") {
    return fail(ErrorCode::invalid_argument,
                name.empty() ? "the file's name is empty" : "is not a file name", name.string());
  }
  if (auto ok = make_parent(*path); !ok) return tl::unexpected(ok.error());
  return path;
}

/// A new file beside `path`; its name goes to `name`.
Expected<int> create_beside(const fs::path& path, std::string& name) {
  // mkostemp picks a name that no other writer has, in the same folder: rename stays atomic.
  name = path.string() + ".partial-XXXXXX";
  const int fd = ::mkostemp(name.data(), O_CLOEXEC);
  if (fd < 0) return io_fault("cannot be created", path, errno);
  return fd;
}

/// Opens and locks a folder; -1 if another live process holds it or it cannot be opened.
int lock_folder(const fs::path& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return -1;
  if (::flock(fd, LOCK_EX | LOCK_NB) == 0) return fd;
  ::close(fd);
  return -1;
}

std::string partial_prefix(const fs::path& final_path) {
  return final_path.filename().string() + ".partial-";
}

/// Removes what killed processes left; a live process holds the lock of its own.
void remove_dead_partials(const fs::path& final_path) {
  std::error_code ec;
  const std::string prefix = partial_prefix(final_path);
  std::vector<fs::path> dead;
  for (fs::directory_iterator it(parent_of(final_path), ec), end; !ec && it != end;
       it.increment(ec)) {
    const std::string name = it->path().filename().string();
    const std::string pid = name.starts_with(prefix) ? name.substr(prefix.size()) : "";
    if (!pid.empty() && pid.find_first_not_of("0123456789") == std::string::npos) {
      dead.push_back(it->path());
    }
  }
  for (const fs::path& path : dead) {
    const Descriptor lock{lock_folder(path)};
    if (lock.get() >= 0) fs::remove_all(path, ec);
  }
}

Expected<void> check_replaceable(const fs::path& final_path, std::string_view marker) {
  std::error_code ec;
  const fs::file_status status = fs::symlink_status(final_path, ec);
  if (status.type() == fs::file_type::not_found) return {};
  if (status.type() == fs::file_type::none) {
    return io_fault("cannot be looked at", final_path, ec.value());
  }
  if (status.type() != fs::file_type::directory) {
    return fail(ErrorCode::invalid_argument, "exists and is not a folder", final_path.string(),
                "choose another output folder");
  }
  const bool empty = fs::is_empty(final_path, ec);
  if (ec) return io_fault("cannot be read", final_path, ec.value());
  if (!empty && !fs::is_regular_file(final_path / marker, ec)) {
    return fail(ErrorCode::invalid_argument,
                fmt::format("exists and was not written by corvid (it holds no {})", marker),
                final_path.string(), "choose another output folder, or remove this one yourself");
  }
  return {};
}

}  // namespace

Expected<std::string> read_file_bytes(const fs::path& path) {
  const Descriptor d{::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK)};
  if (d.get() < 0) return io_fault("cannot be opened", path, errno);
  struct stat status {};
  if (::fstat(d.get(), &status) != 0) return io_fault("cannot be examined", path, errno);
  if (S_ISDIR(status.st_mode)) return io_fault("cannot be read", path, EISDIR);
  if (!S_ISREG(status.st_mode)) {  // a pipe would block, a device might never end
    return fail(ErrorCode::unsupported, "is not a regular file", path.string());
  }
  std::string bytes;
  std::error_code ec;
  const std::uintmax_t size = fs::file_size(path, ec);
  if (!ec) bytes.reserve(size);
  char buffer[65536];
  while (true) {
    const ssize_t n = ::read(d.get(), buffer, sizeof buffer);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return io_fault("cannot be read", path, errno);
    if (n == 0) return bytes;
    bytes.append(buffer, static_cast<std::size_t>(n));
  }
}

Expected<void> write_file_atomically(const fs::path& name, std::string_view bytes) {
  const auto target = target_of(name);
  if (!target) return tl::unexpected(target.error());
  const fs::path& path = *target;
  std::string temporary;
  const auto created = create_beside(path, temporary);
  if (!created) return tl::unexpected(created.error());
  const Descriptor d{*created};
  Expected<void> ok;
  if (write_all(d.get(), bytes) < bytes.size()) ok = io_fault("cannot be written", path, errno);
  if (ok && ::fchmod(d.get(), 0644) != 0) ok = io_fault("mode cannot be set", path, errno);
  if (ok && ::fsync(d.get()) != 0) ok = io_fault("cannot be synced", path, errno);
  if (ok && ::rename(temporary.c_str(), path.c_str()) != 0) {
    ok = io_fault("cannot be renamed into place", path, errno);
  }
  if (!ok) {
    ::unlink(temporary.c_str());
    return ok;
  }
  return sync_path(parent_of(path));
}

Expected<void> check_file_writable(const fs::path& name) {
  const auto target = target_of(name);
  if (!target) return tl::unexpected(target.error());
  std::string probe;
  const auto created = create_beside(*target, probe);
  if (!created) return tl::unexpected(created.error());
  const Descriptor d{*created};
  ::unlink(probe.c_str());
  return {};
}

AtomicFolder::AtomicFolder(fs::path final_path, fs::path partial, std::string marker, int lock_fd)
    : final_(std::move(final_path)),
      partial_(std::move(partial)),
      marker_(std::move(marker)),
      lock_fd_(lock_fd) {}

AtomicFolder::AtomicFolder(AtomicFolder&& other) noexcept
    : final_(std::move(other.final_)),
      partial_(std::exchange(other.partial_, {})),
      marker_(std::move(other.marker_)),
      lock_fd_(std::exchange(other.lock_fd_, -1)) {}

AtomicFolder::~AtomicFolder() {
  if (!partial_.empty()) {
    std::error_code ec;
    fs::remove_all(partial_, ec);
  }
  if (lock_fd_ >= 0) ::close(lock_fd_);
}

Expected<AtomicFolder> AtomicFolder::create(const fs::path& final_path, std::string_view marker) {
  if (final_path.empty()) {
    return fail(ErrorCode::invalid_argument, "the output folder's name is empty", "",
                "name a folder to write");
  }
  std::error_code ec;
  fs::path target = fs::absolute(final_path, ec).lexically_normal();
  if (ec) return io_fault("is not a usable path", final_path, ec.value());
  if (!target.has_filename()) target = target.parent_path();  // "DIR/" means DIR
  if (target.filename().empty()) {
    return fail(ErrorCode::invalid_argument, "cannot be an output folder", final_path.string());
  }
  if (auto ok = check_replaceable(target, marker); !ok) return tl::unexpected(ok.error());
  if (auto ok = make_parent(target); !ok) return tl::unexpected(ok.error());
  remove_dead_partials(target);
  fs::path partial = target.parent_path() / (partial_prefix(target) + std::to_string(::getpid()));
  if (!fs::create_directory(partial, ec)) {
    return io_fault("cannot be made", partial, ec ? ec.value() : EEXIST);
  }
  const int lock = lock_folder(partial);
  return AtomicFolder(std::move(target), std::move(partial), std::string(marker), lock);
}

Expected<void> AtomicFolder::commit() {
  std::error_code ec;
  for (fs::recursive_directory_iterator it(partial_, ec), end; !ec && it != end; it.increment(ec)) {
    if (auto ok = sync_path(it->path()); !ok) return ok;
  }
  if (ec) return io_fault("cannot be read", partial_, ec.value());
  if (auto ok = sync_path(partial_); !ok) return ok;
  // The run may have taken hours: look again before anything is replaced.
  if (auto ok = check_replaceable(final_, marker_); !ok) return ok;

  if (!fs::exists(final_, ec)) {
    if (::rename(partial_.c_str(), final_.c_str()) != 0) {
      return io_fault("cannot be renamed into place", final_, errno);
    }
    partial_.clear();
    return sync_path(final_.parent_path());
  }
  if (::renameat2(AT_FDCWD, partial_.c_str(), AT_FDCWD, final_.c_str(), RENAME_EXCHANGE) == 0) {
    if (auto ok = sync_path(final_.parent_path()); !ok) return ok;
    fs::remove_all(partial_, ec);  // now the old folder
    partial_.clear();
    return {};
  }
  // File systems without an exchange: the old folder steps aside first.
  const fs::path aside = partial_.string() + ".old";
  if (::rename(final_.c_str(), aside.c_str()) != 0) {
    return io_fault("cannot be moved aside", final_, errno);
  }
  if (::rename(partial_.c_str(), final_.c_str()) != 0) {
    const int code = errno;
    ::rename(aside.c_str(), final_.c_str());
    return io_fault("cannot be renamed into place", final_, code);
  }
  partial_.clear();
  if (auto ok = sync_path(final_.parent_path()); !ok) return ok;
  fs::remove_all(aside, ec);
  return {};
}

}  // namespace corvid
