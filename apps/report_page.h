#pragma once

#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

#include "apps/render_mesh.h"

namespace corvid {

// Small pieces of the report's page. What is called text is escaped here; what is called html is
// taken as it is.

struct TableColumn {
  std::string text;
  bool number = false;  ///< set to the right
};
struct TableCell {
  std::string text;
  std::string html;  ///< if not empty, instead of the text
};

[[nodiscard]] std::string html_section(std::string_view id, std::string_view title_text,
                                       std::string_view html);
[[nodiscard]] std::string html_table(const std::vector<TableColumn>& columns,
                                     const std::vector<std::vector<TableCell>>& rows);
[[nodiscard]] std::string html_tile(std::string_view name_text, std::string_view value_text,
                                    std::string_view unit_text, std::string_view more_text);
[[nodiscard]] std::string html_list(const std::vector<std::string>& texts);
[[nodiscard]] std::string html_nothing(std::string_view text);
/// A picture inside the page.
[[nodiscard]] std::string html_picture(std::string_view caption_text, std::string_view note_text,
                                       const MeshPicture& picture);
[[nodiscard]] std::string html_photo(std::string_view caption_text, std::string_view note_text,
                                     const ColourImage& image);
/// "12.3 MB" and the like.
[[nodiscard]] std::string format_bytes(double bytes);
/// A share as percent, never rounded up to 100.
[[nodiscard]] std::string format_percent(double share);
/// Whole number with its thousands apart.
[[nodiscard]] std::string format_count(std::size_t value);

}  // namespace corvid
