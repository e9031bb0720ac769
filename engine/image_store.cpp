#include "engine/image_store.h"

#include <utility>

#include "core/log.h"

namespace corvid {

ImageStore::ImageStore(std::shared_ptr<Archive> archive, std::size_t budget_bytes)
    : archive_(std::move(archive)), budget_bytes_(budget_bytes) {}

void ImageStore::trim(const MapSnapshot& map) {
  if (!archive_ || failure_) return;
  std::size_t newest = map.keyframes.size(), bytes = 0;
  while (newest > 0 && bytes + map.keyframes[newest - 1]->frame->image_bytes <= budget_bytes_)
    bytes += map.keyframes[--newest]->frame->image_bytes;
  // Whatever is older than one that was put away is there, too.
  while (newest > 0 && !map.keyframes[newest - 1]->frame->is_away()) {
    if (auto done = map.keyframes[--newest]->frame->put_away(archive_); !done) {
      failure_ = done.error();
      log().warn("keyframes' pictures stay in memory: {}", failure_->to_string());
      return;
    }
  }
}

}  // namespace corvid
