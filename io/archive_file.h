#pragma once

#include <atomic>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "corvid/archive.h"

namespace corvid {

/// An archive in a file that has no name: its room on the disk is free again when the archive is
/// gone, also after a crash. Room that was dropped is given to the next of the same size.
class ArchiveFile : public Archive {
 public:
  /// @param folder  on whose disk it lies; must exist and be writable. (A folder in memory, as /tmp
  ///        may be, saves nothing.)
  /// Errors: not_found, io.
  [[nodiscard]] static Expected<std::shared_ptr<ArchiveFile>> create(
      const std::filesystem::path& folder);
  ~ArchiveFile() override;
  ArchiveFile(const ArchiveFile&) = delete;
  ArchiveFile& operator=(const ArchiveFile&) = delete;

  [[nodiscard]] Expected<Slot> put(std::span<const std::byte> bytes) override;
  [[nodiscard]] Expected<std::vector<std::byte>> get(const Slot& slot) const override;
  void drop(const Slot& slot) override;
  /// Of the file, dropped room included.
  [[nodiscard]] std::uint64_t size_bytes() const;

 private:
  ArchiveFile(int fd, std::filesystem::path folder);
  void start_writing(std::size_t more_bytes);

  int fd_;
  std::filesystem::path folder_;
  mutable std::mutex mutex_;
  std::atomic<std::size_t> cached_bytes_ = 0;  ///< put since writing was started last
  std::uint64_t end_ = 0;
  std::map<std::uint64_t, std::vector<std::uint64_t>> free_;  ///< offsets, by size
};

}  // namespace corvid
