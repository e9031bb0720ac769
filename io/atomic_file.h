#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "corvid/error.h"

namespace corvid {

/// The whole file as bytes. Errors: not_found, io.
[[nodiscard]] Expected<std::string> read_file_bytes(const std::filesystem::path& path);

/// Writes `bytes` under a temporary name beside `path`, syncs it to the disk and renames it: under
/// the final name there is the old file or the whole new one, never a part. Makes parent folders.
/// Writes through symbolic links: the file that they name is replaced, the links stay.
/// Errors: invalid_argument if `path` is a folder, device, pipe or socket, or lies below a file;
/// io.
[[nodiscard]] Expected<void> write_file_atomically(const std::filesystem::path& path,
                                                   std::string_view bytes);

/// Whether write_file_atomically() could write there now, found out before long work: the same path
/// is resolved, the same is refused, and a file beside it is made and removed again. Leaves the
/// file as it is; makes parent folders. Errors: as write_file_atomically.
[[nodiscard]] Expected<void> check_file_writable(const std::filesystem::path& path);

/// A folder that appears under its final name whole or not at all.
///
/// Files are written into `path()`, a sibling named "<final>.partial-<pid>"; `commit()` syncs them
/// and puts the folder in place by one rename (by one exchange where a folder is replaced). What
/// a killed process left behind under such a name is removed by the next one.
class AtomicFolder {
 public:
  /// @param marker  file name by which a folder is known to be ours: an existing `final` is
  /// replaced
  ///                only if it is an empty folder or holds this file.
  /// Errors: invalid_argument if `final` is empty, no folder, lies below a file or holds somebody
  /// else's things; io.
  [[nodiscard]] static Expected<AtomicFolder> create(const std::filesystem::path& final_path,
                                                     std::string_view marker);
  AtomicFolder(AtomicFolder&& other) noexcept;
  AtomicFolder& operator=(AtomicFolder&&) = delete;
  AtomicFolder(const AtomicFolder&) = delete;
  AtomicFolder& operator=(const AtomicFolder&) = delete;
  /// Removes the partial folder if it was not committed.
  ~AtomicFolder();

  /// Where to write; valid until commit().
  [[nodiscard]] const std::filesystem::path& path() const { return partial_; }
  [[nodiscard]] Expected<void> commit();

 private:
  AtomicFolder(std::filesystem::path final_path, std::filesystem::path partial, std::string marker,
               int lock_fd);
  std::filesystem::path final_, partial_;
  std::string marker_;
  int lock_fd_ = -1;  ///< open and locked while this process lives: tells live partials from dead
};

}  // namespace corvid
