#include "kernels/ncc_frequency.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/core.hpp>

#include "kernels/launch.h"

namespace corvid {
namespace {

constexpr float kNoScore = -2;
constexpr int kBoxRows = 16;
// Largest error of an element of a correlation by single-precision transforms of 64 to 256, as a
// share of (root mean square of the result + that of the image), for a template of norm 1: measured
// on noise, smooth noise, ramps, single points and steps.
constexpr double kNoise = 4e-6;
constexpr double kMaxError = 8e-5;  // of a score

// How an axis is cut: `blocks` transforms of `size`, each of `valid` candidates at most.
struct Cut {
  int size = 0, valid = 0, blocks = 0;
};

Cut cut_axis(int candidates, int taps) {
  // Products of small primes; a transform takes a time of nearly size * (7 + log2 size) per axis.
  Cut best;
  double least = std::numeric_limits<double>::max();
  for (const int size : {64, 80, 96, 128, 160, 192, 256}) {
    const int valid = size - taps + 1;
    const int blocks = divide_up(candidates, valid);
    const double cost = blocks * size * (7 + std::log2(size));
    if (cost < least) {
      least = cost;
      best = {size, divide_up(candidates, blocks), blocks};
    }
  }
  return best;
}

// Two blocks are transformed at a time: one as the real part, one as the imaginary part. The
// correlation with a real template keeps them apart.
class Correlator {
 public:
  Correlator(const FrequencyJob& job, float* scores)
      : job_(job),
        scores_(scores),
        across_(cut_axis(job.width_px, job.template_width_px)),
        down_(cut_axis(job.height_px, job.template_height_px)) {
    double squares = 0;
    for (int v = 0; v < job.template_height_px; ++v)
      for (int u = 0; u < job.template_width_px; ++u) {
        const double tap = tap_at(u, v);
        tap_sum_ += tap;
        squares += tap * tap;
      }
    tap_norm_ = std::sqrt(squares);
    // Norm 1, and the inverse transform's scale.
    const double scale =
        tap_norm_ > 0 ? 1 / (tap_norm_ * static_cast<double>(across_.size) * down_.size) : 0;
    spectrum_ = cv::Mat2f(down_.size, across_.size, cv::Vec2f(0, 0));
    for (int v = 0; v < job.template_height_px; ++v)
      for (int u = 0; u < job.template_width_px; ++u)
        spectrum_(v, u)[0] = static_cast<float>(scale * tap_at(u, v));
    cv::dft(spectrum_, spectrum_, 0, job.template_height_px);
  }

  std::vector<CandidateBox> run() {
    const int blocks = across_.blocks * down_.blocks, pairs = divide_up(blocks, 2);
    std::vector<std::vector<CandidateBox>> left(static_cast<std::size_t>(pairs));
    cv::parallel_for_(
        cv::Range(0, pairs),
        [&](const cv::Range& range) {
          cv::Mat2f buffer(down_.size, across_.size);
          for (int pair = range.start; pair < range.end; ++pair)
            if (job_.format == PixelFormat::grey8)
              do_pair<std::uint8_t>(pair, blocks, buffer, left[static_cast<std::size_t>(pair)]);
            else
              do_pair<float>(pair, blocks, buffer, left[static_cast<std::size_t>(pair)]);
        },
        std::min(pairs, job_.threads >= cv::getNumThreads() ? 4 * job_.threads : job_.threads));
    std::vector<CandidateBox> all;
    for (const auto& boxes : left) all.insert(all.end(), boxes.begin(), boxes.end());
    return all;
  }

 private:
  struct Block {
    CandidateBox candidates;
    float mean = 0;
    double deviation = 0;  // of its pixels; not finite if one of them is not
  };

  [[nodiscard]] double tap_at(int u, int v) const {
    return job_.taps[static_cast<std::ptrdiff_t>(v) * job_.taps_pitch + u];
  }
  [[nodiscard]] std::ptrdiff_t pixel_at(int x, int y) const {
    return static_cast<std::ptrdiff_t>(y) * job_.target_width_px + x;
  }

  // The first pixel of a row of a block's footprints.
  template <class Pixel>
  [[nodiscard]] const Pixel* row_of(const Block& block, int row) const {
    return static_cast<const Pixel*>(job_.target) +
           pixel_at(job_.x_px + block.candidates.x_px - job_.template_width_px / 2,
                    job_.y_px + block.candidates.y_px - job_.template_height_px / 2 + row);
  }
  [[nodiscard]] int columns_of(const Block& block) const {
    return block.candidates.width_px + job_.template_width_px - 1;
  }
  [[nodiscard]] int rows_of(const Block& block) const {
    return block.candidates.height_px + job_.template_height_px - 1;
  }

  template <class Pixel>
  [[nodiscard]] Block block_at(int index) const {
    Block block;
    CandidateBox& box = block.candidates;
    box.x_px = (index % across_.blocks) * across_.valid;
    box.y_px = (index / across_.blocks) * down_.valid;
    box.width_px = std::min(across_.valid, job_.width_px - box.x_px);
    box.height_px = std::min(down_.valid, job_.height_px - box.y_px);
    const int columns = columns_of(block), rows = rows_of(block);
    const auto origin = static_cast<double>(*row_of<Pixel>(block, 0));
    double sum = 0, squares = 0;
    for (int r = 0; r < rows; ++r) {
      const Pixel* row = row_of<Pixel>(block, r);
      std::array<double, 4> s{}, q{};  // apart, so that they may be added side by side
      int c = 0;
      for (; c + 4 <= columns; c += 4)
        for (std::size_t k = 0; k < 4; ++k) {
          const double d = static_cast<double>(row[static_cast<std::size_t>(c) + k]) - origin;
          s[k] += d;
          q[k] += d * d;
        }
      for (; c < columns; ++c) {
        const double d = static_cast<double>(row[c]) - origin;
        s[0] += d;
        q[0] += d * d;
      }
      sum += (s[0] + s[1]) + (s[2] + s[3]);
      squares += (q[0] + q[1]) + (q[2] + q[3]);
    }
    const double count = static_cast<double>(rows) * columns;
    block.mean = static_cast<float>(origin + sum / count);
    block.deviation = std::sqrt(std::max(squares / count - (sum / count) * (sum / count), 0.0));
    if (!std::isfinite(squares)) block.deviation = std::numeric_limits<double>::infinity();
    return block;
  }

  // Part 0 or 1 of the buffer: (pixels - mean) / deviation, 0 elsewhere.
  template <class Pixel>
  void fill(const Block& block, std::size_t part, cv::Mat2f& buffer) const {
    const int columns = columns_of(block);
    const auto scale = static_cast<float>(1 / block.deviation);
    for (int r = 0; r < rows_of(block); ++r) {
      const Pixel* row = row_of<Pixel>(block, r);
      float* out = buffer.ptr<float>(r) + part;
      for (std::ptrdiff_t c = 0; c < columns; ++c)
        out[2 * c] = (static_cast<float>(row[c]) - block.mean) * scale;
    }
  }

  template <class Pixel>
  void do_pair(int pair, int blocks, cv::Mat2f& buffer, std::vector<CandidateBox>& left) const {
    std::array<Block, 2> both;
    int parts = 0, rows = 0, valid_rows = 0;
    buffer.setTo(cv::Scalar::all(0));
    for (int index = 2 * pair; index < std::min(2 * pair + 2, blocks); ++index) {
      const Block block = block_at<Pixel>(index);
      // Too small or too large for the scale to be a float: such blocks are somebody else's.
      if (block.deviation > 0 && !(block.deviation > 1e-30 && block.deviation < 1e30)) {
        leave(block.candidates, left);
        continue;
      }
      if (block.deviation > 0) fill<Pixel>(block, static_cast<std::size_t>(parts), buffer);
      rows = std::max(rows, rows_of(block));
      valid_rows = std::max(valid_rows, block.candidates.height_px);
      both[static_cast<std::size_t>(parts++)] = block;
    }
    if (parts == 0) return;
    cv::dft(buffer, buffer, 0, rows);
    cv::mulSpectrums(buffer, spectrum_, buffer, 0, true);
    cv::dft(buffer, buffer, cv::DFT_INVERSE);
    double squares = 0;
    for (int r = 0; r < valid_rows; ++r) {
      const float* row = buffer.ptr<float>(r);
      std::array<float, 8> q{};
      for (std::ptrdiff_t c = 0; c < 2 * across_.size; c += 8)
        for (std::size_t k = 0; k < 8; ++k)
          q[k] += row[c + static_cast<std::ptrdiff_t>(k)] * row[c + static_cast<std::ptrdiff_t>(k)];
      for (const float s : q) squares += static_cast<double>(s);
    }
    const double rms = std::sqrt(squares / (static_cast<double>(valid_rows) * across_.size));
    for (int part = 0; part < parts; ++part)
      finish(both[static_cast<std::size_t>(part)], part, kNoise * (1 + rms), buffer, left);
  }

  // Numerators to coefficients. noise: of the numerators.
  void finish(const Block& block, int part, double noise, const cv::Mat2f& buffer,
              std::vector<CandidateBox>& left) const {
    const double unit = block.deviation * tap_norm_;
    const auto factor = static_cast<float>(unit), sum = static_cast<float>(tap_sum_);
    const auto least_sure = static_cast<float>(kMaxError / (noise * unit));
    const CandidateBox& all = block.candidates;
    for (int first = 0; first < all.height_px; first += kBoxRows) {
      const CandidateBox box{all.x_px, all.y_px + first, all.width_px,
                             std::min(kBoxRows, all.height_px - first)};
      float largest = 0;
      for (int r = 0; r < box.height_px; ++r) {
        const float* inverses =
            job_.inverses + pixel_at(job_.x_px + box.x_px, job_.y_px + box.y_px + r);
        for (int c = 0; c < box.width_px; ++c) largest = std::max(largest, inverses[c]);
      }
      if (largest > least_sure) {
        left.push_back(box);
        continue;
      }
      for (int r = 0; r < box.height_px; ++r) {
        const std::ptrdiff_t at = pixel_at(job_.x_px + box.x_px, job_.y_px + box.y_px + r);
        const float *means = job_.means + at, *inverses = job_.inverses + at;
        const float* numerators = buffer.ptr<float>(first + r) + part;
        float* out = scores_ + static_cast<std::ptrdiff_t>(box.y_px + r) * job_.width_px + box.x_px;
        for (std::ptrdiff_t c = 0; c < box.width_px; ++c) {
          const float score =
              (numerators[2 * c] * factor - sum * (means[c] - block.mean)) * inverses[c];
          const float clamped = std::min(std::max(score, -1.0F), 1.0F);
          out[c] = inverses[c] > 0 && score == score ? clamped : kNoScore;
        }
      }
    }
  }

  static void leave(const CandidateBox& box, std::vector<CandidateBox>& left) {
    for (int first = 0; first < box.height_px; first += kBoxRows)
      left.push_back(
          {box.x_px, box.y_px + first, box.width_px, std::min(kBoxRows, box.height_px - first)});
  }

  const FrequencyJob& job_;
  float* scores_;
  Cut across_, down_;
  double tap_sum_ = 0, tap_norm_ = 0;
  cv::Mat2f spectrum_;
};

}  // namespace

std::vector<CandidateBox> score_by_frequency(const FrequencyJob& job, float* scores) {
  CORVID_CHECK(job.template_width_px < 64 && job.template_height_px < 64 && job.threads > 0,
               "a template is smaller than a block");
  if (job.width_px <= 0 || job.height_px <= 0) return {};
  try {
    return Correlator(job, scores).run();
  } catch (const cv::Exception& e) {  // no memory
    throw DeviceFault(e.what(), CL_OUT_OF_HOST_MEMORY);
  }
}

}  // namespace corvid
