#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace corvid {

/// Text for the inside of an HTML or SVG element or a quoted attribute; bytes that are no valid
/// UTF-8 or no character of XML become '?'.
[[nodiscard]] std::string html_escape(std::string_view text);
/// Up to `digits` significant digits, thousands apart; an en dash for what is not finite.
[[nodiscard]] std::string format_number(double value, int digits = 3);
[[nodiscard]] std::string base64(std::string_view bytes);

/// One line or cloud of a plot. A point that is not finite breaks the line.
struct PlotSeries {
  enum class Style { line, dashed, points };
  std::string name;
  std::vector<Eigen::Vector2d> points;
  int colour = 0;  ///< slot 0 to 3 of the page's palette
  Style style = Style::line;
};

/// A stretch of the x axis, over the plot's whole height.
struct PlotBand {
  double begin = 0, end = 0;
  std::string css_class;
  std::string title;  ///< shown when pointed at
};

/// A picture behind the series; corners in plot coordinates.
struct PlotPicture {
  std::string png;
  Eigen::Vector2d low = Eigen::Vector2d::Zero(), high = Eigen::Vector2d::Zero();
};

struct PlotOptions {
  std::string title, x_label, y_label;
  int width_px = 720, height_px = 240;
  bool equal_axes = false;  ///< one scale for x and y; the height follows from the data
  bool y_axis = true;       ///< false: a strip without values (bands only)
  bool zero_based = true;   ///< y starts at 0 if all values are positive
  std::optional<Eigen::Vector2d> x_range;  ///< from, to; otherwise what the data spans
};

/// A self-contained inline <svg> in the page's colours (CSS variables of report.cpp). Long lines
/// are thinned to what the pixels can show. Series without points are left out; with nothing to
/// draw the plot says so.
[[nodiscard]] std::string svg_plot(const PlotOptions& options, std::span<const PlotSeries> series,
                                   std::span<const PlotBand> bands = {},
                                   const PlotPicture* picture = nullptr);

}  // namespace corvid
