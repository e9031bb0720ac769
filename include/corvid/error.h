#pragma once

#include <string>
#include <tl/expected.hpp>
#include <utility>

namespace corvid {

/// What kind of trouble the world made; decides the program's exit code.
enum class ErrorCode { invalid_argument, not_found, io, corrupt, unsupported, device, interrupted };

/// A failure of the world (device, file, corrupt stream): what happened, where, and what to do.
struct Error {
  ErrorCode code = ErrorCode::io;
  std::string what;   ///< "image cannot be decoded: the file ends after 1024 bytes"
  std::string where;  ///< path, path:line, or frame
  std::string hint;   ///< what the user can do; may be empty

  /// "where: what (hint)", without the parts that are empty.
  [[nodiscard]] std::string to_string() const;
};

template <class T>
using Expected = tl::expected<T, Error>;

/// For returning: `return fail(ErrorCode::io, "cannot be opened", path, "check the path");`
[[nodiscard]] inline tl::unexpected<Error> fail(ErrorCode code, std::string what,
                                                std::string where = {}, std::string hint = {}) {
  return tl::unexpected<Error>(Error{code, std::move(what), std::move(where), std::move(hint)});
}

}  // namespace corvid
