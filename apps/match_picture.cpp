#include "apps/match_picture.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include "core/check.h"

namespace corvid {
namespace {

constexpr int kMaxSide_px = 2340;  // of both images together; 2400 with the margins
constexpr double kMaxZoom = 2;     // small images gain room for the marks
constexpr int kMinWidth_px = 960;  // the legend needs it
constexpr double kWideImage = 2;   // width / height above which images lie one above the other
constexpr int kFractionBits = 4;   // OpenCV's fixed-point coordinates
constexpr Rgb8 kGround{22, 25, 29}, kInk{230, 232, 236}, kFaint{150, 156, 166}, kDark{10, 11, 13};
constexpr Rgb8 kAlarm{255, 120, 100};

// Of the matches' markers. The dots of the points without a match are the only filled marks.
constexpr Rgb8 kMarkerColours[] = {{255, 255, 255}, {70, 222, 255}, {40, 230, 120},
                                   {205, 255, 60},  {95, 150, 255}, {255, 160, 90},
                                   {255, 120, 235}, {120, 255, 220}};

cv::Scalar scalar(Rgb8 c) { return {double(c.r), double(c.g), double(c.b)}; }  // the canvas is RGB

using Stroke = std::vector<cv::Point2d>;  // unit square, y down
struct Shape {
  std::vector<Stroke> strokes;
  bool closed = false;
};

Stroke regular_polygon(int corners, double first_rad, double radius) {
  Stroke stroke;
  for (int i = 0; i < corners; ++i) {
    const double angle = first_rad + 2 * std::numbers::pi * i / corners;
    stroke.emplace_back(radius * std::cos(angle), radius * std::sin(angle));
  }
  return stroke;
}

// All look about equally large.
const std::vector<Shape>& marker_shapes() {
  constexpr double kUp = -std::numbers::pi / 2, kDiagonal = std::numbers::pi / 4;
  const auto bars = [](int count, double first_rad, double radius) {
    Shape shape;
    for (int i = 0; i < count; ++i) {
      shape.strokes.push_back(regular_polygon(2, first_rad + std::numbers::pi * i / count, radius));
    }
    return shape;
  };
  static const std::vector<Shape> shapes = {
      {{regular_polygon(20, 0, 0.95)}, true},
      {{regular_polygon(4, kDiagonal, 1.2)}, true},
      {{regular_polygon(4, 0, 1.2)}, true},
      {{regular_polygon(3, kUp, 1.25)}, true},
      {{regular_polygon(3, -kUp, 1.25)}, true},
      {{regular_polygon(5, kUp, 1.05)}, true},
      bars(2, 0, 1.1),
      bars(2, kDiagonal, 1.15),
      bars(3, kUp, 1.1),
  };
  return shapes;
}

struct Marker {
  std::size_t shape = 0;
  int width_px = 1;
  Rgb8 colour;
};

Marker random_marker(std::mt19937& random, int line_px) {
  Marker marker;
  marker.shape = random() % marker_shapes().size();
  marker.width_px = line_px * (1 + static_cast<int>(random() % 2));
  marker.colour = kMarkerColours[random() % std::size(kMarkerColours)];
  return marker;
}

cv::Point fixed(const cv::Point2d& p) {
  constexpr double kOne = 1 << kFractionBits;
  return {static_cast<int>(std::lround(p.x * kOne)), static_cast<int>(std::lround(p.y * kOne))};
}

// OpenCV's circles of few pixels are diamonds: here each pixel takes the share that is covered.
void draw_disc(cv::Mat canvas, const cv::Point2d& at, double radius_px, Rgb8 colour) {
  const cv::Rect all(0, 0, canvas.cols, canvas.rows);
  const int reach = static_cast<int>(std::ceil(radius_px)) + 1;
  const cv::Point centre(static_cast<int>(std::lround(at.x)), static_cast<int>(std::lround(at.y)));
  const cv::Rect box =
      cv::Rect(centre.x - reach, centre.y - reach, 2 * reach + 1, 2 * reach + 1) & all;
  for (int y = box.y; y < box.br().y; ++y) {
    for (int x = box.x; x < box.br().x; ++x) {
      const double share = std::clamp(radius_px + 0.5 - std::hypot(x - at.x, y - at.y), 0.0, 1.0);
      auto& pixel = canvas.at<cv::Vec3b>(y, x);
      const cv::Vec3b ink(colour.r, colour.g, colour.b);
      for (int k = 0; k < 3; ++k) {
        pixel[k] = cv::saturate_cast<std::uint8_t>(share * ink[k] + (1 - share) * pixel[k]);
      }
    }
  }
}

void draw_dot(cv::Mat canvas, const cv::Point2d& at, double radius_px, Rgb8 colour) {
  draw_disc(canvas, at, radius_px + 1, kDark);
  draw_disc(canvas, at, radius_px, colour);
}

void draw_marker(cv::Mat canvas, const cv::Point2d& at, double radius_px, const Marker& marker) {
  const Shape& shape = marker_shapes()[marker.shape];
  // A dark rim first: marks stand out from bright ground and from each other.
  for (const auto& [width, colour] :
       {std::pair{marker.width_px + 2, kDark}, {marker.width_px, marker.colour}}) {
    for (const Stroke& stroke : shape.strokes) {
      std::vector<cv::Point> points;
      for (const cv::Point2d& p : stroke) points.push_back(fixed(at + radius_px * p));
      cv::polylines(canvas, points, shape.closed, scalar(colour), width, cv::LINE_AA,
                    kFractionBits);
    }
  }
}

// Text of a given height of its capitals, its baseline's left end at `at`.
struct Font {
  double capital_px = 12;
  [[nodiscard]] double scale() const { return capital_px / 21.0; }  // Hershey capitals: 21 units
  [[nodiscard]] int line_px() const { return std::max(1, static_cast<int>(capital_px / 9)); }
  [[nodiscard]] int width_px(const std::string& text) const {
    int baseline = 0;
    return cv::getTextSize(text, kFace, scale(), line_px(), &baseline).width;
  }
  void draw(cv::Mat canvas, const cv::Point2d& at, const std::string& text, Rgb8 colour) const {
    cv::putText(canvas, text, at, kFace, scale(), scalar(colour), line_px(), cv::LINE_AA);
  }
  static constexpr int kFace = cv::FONT_HERSHEY_SIMPLEX;
};

// What fits into the width, the end of a longer text: file names differ there.
std::string fitting(const Font& font, const std::string& text, int width_px) {
  if (font.width_px(text) <= width_px) return text;
  std::string cut = text;
  while (!cut.empty() && font.width_px("..." + cut) > width_px) cut.erase(0, 1);
  return cut.empty() ? cut : "..." + cut;
}

// One image on the canvas.
struct Panel {
  cv::Rect place;
  double zoom = 1;
  [[nodiscard]] std::optional<cv::Point2d> on_canvas(const Eigen::Vector2d& pixel) const {
    const Eigen::Vector2d p = (pixel.array() + 0.5) * zoom - 0.5;
    const bool inside = p.x() > -1 && p.y() > -1 && p.x() < place.width && p.y() < place.height;
    if (!inside) return std::nullopt;  // NaN, too
    return cv::Point2d(place.x + p.x(), place.y + p.y());
  }
};

struct Layout {
  cv::Size canvas;
  Panel reference, target;
  cv::Point reference_caption, target_caption;  // left ends of their baselines
  double unit_px = 1;                           ///< what one pixel is on a page of 1200 px
  Font font;
  int margin_px = 0, legend_top_px = 0;
};

int scaled_px(int px, double zoom) { return std::max(1, static_cast<int>(std::lround(px * zoom))); }

Layout lay_out(const GreyImage& reference, const GreyImage& target) {
  const int widest = std::max(reference.width(), target.width());
  const int highest = std::max(reference.height(), target.height());
  const bool stacked = widest > kWideImage * highest;
  const double width = stacked ? widest : reference.width() + target.width();
  const double height = stacked ? reference.height() + target.height() : highest;
  const double zoom = std::min({kMaxZoom, kMaxSide_px / width, kMaxSide_px / height});

  Layout layout;
  const cv::Size r(scaled_px(reference.width(), zoom), scaled_px(reference.height(), zoom));
  const cv::Size t(scaled_px(target.width(), zoom), scaled_px(target.height(), zoom));
  const int images_px = stacked ? std::max(r.width, t.width) : r.width + t.width;
  layout.unit_px = std::max(kMinWidth_px, images_px) / 1200.0;
  layout.font.capital_px = 10 * layout.unit_px;
  layout.margin_px = scaled_px(10, layout.unit_px);
  const int gap = layout.margin_px, caption = scaled_px(26, layout.unit_px);
  const int content = images_px + (stacked ? 0 : gap);
  layout.canvas.width = std::max(kMinWidth_px, content + 2 * gap);
  const int left = (layout.canvas.width - content) / 2;
  layout.reference = {{{left, gap + caption}, r}, zoom};
  const cv::Point below(left, layout.reference.place.br().y + gap + caption);
  const cv::Point beside(left + r.width + gap, gap + caption);
  layout.target = {{stacked ? below : beside, t}, zoom};
  const auto caption_of = [&](const Panel& panel) {
    return panel.place.tl() - cv::Point(0, scaled_px(9, layout.unit_px));
  };
  layout.reference_caption = caption_of(layout.reference);
  layout.target_caption = caption_of(layout.target);
  layout.legend_top_px = std::max(layout.reference.place.br().y, layout.target.place.br().y) + gap;
  return layout;
}

void draw_image(cv::Mat canvas, const Panel& panel, const GreyImage& image) {
  const cv::Mat grey(image.height(), image.width(), CV_8UC1,
                     const_cast<std::uint8_t*>(image.data()));
  cv::Mat sized, dimmed;
  cv::resize(grey, sized, panel.place.size(), 0, 0,
             panel.zoom < 1 ? cv::INTER_AREA : cv::INTER_CUBIC);
  sized.convertTo(dimmed, CV_8UC1, 0.68, 20);
  cv::cvtColor(dimmed, canvas(panel.place), cv::COLOR_GRAY2RGB);
}

// One entry of the legend: its sample is drawn into a square at its left end.
struct LegendEntry {
  std::string text;
  Rgb8 ink = kInk;
  int samples = 0;  ///< squares that the sample takes
  std::function<void(cv::Mat, const cv::Point2d&, int sample)> draw{};
};

class Drawing {
 public:
  Drawing(const MatchSide& reference, const MatchSide& target,
          std::span<const Eigen::Vector2d> points, const PairMatches& pair, MatchMarks marks)
      : layout_(lay_out(reference.image, target.image)),
        points_(points),
        pair_(pair),
        marks_(marks),
        line_px_(std::max(1, static_cast<int>(std::lround(0.7 * layout_.unit_px)))) {
    // Marks of a size that lets thousands of them share the image.
    const double area = layout_.reference.place.area();
    const double spacing_px =
        std::sqrt(area / static_cast<double>(std::max<std::size_t>(1, pair.matches.size())));
    radius_px_ = std::clamp(0.36 * spacing_px, 2.8 * layout_.unit_px, 5.5 * layout_.unit_px);
    dot_px_ = 0.4 * radius_px_;
    const std::vector<std::vector<LegendEntry>> rows = wrapped_legend();
    layout_.canvas.height =
        layout_.legend_top_px + static_cast<int>(rows.size()) * row_px() + layout_.margin_px;
    picture_ = ColourImage(layout_.canvas.width, layout_.canvas.height, kGround);
    canvas_ = cv::Mat(layout_.canvas, CV_8UC3, picture_.data());
    draw_side(layout_.reference, layout_.reference_caption, reference);
    draw_side(layout_.target, layout_.target_caption, target);
    draw_unmatched();
    if (marks_ == MatchMarks::lines) {
      draw_lines();
    } else {
      draw_markers();
    }
    draw_legend(rows);
  }

  ColourImage take() { return std::move(picture_); }

 private:
  [[nodiscard]] int row_px() const { return scaled_px(24, layout_.unit_px); }
  [[nodiscard]] int square_px() const { return scaled_px(18, layout_.unit_px); }

  void draw_side(const Panel& panel, const cv::Point& caption, const MatchSide& side) {
    draw_image(canvas_, panel, side.image);
    layout_.font.draw(canvas_, caption, fitting(layout_.font, side.caption, panel.place.width),
                      kInk);
  }

  void draw_unmatched() {
    for (const NoMatchKind& kind : kNoMatchKinds) {
      for (const UnmatchedPoint& point : pair_.unmatched) {
        if (point.reason != kind.reason) continue;
        if (point.point < points_.size()) {
          dot(layout_.reference, points_[point.point], kind.colour);
        }
        for (const Eigen::Vector2d& candidate : point.candidates) {
          dot(layout_.target, candidate, kind.colour);
        }
      }
    }
  }
  void dot(const Panel& panel, const Eigen::Vector2d& pixel, Rgb8 colour) {
    if (const auto at = panel.on_canvas(pixel)) {
      draw_dot(canvas_(panel.place), *at - cv::Point2d(panel.place.tl()), dot_px_, colour);
    }
  }

  void draw_markers() {
    std::mt19937 random(1);
    for (const PairMatch& match : pair_.matches) {
      const Marker marker = random_marker(random, line_px_);
      for (const auto& [panel, pixel] :
           {std::pair{&layout_.reference, match.x_r}, {&layout_.target, match.x_t}}) {
        if (const auto at = panel->on_canvas(pixel)) {
          draw_marker(canvas_(panel->place), *at - cv::Point2d(panel->place.tl()), radius_px_,
                      marker);
        }
      }
    }
  }

  // The more there are, the more the image shines through.
  void draw_lines() {
    const double count = static_cast<double>(pair_.matches.size());
    const double opacity = std::clamp(8 / std::sqrt(count + 1), 0.2, 0.8);
    cv::Mat lines = canvas_.clone();
    std::mt19937 random(1);
    std::vector<std::pair<cv::Point2d, Rgb8>> ends;
    for (const PairMatch& match : pair_.matches) {
      const Rgb8 colour = kMarkerColours[random() % std::size(kMarkerColours)];
      const auto r = layout_.reference.on_canvas(match.x_r),
                 t = layout_.target.on_canvas(match.x_t);
      if (!r || !t) continue;
      cv::line(lines, fixed(*r), fixed(*t), scalar(colour), line_px_, cv::LINE_AA, kFractionBits);
      ends.emplace_back(*r, colour);
      ends.emplace_back(*t, colour);
    }
    cv::addWeighted(lines, opacity, canvas_, 1 - opacity, 0, canvas_);
    for (const auto& [at, colour] : ends) draw_dot(canvas_, at, 0.6 * dot_px_, colour);
  }

  [[nodiscard]] std::vector<LegendEntry> legend() const {
    std::vector<LegendEntry> entries;
    if (!pair_.F) entries.push_back({"no common geometry: " + pair_.refusal, kAlarm});
    LegendEntry matches{fmt::format("{} matches", pair_.matches.size())};
    const double radius_px = 5 * layout_.unit_px;
    if (marks_ == MatchMarks::lines) {
      matches.samples = 2;
      matches.draw = [this](cv::Mat canvas, const cv::Point2d& at, int sample) {
        const cv::Point2d inwards(sample == 0 ? 0.5 * square_px() : -0.5 * square_px(), 0);
        cv::line(canvas, fixed(at), fixed(at + inwards), scalar(kMarkerColours[1]), 2 * line_px_,
                 cv::LINE_AA, kFractionBits);
        draw_dot(canvas, at, 2.5 * layout_.unit_px, kMarkerColours[1]);
      };
    } else {
      matches.text += " (the same marker on both images)";
      matches.samples = 3;
      matches.draw = [this, radius_px](cv::Mat canvas, const cv::Point2d& at, int sample) {
        const auto i = static_cast<std::size_t>(sample);
        draw_marker(canvas, at, radius_px, {2 * i, 2 * line_px_, kMarkerColours[i + 1]});
      };
    }
    entries.push_back(std::move(matches));
    const auto counts = count_reasons(pair_);
    for (std::size_t i = 0; i < counts.size(); ++i) {
      const Rgb8 colour = kNoMatchKinds[i].colour;
      entries.push_back({fmt::format("{} {}", counts[i], kNoMatchKinds[i].words),
                         counts[i] > 0 ? kInk : kFaint, 1,
                         [colour, radius_px](cv::Mat canvas, const cv::Point2d& at, int) {
                           draw_dot(canvas, at, 0.8 * radius_px, colour);
                         }});
    }
    return entries;
  }

  [[nodiscard]] int entry_px(const LegendEntry& entry) const {
    return entry.samples * square_px() + layout_.font.width_px(entry.text) +
           scaled_px(26, layout_.unit_px);
  }

  [[nodiscard]] std::vector<std::vector<LegendEntry>> wrapped_legend() const {
    std::vector<std::vector<LegendEntry>> rows(1);
    const int room_px = layout_.canvas.width - 2 * layout_.margin_px;
    int used_px = 0;
    for (LegendEntry& entry : legend()) {
      const int px = entry_px(entry);
      if (used_px + px > room_px && !rows.back().empty()) {
        rows.emplace_back();
        used_px = 0;
      }
      used_px += px;
      rows.back().push_back(std::move(entry));
    }
    return rows;
  }

  void draw_legend(const std::vector<std::vector<LegendEntry>>& rows) {
    double y = layout_.legend_top_px + 0.5 * row_px();
    for (const auto& row : rows) {
      double x = layout_.margin_px;
      for (const LegendEntry& entry : row) {
        for (int i = 0; i < entry.samples; ++i) {
          entry.draw(canvas_, {x + (i + 0.5) * square_px(), y}, i);
        }
        const double text_x = x + entry.samples * square_px() + 0.2 * square_px();
        layout_.font.draw(canvas_, {text_x, y + 0.5 * layout_.font.capital_px}, entry.text,
                          entry.ink);
        x += entry_px(entry);
      }
      y += row_px();
    }
  }

  Layout layout_;
  std::span<const Eigen::Vector2d> points_;
  const PairMatches& pair_;
  MatchMarks marks_;
  int line_px_;
  double radius_px_ = 0, dot_px_ = 0;
  ColourImage picture_;
  cv::Mat canvas_;  ///< the picture's pixels
};

}  // namespace

std::array<int, kNoMatchKinds.size()> count_reasons(const PairMatches& pair) {
  std::array<int, kNoMatchKinds.size()> counts{};
  for (std::size_t i = 0; i < kNoMatchKinds.size(); ++i) {
    counts[i] = static_cast<int>(
        std::count_if(pair.unmatched.begin(), pair.unmatched.end(),
                      [&](const auto& u) { return u.reason == kNoMatchKinds[i].reason; }));
  }
  return counts;
}

ColourImage match_picture(const MatchSide& reference, const MatchSide& target,
                          std::span<const Eigen::Vector2d> points, const PairMatches& pair,
                          MatchMarks marks) {
  CORVID_CHECK(!reference.image.empty() && !target.image.empty(), "an image without pixels");
  return Drawing(reference, target, points, pair, marks).take();
}

}  // namespace corvid
