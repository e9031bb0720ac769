#include "apps/plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>

namespace corvid {
namespace {

using Eigen::Vector2d;

/// Length of the UTF-8 sequence at the start of `text`, 0 if it is not a valid one.
std::size_t utf8_length(std::string_view text) {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned char lead = byte(0);
  const std::size_t n = lead < 0x80   ? 1
                        : lead < 0xC2 ? 0
                        : lead < 0xE0 ? 2
                        : lead < 0xF0 ? 3
                        : lead < 0xF5 ? 4
                                      : 0;
  if (n == 0 || n > text.size()) return 0;
  for (std::size_t i = 1; i < n; ++i) {
    if ((byte(i) & 0xC0) != 0x80) return 0;
  }
  if (n == 3 && ((lead == 0xE0 && byte(1) < 0xA0) || (lead == 0xED && byte(1) > 0x9F))) return 0;
  if (n == 4 && ((lead == 0xF0 && byte(1) < 0x90) || (lead == 0xF4 && byte(1) > 0x8F))) return 0;
  return n;
}

struct Range {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  void add(double v) {
    low = std::min(low, v);
    high = std::max(high, v);
  }
  [[nodiscard]] bool empty() const { return !(low <= high); }
  [[nodiscard]] double size() const { return high - low; }
};

/// Distance of ticks: 1, 2 or 5 times a power of ten, at most `count` of them.
double tick_step(double size, int count) {
  const double raw = size / std::max(count, 1);
  const double power = std::pow(10, std::floor(std::log10(raw)));
  for (const double m : {1.0, 2.0, 5.0}) {
    if (m * power >= raw) return m * power;
  }
  return 10 * power;
}

std::string tick_text(double value, double step) {
  if (std::abs(value) < step * 1e-6) value = 0;
  const int decimals = std::clamp(static_cast<int>(std::ceil(-std::log10(step) - 1e-9)), 0, 9);
  return fmt::format("{:.{}f}", value, decimals);
}

/// Where the data is drawn, in SVG units.
struct Frame {
  double left = 0, top = 0, width = 0, height = 0;
  Range x, y;
  [[nodiscard]] Vector2d operator()(const Vector2d& p) const {
    return {left + (p.x() - x.low) / x.size() * width, top + (y.high - p.y()) / y.size() * height};
  }
};

/// Drops points that lie closer than half a unit to the last one drawn, and of a dense time series
/// keeps each column's extremes, so that no spike is lost.
std::vector<Vector2d> thin(const std::vector<Vector2d>& line, double width) {
  const bool monotonic = std::is_sorted(line.begin(), line.end(),
                                        [](const auto& a, const auto& b) { return a.x() < b.x(); });
  std::vector<Vector2d> out;
  if (monotonic && static_cast<double>(line.size()) > 4 * width) {
    for (std::size_t i = 0; i < line.size();) {
      const double column = std::floor(line[i].x());
      std::size_t low = i, high = i, j = i;
      for (; j < line.size() && std::floor(line[j].x()) == column; ++j) {
        if (line[j].y() < line[low].y()) low = j;
        if (line[j].y() > line[high].y()) high = j;
      }
      out.push_back(line[std::min(low, high)]);
      if (low != high) out.push_back(line[std::max(low, high)]);
      i = j;
    }
    return out;
  }
  for (std::size_t i = 0; i < line.size(); ++i) {
    if (out.empty() || i + 1 == line.size() || (line[i] - out.back()).norm() >= 0.5) {
      out.push_back(line[i]);
    }
  }
  return out;
}

void draw_line(std::string& svg, const PlotSeries& series, const Frame& frame) {
  const char* style = series.style == PlotSeries::Style::dashed ? " dashed" : "";
  std::vector<Vector2d> run;
  const auto flush = [&] {
    if (run.size() == 1) {
      fmt::format_to(std::back_inserter(svg),
                     "<circle class=\"f{}\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"2\"/>\n", series.colour,
                     run[0].x(), run[0].y());
    } else if (!run.empty()) {
      fmt::format_to(std::back_inserter(svg), "<polyline class=\"l{}{}\" points=\"", series.colour,
                     style);
      for (const Vector2d& p : thin(run, frame.width)) {
        fmt::format_to(std::back_inserter(svg), "{:.1f},{:.1f} ", p.x(), p.y());
      }
      svg += "\"/>\n";
    }
    run.clear();
  };
  for (const Vector2d& p : series.points) {
    if (p.allFinite()) {
      run.push_back(frame(p));
    } else {
      flush();
    }
  }
  flush();
}

void draw_points(std::string& svg, const PlotSeries& series, const Frame& frame) {
  Vector2d last(-1e9, -1e9);
  for (const Vector2d& value : series.points) {
    if (!value.allFinite()) continue;
    const Vector2d p = frame(value);
    if ((p - last).norm() < 1) continue;
    last = p;
    fmt::format_to(std::back_inserter(svg),
                   "<circle class=\"f{}\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"2.2\"/>\n", series.colour,
                   p.x(), p.y());
  }
}

void draw_axes(std::string& svg, const PlotOptions& options, const Frame& frame) {
  const auto out = std::back_inserter(svg);
  const double bottom = frame.top + frame.height, right = frame.left + frame.width;
  const double x_step = tick_step(frame.x.size(), std::max(2, static_cast<int>(frame.width / 80)));
  for (double k = std::ceil(frame.x.low / x_step - 1e-9);
       k * x_step <= frame.x.high * (1 + 1e-12) + x_step * 1e-9; ++k) {
    const double x = frame({k * x_step, 0}).x();
    fmt::format_to(
        out, "<line class=\"grid\" x1=\"{0:.1f}\" x2=\"{0:.1f}\" y1=\"{1:.1f}\" y2=\"{2:.1f}\"/>",
        x, frame.top, bottom);
    fmt::format_to(
        out, "<text class=\"tick\" x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\">{}</text>\n", x,
        bottom + 15, tick_text(k * x_step, x_step));
  }
  if (options.y_axis) {
    const double y_step =
        tick_step(frame.y.size(), std::max(2, static_cast<int>(frame.height / 34)));
    for (double k = std::ceil(frame.y.low / y_step - 1e-9);
         k * y_step <= frame.y.high + y_step * 1e-9; ++k) {
      const double y = frame({0, k * y_step}).y();
      fmt::format_to(
          out, "<line class=\"grid\" x1=\"{0:.1f}\" x2=\"{1:.1f}\" y1=\"{2:.1f}\" y2=\"{2:.1f}\"/>",
          frame.left, right, y);
      fmt::format_to(
          out, "<text class=\"tick\" x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"end\">{}</text>\n",
          frame.left - 6, y + 4, tick_text(k * y_step, y_step));
    }
  }
  fmt::format_to(
      out, "<line class=\"axis\" x1=\"{0:.1f}\" x2=\"{1:.1f}\" y1=\"{2:.1f}\" y2=\"{2:.1f}\"/>\n",
      frame.left, right, bottom);
  fmt::format_to(out,
                 "<text class=\"label\" x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"end\">{}</text>\n",
                 right, bottom + 31, html_escape(options.x_label));
  if (options.y_axis) {
    fmt::format_to(out, "<text class=\"label\" x=\"{:.1f}\" y=\"{:.1f}\">{}</text>\n", 4.0,
                   frame.top - 8, html_escape(options.y_label));
  }
}

/// Names of the series, beside the title line; one series needs none.
void draw_legend(std::string& svg, std::span<const PlotSeries> series, double right) {
  std::vector<const PlotSeries*> shown;
  for (const PlotSeries& s : series) {
    if (!s.points.empty() && !s.name.empty()) shown.push_back(&s);
  }
  if (shown.size() < 2) return;
  double x = right;
  for (std::size_t i = shown.size(); i-- > 0;) {
    const PlotSeries& s = *shown[i];
    x -= 7.0 * static_cast<double>(s.name.size()) + 12;
    fmt::format_to(std::back_inserter(svg),
                   "<text class=\"legend\" x=\"{:.1f}\" y=\"14\">{}</text>", x,
                   html_escape(s.name));
    if (s.style == PlotSeries::Style::points) {
      fmt::format_to(std::back_inserter(svg),
                     "<circle class=\"f{}\" cx=\"{:.1f}\" cy=\"10\" r=\"3\"/>\n", s.colour, x - 10);
    } else {
      fmt::format_to(std::back_inserter(svg),
                     "<line class=\"l{}{}\" x1=\"{:.1f}\" x2=\"{:.1f}\" y1=\"10\" y2=\"10\"/>\n",
                     s.colour, s.style == PlotSeries::Style::dashed ? " dashed" : "", x - 20,
                     x - 5);
    }
    x -= 30;
  }
}

/// Makes room around the data and never a range of zero.
void pad(Range& range, double share) {
  if (range.size() < 1e-12 * std::max(1.0, std::abs(range.high))) {
    const double half = std::max(std::abs(range.high) * 0.05, 0.5);
    range.low -= half;
    range.high += half;
    return;
  }
  const double extra = range.size() * share;
  range.low -= extra;
  range.high += extra;
}

}  // namespace

std::string html_escape(std::string_view text) {
  std::string out;
  while (!text.empty()) {
    const std::size_t n = utf8_length(text);
    const auto c = static_cast<unsigned char>(text[0]);
    if (n == 0 || (n == 1 && c < 0x20 && c != '\n' && c != '\t') || c == 0x7F) {
      out += '?';
      text.remove_prefix(1);
      continue;
    }
    if (c == '&') {
      out += "&amp;";
    } else if (c == '<') {
      out += "&lt;";
    } else if (c == '>') {
      out += "&gt;";
    } else if (c == '"') {
      out += "&quot;";
    } else if (c == '\'') {
      out += "&#39;";
    } else {
      out += text.substr(0, n);
    }
    text.remove_prefix(n);
  }
  return out;
}

std::string format_number(double value, int digits) {
  if (!std::isfinite(value)) return "–";
  const double size = std::abs(value);
  if (size > 0 && (size < 1e-4 || size >= 1e15)) return fmt::format("{:.{}e}", value, digits - 1);
  int decimals = digits - 1;
  if (size > 0) decimals -= static_cast<int>(std::floor(std::log10(size)));
  std::string text = fmt::format("{:.{}f}", value, std::max(decimals, 0));
  const std::size_t point = std::min(text.find('.'), text.size());
  const std::size_t first = text[0] == '-' ? 1 : 0;
  for (std::size_t i = point; i > first + 3;) {
    i -= 3;
    text.insert(i, "\u202f");  // narrow no-break space
  }
  return text;
}

std::string base64(std::string_view bytes) {
  constexpr char kAlphabet[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t word = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      word = word << 8 | (k < n ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    }
    for (std::size_t k = 0; k < 4; ++k) {
      out += k <= n ? kAlphabet[word >> (18 - 6 * k) & 63] : '=';
    }
  }
  return out;
}

std::string svg_plot(const PlotOptions& options, std::span<const PlotSeries> series,
                     std::span<const PlotBand> bands, const PlotPicture* picture) {
  Frame frame;
  for (const PlotSeries& s : series) {
    for (const Vector2d& p : s.points) {
      if (!p.allFinite()) continue;
      frame.x.add(p.x());
      frame.y.add(p.y());
    }
  }
  for (const PlotBand& band : bands) {
    frame.x.add(band.begin);
    frame.x.add(band.end);
  }
  if (picture) {
    for (const Vector2d& p : {picture->low, picture->high}) {
      frame.x.add(p.x());
      frame.y.add(p.y());
    }
  }
  std::string svg;
  const auto out = std::back_inserter(svg);
  const std::string heading = options.title.empty() ? ""
                                                    : fmt::format("<figcaption>{}</figcaption>",
                                                                  html_escape(options.title));
  if (frame.x.empty()) {
    return fmt::format(
        "<figure class=\"plot\">{}<p class=\"nothing\">Nothing to draw.</p></figure>\n", heading);
  }
  if (frame.y.empty()) frame.y = {0, 1};
  frame.left = options.y_axis ? 52 : 12;
  frame.top = options.y_axis ? 34 : 6;
  frame.width = options.width_px - frame.left - 14;
  double height = options.height_px;
  if (options.equal_axes) {
    if (!picture) {
      pad(frame.x, 0.04);
      pad(frame.y, 0.04);
    }
    const double plot_height =
        std::clamp(frame.width * frame.y.size() / frame.x.size(), 150.0, 520.0);
    // One scale for both: the axis that has too little data gets more room around it.
    const double scale = std::max(frame.x.size() / frame.width, frame.y.size() / plot_height);
    const double more_x = (frame.width * scale - frame.x.size()) / 2;
    const double more_y = (plot_height * scale - frame.y.size()) / 2;
    frame.x.low -= more_x;
    frame.x.high += more_x;
    frame.y.low -= more_y;
    frame.y.high += more_y;
    height = plot_height + frame.top + 40;
  } else {
    if (options.x_range) frame.x = {options.x_range->x(), options.x_range->y()};
    if (frame.x.size() <= 0) pad(frame.x, 0);
    if (options.zero_based && frame.y.low >= 0) frame.y.low = 0;
    if (options.zero_based && frame.y.low == 0) {
      frame.y.high = frame.y.high > 0 ? frame.y.high * 1.05 : 1;
    } else {
      pad(frame.y, 0.05);
    }
  }
  frame.height = height - frame.top - 40;

  fmt::format_to(
      out,
      "<figure class=\"plot{}\">{}<svg viewBox=\"0 0 {} {:.0f}\" role=\"img\" aria-label=\"{}\">\n",
      picture ? " pictured" : "", heading, options.width_px, height, html_escape(options.title));
  if (picture) {
    fmt::format_to(
        out,
        "<rect class=\"ground\" x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\"/>\n",
        frame.left, frame.top, frame.width, frame.height);
    const Vector2d a = frame({picture->low.x(), picture->high.y()});
    const Vector2d b = frame({picture->high.x(), picture->low.y()});
    fmt::format_to(out,
                   "<image x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" "
                   "preserveAspectRatio=\"none\" href=\"data:image/png;base64,{}\"/>\n",
                   a.x(), a.y(), b.x() - a.x(), b.y() - a.y(), base64(picture->png));
  }
  for (const PlotBand& band : bands) {
    const double x0 = frame({band.begin, 0}).x(), x1 = frame({band.end, 0}).x();
    fmt::format_to(
        out,
        "<rect class=\"{}\" x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\">"
        "<title>{}</title></rect>\n",
        html_escape(band.css_class), x0, frame.top, std::max(x1 - x0, 0.8), frame.height,
        html_escape(band.title));
  }
  draw_axes(svg, options, frame);
  for (const PlotSeries& s : series) {
    s.style == PlotSeries::Style::points ? draw_points(svg, s, frame) : draw_line(svg, s, frame);
  }
  draw_legend(svg, series, frame.left + frame.width);
  svg += "</svg></figure>\n";
  return svg;
}

}  // namespace corvid
