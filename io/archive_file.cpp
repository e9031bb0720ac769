#include "io/archive_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <string>
#include <utility>

#include "io/io_fault.h"

namespace corvid {
namespace fs = std::filesystem;
namespace {

/// A file without a name; where the file system cannot make one, a file that loses its name.
int open_unnamed(const fs::path& folder) {
  const int fd = ::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (fd >= 0 || (errno != EOPNOTSUPP && errno != EISDIR && errno != EINVAL)) return fd;
  std::string name = (folder / ".corvid-archive-XXXXXX").string();
  const int named = ::mkostemp(name.data(), O_CLOEXEC);
  if (named >= 0) ::unlink(name.c_str());
  return named;
}

}  // namespace

Expected<std::shared_ptr<ArchiveFile>> ArchiveFile::create(const fs::path& folder) {
  const int fd = open_unnamed(folder);
  if (fd < 0) return io_fault("no archive can be made there", folder, errno);
  return std::shared_ptr<ArchiveFile>(new ArchiveFile(fd, folder));
}

ArchiveFile::ArchiveFile(int fd, fs::path folder) : fd_(fd), folder_(std::move(folder)) {}

ArchiveFile::~ArchiveFile() { ::close(fd_); }

Expected<Archive::Slot> ArchiveFile::put(std::span<const std::byte> bytes) {
  Slot slot{0, bytes.size()};
  {
    const std::lock_guard lock(mutex_);
    auto& free = free_[slot.size];
    if (free.empty()) {
      slot.offset = std::exchange(end_, end_ + slot.size);
    } else {
      slot.offset = free.back();
      free.pop_back();
    }
  }
  for (std::size_t done = 0; done < bytes.size();) {
    const ssize_t n = ::pwrite(fd_, bytes.data() + done, bytes.size() - done,
                               static_cast<off_t>(slot.offset + done));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) {
      const int code = errno;
      drop(slot);
      return io_fault("the archive cannot be written", folder_, code);
    }
    done += static_cast<std::size_t>(n);
  }
  start_writing(slot.size);
  return slot;
}

/// What lies in the page cache only is on its way to the disk soon: else whoever syncs a file of
/// the same file system at the end of a flight waits for all of it.
void ArchiveFile::start_writing(std::size_t more_bytes) {
  constexpr std::size_t kPiece = 4UL << 20;
  if (cached_bytes_.fetch_add(more_bytes) + more_bytes < kPiece) return;
  cached_bytes_ = 0;
  (void)::sync_file_range(fd_, 0, 0, SYNC_FILE_RANGE_WRITE);  // to the end; a hint, no more
}

Expected<std::vector<std::byte>> ArchiveFile::get(const Slot& slot) const {
  std::vector<std::byte> bytes(slot.size);
  for (std::size_t done = 0; done < bytes.size();) {
    const ssize_t n = ::pread(fd_, bytes.data() + done, bytes.size() - done,
                              static_cast<off_t>(slot.offset + done));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return io_fault("the archive cannot be read", folder_, n < 0 ? errno : EIO);
    done += static_cast<std::size_t>(n);
  }
  return bytes;
}

void ArchiveFile::drop(const Slot& slot) {
  const std::lock_guard lock(mutex_);
  free_[slot.size].push_back(slot.offset);
}

std::uint64_t ArchiveFile::size_bytes() const {
  const std::lock_guard lock(mutex_);
  return end_;
}

}  // namespace corvid
