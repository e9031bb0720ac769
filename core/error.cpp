#include "corvid/error.h"

namespace corvid {

std::string Error::to_string() const {
  std::string text = where.empty() ? what : where + ": " + what;
  if (!hint.empty()) text += " (" + hint + ")";
  return text;
}

}  // namespace corvid
