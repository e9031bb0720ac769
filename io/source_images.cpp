#include "io/source_images.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "core/messages.h"
#include "io/exif.h"
#include "io/image_file.h"

namespace corvid {
namespace {

double median_rate_hz(const std::vector<ImageEntry>& entries, const std::vector<bool>& bad) {
  std::vector<std::int64_t> gaps;
  std::optional<std::int64_t> last;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    if (bad[i]) continue;
    if (last) gaps.push_back(entries[i].time_ns - *last);
    last = entries[i].time_ns;
  }
  if (gaps.empty()) return 0;
  const auto middle = gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2);
  std::nth_element(gaps.begin(), middle, gaps.end());
  return 1e9 / static_cast<double>(*middle);
}

class ImageSource final : public FrameSource {
 public:
  static Expected<std::unique_ptr<FrameSource>> open(const std::string& path, ImageList list,
                                                     const SourceOptions& options);

  [[nodiscard]] const SourceInfo& info() const override { return info_; }
  [[nodiscard]] Expected<FramePtr> next(const std::stop_token& stop) override;
  [[nodiscard]] SourceCounts counts() const override { return counts_; }
  [[nodiscard]] Trajectory truth() const override;
  [[nodiscard]] std::vector<PositionFix> positions() const override;

 private:
  void take_times(ImageList& list, const SourceOptions& options);
  void select(const SourceOptions& options);
  [[nodiscard]] Expected<void> probe();
  [[nodiscard]] Expected<void> take_camera(ImageList& list, const SourceOptions& options);
  [[nodiscard]] Expected<void> fit_entry_cameras(const std::string& where);
  void skip(std::string message) {
    ++counts_.skipped;
    add_message(counts_.messages, std::move(message));
  }

  SourceInfo info_;
  std::vector<ImageEntry> entries_;
  std::vector<bool> bad_time_;
  Trajectory truth_;
  bool colour_ = true;
  int width_px_ = 0, height_px_ = 0;  ///< of the first image that can be read
  std::size_t next_ = 0;
  SourceCounts counts_;
};

Expected<std::unique_ptr<FrameSource>> ImageSource::open(const std::string& path, ImageList list,
                                                         const SourceOptions& options) {
  auto source = std::make_unique<ImageSource>();
  source->info_.kind = list.kind;
  source->info_.path = path;
  source->info_.stills = list.stills;
  source->info_.has_depth = list.has_depth;
  source->info_.intrinsics = list.origin;
  source->info_.notes = list.notes;
  source->colour_ = options.colour;
  for (std::string& message : list.skipped) source->skip(std::move(message));
  source->take_times(list, options);
  source->entries_ = std::move(list.entries);
  const std::size_t all = source->entries_.size();
  source->select(options);
  if (source->entries_.empty()) {
    return fail(
        ErrorCode::invalid_argument,
        fmt::format("the source has {} images; none is left from number {} on", all, options.first),
        path);
  }
  if (auto ok = source->probe(); !ok) return tl::unexpected(ok.error());
  if (auto ok = source->take_camera(list, options); !ok) return tl::unexpected(ok.error());
  source->info_.frames = source->entries_.size();
  if (!source->info_.stills) {
    source->info_.rate_hz = median_rate_hz(source->entries_, source->bad_time_);
  }
  return source;
}

void ImageSource::take_times(ImageList& list, const SourceOptions& options) {
  if (options.rate_hz) {
    for (std::size_t i = 0; i < list.entries.size(); ++i) {
      list.entries[i].time_ns =
          static_cast<std::int64_t>(std::llround(static_cast<double>(i) * 1e9 / *options.rate_hz));
    }
    if (!list.truth.empty()) {
      info_.notes.emplace_back(
          "the true trajectory is left out: its times mean nothing with a given rate");
    }
  } else {
    truth_ = std::move(list.truth);
  }
}

void ImageSource::select(const SourceOptions& options) {
  std::vector<ImageEntry> taken;
  const auto step = static_cast<std::size_t>(options.step);
  const std::size_t count =
      options.count < 0 ? entries_.size() : static_cast<std::size_t>(options.count);
  for (std::size_t i = static_cast<std::size_t>(options.first);
       i < entries_.size() && taken.size() < count; i += step) {
    taken.push_back(std::move(entries_[i]));
  }
  entries_ = std::move(taken);
  std::vector<std::int64_t> times;
  for (const ImageEntry& entry : entries_) times.push_back(entry.time_ns);
  bad_time_ = times_out_of_order(times);
}

// The first image that can be read decides about size and colour.
Expected<void> ImageSource::probe() {
  std::string first_fault;
  for (const ImageEntry& entry : entries_) {
    const Expected<DecodedImage> image = read_image(entry.path, colour_);
    if (image) {
      width_px_ = image->grey.width();
      height_px_ = image->grey.height();
      info_.colour = !image->colour.empty();
      if (const auto exif = read_exif(entry.path); exif && exif->orientation != 1) {
        info_.notes.push_back(
            fmt::format("the images ask viewers to turn them (EXIF orientation {}): they are used "
                        "as they are stored",
                        exif->orientation));
      }
      return {};
    }
    if (first_fault.empty()) first_fault = image.error().to_string();
  }
  return fail(
      ErrorCode::corrupt,
      fmt::format("none of the {} images can be read; the first: {}", entries_.size(), first_fault),
      info_.path);
}

Expected<void> ImageSource::take_camera(ImageList& list, const SourceOptions& options) {
  std::string where = list.calibration_path;
  if (!options.calibration_path.empty()) {
    where = options.calibration_path;
    auto read = read_calibration(where);
    if (!read) return tl::unexpected(read.error());
    list.calibration = std::move(*read);
    info_.intrinsics = IntrinsicsOrigin::calibration;
    for (ImageEntry& entry : entries_) entry.camera = nullptr;
  }
  if (list.calibration) {
    const std::size_t had = list.calibration->notes.size();
    for (std::size_t i = 0; i < had; ++i) info_.notes.push_back(list.calibration->notes[i]);
    auto fitted = fit_calibration(std::move(*list.calibration), width_px_, height_px_, where);
    if (!fitted) return tl::unexpected(fitted.error());
    for (std::size_t i = had; i < fitted->notes.size(); ++i) {
      info_.notes.push_back(fitted->notes[i]);
    }
    info_.camera = std::make_shared<const Camera>(fitted->camera);
    return {};
  }
  if (std::any_of(entries_.begin(), entries_.end(), [](const auto& e) { return e.camera; })) {
    return fit_entry_cameras(where);
  }
  // The first may have lost its EXIF; many without mean that the images have none.
  const auto last = entries_.begin() + std::min<std::ptrdiff_t>(8, std::ssize(entries_));
  const auto told = std::find_if(entries_.begin(), last, [](const ImageEntry& entry) {
    return read_exif(entry.path).has_value();
  });
  assume_camera(told == last ? std::string() : told->path, width_px_, height_px_, info_);
  return {};
}

Expected<void> ImageSource::fit_entry_cameras(const std::string& where) {
  std::map<const Camera*, std::shared_ptr<const Camera>> fitted;
  std::optional<Error> fault;
  for (ImageEntry& entry : entries_) {
    if (!entry.camera) continue;
    auto [it, is_new] = fitted.try_emplace(entry.camera.get());
    if (is_new) {
      auto fit = fit_calibration({*entry.camera, {}, {}, {}}, width_px_, height_px_,
                                 where.empty() ? info_.path : where);
      if (fit) {
        it->second = std::make_shared<const Camera>(fit->camera);
        if (!fit->notes.empty() && fitted.size() == 1) info_.notes.push_back(fit->notes.front());
      } else {
        it->second = entry.camera;  // images of another size, which next() will skip
        fault = fit.error();
      }
    }
    entry.camera = it->second;
    if (!info_.camera && entry.camera->width_px == width_px_ &&
        entry.camera->height_px == height_px_) {
      info_.camera = entry.camera;
    }
  }
  if (!info_.camera) return tl::unexpected(*fault);
  return {};
}

Expected<FramePtr> ImageSource::next(const std::stop_token& stop) {
  while (next_ < entries_.size() && !stop.stop_requested()) {
    const std::size_t index = next_++;
    const ImageEntry& entry = entries_[index];
    if (bad_time_[index]) {
      skip(fmt::format("{}: its time {} ns does not follow the other images' times", entry.path,
                       entry.time_ns));
      continue;
    }
    Expected<DecodedImage> image = read_image(entry.path, colour_);
    if (!image) {
      skip(image.error().to_string());
      continue;
    }
    if (image->grey.width() != width_px_ || image->grey.height() != height_px_) {
      skip(fmt::format("{}: the image has {} x {} pixels but the first has {} x {}", entry.path,
                       image->grey.width(), image->grey.height(), width_px_, height_px_));
      continue;
    }
    auto frame = std::make_shared<Frame>();
    frame->id = FrameId(static_cast<std::uint32_t>(index));
    frame->time_ns = entry.time_ns;
    frame->grey = std::move(image->grey);
    frame->colour = std::move(image->colour);
    frame->camera = entry.camera ? entry.camera : info_.camera;
    frame->name = entry.name;
    ++counts_.delivered;
    return frame;
  }
  if (counts_.delivered == 0 && !stop.stop_requested()) {
    return fail(ErrorCode::corrupt,
                fmt::format("none of the {} images could be used; the first: {}", entries_.size(),
                            counts_.messages.empty() ? "" : counts_.messages.front()),
                info_.path);
  }
  return nullptr;
}

Trajectory ImageSource::truth() const {
  if (!truth_.empty()) return truth_;
  Trajectory result;
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    if (!bad_time_[i] && entries_[i].T_world_camera) {
      result.push_back({entries_[i].time_ns, *entries_[i].T_world_camera});
    }
  }
  return result;
}

std::vector<PositionFix> ImageSource::positions() const {
  std::vector<PositionFix> result;
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    if (bad_time_[i]) continue;
    const std::optional<Exif> exif = read_exif(entries_[i].path);
    if (!exif || !exif->gps) continue;
    PositionFix fix;
    fix.time_ns = entries_[i].time_ns;
    fix.position = *exif->gps;
    if (exif->gps_sigma_m) {
      const double sigma_m = std::clamp(*exif->gps_sigma_m, 0.01, 1e4);
      fix.covariance_m2 = Eigen::Vector3d(sigma_m, sigma_m, 2 * sigma_m).cwiseAbs2().asDiagonal();
    }
    result.push_back(fix);
  }
  return result;
}

}  // namespace

std::vector<bool> times_out_of_order(const std::vector<std::int64_t>& times_ns) {
  // Longest strictly rising subsequence by patience sorting from the end: length[i] of the best one
  // that starts at i. starts[k] is the greatest value that begins one of length k + 1.
  std::vector<std::size_t> length(times_ns.size());
  std::vector<std::int64_t> starts;
  for (std::size_t i = times_ns.size(); i-- > 0;) {
    const auto at = std::lower_bound(starts.begin(), starts.end(), times_ns[i],
                                     [](std::int64_t start, std::int64_t t) { return start > t; });
    length[i] = static_cast<std::size_t>(at - starts.begin()) + 1;
    if (at == starts.end()) {
      starts.push_back(times_ns[i]);
    } else {
      *at = times_ns[i];
    }
  }
  std::vector<bool> bad(times_ns.size(), true);
  std::size_t wanted = starts.size();
  std::optional<std::int64_t> last;
  for (std::size_t i = 0; i < times_ns.size(); ++i) {
    if (length[i] == wanted && (!last || times_ns[i] > *last)) {
      bad[i] = false;
      last = times_ns[i];
      --wanted;
    }
  }
  return bad;
}

Expected<void> check_source_options(const SourceOptions& options) {
  const auto wrong = [](std::string what) { return fail(ErrorCode::invalid_argument, what); };
  if (options.first < 0)
    return wrong(fmt::format("first = {}: must not be negative", options.first));
  if (options.step < 1) return wrong(fmt::format("step = {}: must be at least 1", options.step));
  if (options.count == 0) return wrong("count = 0: no image would be taken");
  if (options.rate_hz && !(*options.rate_hz >= 1e-3 && *options.rate_hz <= 1e6)) {
    return wrong(fmt::format("rate_hz = {}: must be 0.001 to 1e6", *options.rate_hz));
  }
  return {};
}

void assume_camera(const std::string& path, int width_px, int height_px, SourceInfo& info) {
  Camera camera;
  camera.width_px = width_px;
  camera.height_px = height_px;
  camera.cx_px = (width_px - 1) / 2.0;
  camera.cy_px = (height_px - 1) / 2.0;
  const std::optional<Exif> exif = path.empty() ? std::nullopt : read_exif(path);
  const std::optional<ExifFocal> focal =
      exif ? exif_focal(*exif, width_px, height_px) : std::nullopt;
  if (focal) {
    camera.fx_px = camera.fy_px = focal->focal_px;
    info.intrinsics = IntrinsicsOrigin::exif;
    info.notes.push_back(fmt::format("no calibration: focal length {:.1f} px from EXIF ({})",
                                     focal->focal_px, focal->how));
  } else {
    camera.fx_px = camera.fy_px = 1.2 * std::max(width_px, height_px);
    info.intrinsics = IntrinsicsOrigin::guess;
    info.notes.push_back(fmt::format(
        "no calibration and no focal length in EXIF: {:.1f} px is guessed (1.2 times the longer "
        "side)",
        camera.fx_px));
  }
  info.camera = std::make_shared<const Camera>(camera);
}

Expected<void> take_calibration(const std::string& path, int width_px, int height_px,
                                SourceInfo& info) {
  if (path.empty()) {
    assume_camera("", width_px, height_px, info);
    return {};
  }
  auto read = read_calibration(path);
  if (!read) return tl::unexpected(read.error());
  auto fitted = fit_calibration(std::move(*read), width_px, height_px, path);
  if (!fitted) return tl::unexpected(fitted.error());
  info.camera = std::make_shared<const Camera>(fitted->camera);
  info.notes.push_back(fmt::format("camera from {} ({})", path, fitted->format));
  info.notes.insert(info.notes.end(), fitted->notes.begin(), fitted->notes.end());
  return {};
}

Expected<std::unique_ptr<FrameSource>> open_image_list(const std::string& path, ImageList list,
                                                       const SourceOptions& options) {
  return ImageSource::open(path, std::move(list), options);
}

}  // namespace corvid
