#include "io/io_fault.h"

#include <fmt/format.h>

#include <cerrno>
#include <string>
#include <system_error>
#include <utility>

namespace corvid {

tl::unexpected<Error> io_fault(const char* what, const std::filesystem::path& path, int code) {
  std::string hint;
  if (code == ENOSPC || code == EDQUOT) hint = "free some space on that disk";
  if (code == EACCES || code == EPERM || code == EROFS) hint = "choose a folder you may write to";
  return fail(code == ENOENT ? ErrorCode::not_found : ErrorCode::io,
              fmt::format("{}: {}", what, std::system_category().message(code)), path.string(),
              std::move(hint));
}

}  // namespace corvid
