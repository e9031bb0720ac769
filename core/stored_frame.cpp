#include <algorithm>
#include <iterator>
#include <span>
#include <utility>
#include <vector>

#include "core/check.h"
#include "core/log.h"
#include "corvid/frame.h"

namespace corvid {
namespace {

const Frame& checked(const FramePtr& frame) {
  CORVID_CHECK(frame, "a stored frame needs a frame");
  return *frame;
}

template <class T>
std::span<const std::byte> bytes_of(const Image<T>& image) {
  return std::as_bytes(std::span(image.data(), image.size()));
}

template <class T>
std::span<std::byte> bytes_of(Image<T>& image) {
  return std::as_writable_bytes(std::span(image.data(), image.size()));
}

}  // namespace

StoredFrame::StoredFrame(FramePtr frame)
    : id(checked(frame).id),
      time_ns(frame->time_ns),
      camera(frame->camera),
      name(frame->name),
      width_px(frame->grey.width()),
      height_px(frame->grey.height()),
      image_bytes(frame->grey.size() + sizeof(Rgb8) * frame->colour.size()),
      colour_width_px_(frame->colour.width()),
      colour_height_px_(frame->colour.height()),
      frame_(std::move(frame)) {}

FramePtr StoredFrame::load() const {
  std::shared_ptr<Archive> archive;
  {
    const std::lock_guard lock(mutex_);
    if (frame_) return frame_;
    if (auto loan = loan_.lock()) return loan;
    archive = archive_;
  }
  auto frame = std::make_shared<Frame>();
  frame->id = id;
  frame->time_ns = time_ns;
  frame->camera = camera;
  frame->name = name;
  const auto bytes = archive->get(slot_);
  if (!bytes || bytes->size() != image_bytes) {
    log().warn("the pictures of frame {} are lost: {}", id.value,
               bytes ? "they came back with another size" : bytes.error().to_string());
    return frame;
  }
  frame->grey = GreyImage(width_px, height_px);
  frame->colour = ColourImage(colour_width_px_, colour_height_px_);
  const auto grey = std::span(*bytes).first(frame->grey.size());
  std::ranges::copy(grey, bytes_of(frame->grey).begin());
  std::ranges::copy(std::span(*bytes).subspan(grey.size()), bytes_of(frame->colour).begin());
  const std::lock_guard lock(mutex_);
  loan_ = frame;
  return frame;
}

Expected<void> StoredFrame::put_away(std::shared_ptr<Archive> archive) const {
  FramePtr frame;
  {
    const std::lock_guard lock(mutex_);
    frame = frame_;
  }
  if (!frame) return {};
  std::vector<std::byte> bytes;
  bytes.reserve(image_bytes);
  std::ranges::copy(bytes_of(frame->grey), std::back_inserter(bytes));
  std::ranges::copy(bytes_of(frame->colour), std::back_inserter(bytes));
  const auto slot = archive->put(bytes);
  if (!slot) return tl::unexpected(slot.error());
  const std::lock_guard lock(mutex_);
  slot_ = *slot;
  archive_ = std::move(archive);
  loan_ = frame_;
  frame_.reset();
  return {};
}

bool StoredFrame::is_away() const {
  const std::lock_guard lock(mutex_);
  return frame_ == nullptr;
}

}  // namespace corvid
