#include "apps/report_page.h"

#include <fmt/format.h>

#include <cmath>

#include "apps/plot.h"
#include "io/image_encode.h"

namespace corvid {
namespace {

std::string figure(std::string_view caption, std::string_view note, std::string_view type,
                   const std::string& bytes) {
  return fmt::format(
      "<figure><figcaption>{} <span>{}</span></figcaption>"
      "<img alt=\"{}\" src=\"data:image/{};base64,{}\"/></figure>\n",
      html_escape(caption), html_escape(note), html_escape(caption), type, base64(bytes));
}

}  // namespace

std::string html_section(std::string_view id, std::string_view title_text, std::string_view html) {
  return fmt::format("<section id=\"{}\">\n<h2>{}</h2>\n{}</section>\n", html_escape(id),
                     html_escape(title_text), html);
}

std::string html_table(const std::vector<TableColumn>& columns,
                       const std::vector<std::vector<TableCell>>& rows) {
  std::string out = "<div class=\"scroll\"><table><thead><tr>";
  for (const TableColumn& c : columns) {
    out += fmt::format("<th{}>{}</th>", c.number ? " class=\"n\"" : "", html_escape(c.text));
  }
  out += "</tr></thead><tbody>\n";
  for (const auto& row : rows) {
    out += "<tr>";
    for (std::size_t i = 0; i < row.size(); ++i) {
      const bool number = i < columns.size() && columns[i].number;
      out += fmt::format("<td class=\"{}\">{}</td>", number ? "n" : "wrap",
                         row[i].html.empty() ? html_escape(row[i].text) : row[i].html);
    }
    out += "</tr>\n";
  }
  return out + "</tbody></table></div>\n";
}

std::string html_tile(std::string_view name_text, std::string_view value_text,
                      std::string_view unit_text, std::string_view more_text) {
  return fmt::format(
      "<div class=\"tile\"><div class=\"name\">{}</div><div class=\"value\">{} "
      "<small>{}</small></div>"
      "<div class=\"more\">{}</div></div>\n",
      html_escape(name_text), html_escape(value_text), html_escape(unit_text),
      html_escape(more_text));
}

std::string html_list(const std::vector<std::string>& texts) {
  std::string out = "<ul>\n";
  for (const std::string& text : texts) out += fmt::format("<li>{}</li>\n", html_escape(text));
  return out + "</ul>\n";
}

std::string html_nothing(std::string_view text) {
  return fmt::format("<p class=\"nothing\">{}</p>\n", html_escape(text));
}

std::string html_picture(std::string_view caption_text, std::string_view note_text,
                         const MeshPicture& picture) {
  return figure(caption_text, note_text, "png", encode_png(picture.colour, picture.alpha));
}

std::string html_photo(std::string_view caption_text, std::string_view note_text,
                       const ColourImage& image) {
  return figure(caption_text, note_text, "jpeg", encode_jpeg(image, 85));
}

std::string format_bytes(double bytes) {
  const char* units[] = {"B", "kB", "MB", "GB", "TB"};
  std::size_t unit = 0;
  while (bytes >= 1000 && unit < 4) {
    bytes /= 1000;
    ++unit;
  }
  return unit == 0 ? fmt::format("{:.0f} B", bytes)
                   : fmt::format("{} {}", format_number(bytes), units[unit]);
}

std::string format_percent(double share) {
  if (!std::isfinite(share)) return "–";
  const double percent = share * 100;
  if (percent >= 99.95 && share < 1) return "99.9 %";
  return share == 1 || share == 0 ? fmt::format("{:.0f} %", percent)
                                  : fmt::format("{:.1f} %", percent);
}

std::string format_count(std::size_t value) {
  std::string text = std::to_string(value);
  for (std::size_t i = text.size(); i > 3;) {
    i -= 3;
    text.insert(i, "\u202f");
  }
  return text;
}

}  // namespace corvid
