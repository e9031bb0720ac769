#include "engine/image_store.h"

#include <utility>

#include "core/log.h"

namespace corvid {
namespace {

constexpr std::size_t kTryAgainAfter = 50;  // keyframes

}  // namespace

ImageStore::ImageStore(std::shared_ptr<Archive> archive, std::size_t budget_bytes)
    : archive_(std::move(archive)), budget_bytes_(budget_bytes) {}

void ImageStore::trim(const MapSnapshot& map) {
  if (!archive_ || map.keyframes.size() < next_try_) return;
  std::size_t newest = map.keyframes.size(), bytes = 0;
  while (newest > 0 && bytes + map.keyframes[newest - 1]->frame->image_bytes <= budget_bytes_)
    bytes += map.keyframes[--newest]->frame->image_bytes;
  // The oldest goes first: whatever is older than one that was put away is there, too.
  std::size_t oldest = newest;
  while (oldest > 0 && !map.keyframes[oldest - 1]->frame->is_away()) --oldest;
  for (; oldest < newest; ++oldest) {
    if (auto done = map.keyframes[oldest]->frame->put_away(archive_); !done) {
      failure_ = done.error();
      next_try_ = map.keyframes.size() + kTryAgainAfter;
      log().warn("keyframes' pictures stay in memory for now: {}", failure_->to_string());
      return;
    }
  }
}

}  // namespace corvid
