#include "corvid/stored_depth.h"

#include <cstring>
#include <mutex>
#include <utility>

#include "core/log.h"

namespace corvid {

namespace {

DepthAnswers count_answers(const DepthMap& map) {
  DepthAnswers out;
  out.pixels = map.depth.size();
  const bool rated = map.confidence.size() == map.depth.size();
  for (std::size_t i = 0; i < map.depth.size(); ++i) {
    if (!(map.depth.data()[i] > 0)) continue;
    ++out.answered;
    if (rated) out.confidence += map.confidence.data()[i];
  }
  return out;
}

}  // namespace

struct StoredDepth::Shared {
  explicit Shared(DepthMap map)
      : bare{map.keyframe, map.camera, map.T_world_camera, {}, {}}, answers(count_answers(map)) {
    depth_bytes = map.depth.size() * sizeof(float);
    confidence_bytes = map.confidence.size() * sizeof(float);
    depth_width = map.depth.width();
    confidence_width = map.confidence.width();
    images = std::make_shared<const DepthMap>(std::move(map));
  }
  ~Shared() {
    if (archive) archive->drop(slot);
  }
  Shared(const Shared&) = delete;
  Shared& operator=(const Shared&) = delete;

  [[nodiscard]] std::shared_ptr<const DepthMap> get() {
    const std::lock_guard lock(mutex);
    if (images) return images;
    if (auto lent = loan.lock()) return lent;
    auto map = std::make_shared<DepthMap>(bare);
    const auto bytes = archive->get(slot);
    if (bytes && bytes->size() == depth_bytes + confidence_bytes) {
      map->depth = image(bytes->data(), depth_bytes, depth_width);
      map->confidence = image(bytes->data() + depth_bytes, confidence_bytes, confidence_width);
    } else {
      log().warn("the depth map of keyframe {} cannot be read back: {}", bare.keyframe.value,
                 bytes ? "it has another size" : bytes.error().to_string());
    }
    loan = map;
    return map;
  }

  [[nodiscard]] Expected<void> put_away(const std::shared_ptr<Archive>& to) {
    const std::lock_guard lock(mutex);
    if (!images) return {};
    std::vector<std::byte> bytes(depth_bytes + confidence_bytes);
    if (depth_bytes > 0) std::memcpy(bytes.data(), images->depth.data(), depth_bytes);
    if (confidence_bytes > 0)
      std::memcpy(bytes.data() + depth_bytes, images->confidence.data(), confidence_bytes);
    auto put = to->put(bytes);
    if (!put) return tl::unexpected(put.error());
    slot = *put;
    archive = to;
    loan = images;
    images.reset();
    return {};
  }

  static FloatImage image(const std::byte* bytes, std::size_t size, int width) {
    const auto pixels = static_cast<int>(size / sizeof(float));
    FloatImage out(width, width > 0 ? pixels / width : 0);
    if (size > 0) std::memcpy(out.data(), bytes, size);
    return out;
  }

  std::mutex mutex;
  DepthMap bare;  // all but the images
  const DepthAnswers answers;
  std::size_t depth_bytes, confidence_bytes;
  int depth_width, confidence_width;
  std::shared_ptr<const DepthMap> images;  // null: in the archive
  std::weak_ptr<const DepthMap> loan;
  std::shared_ptr<Archive> archive;
  Archive::Slot slot;
};

StoredDepth::StoredDepth(DepthMap map)
    : keyframe(map.keyframe),
      T_world_camera(map.T_world_camera),
      shared_(std::make_shared<Shared>(std::move(map))) {}

std::shared_ptr<const DepthMap> StoredDepth::scaled() const {
  auto map = shared_->get();
  if (scale == 1) return map;
  auto copy = std::make_shared<DepthMap>(*map);
  for (std::size_t i = 0; i < copy->depth.size(); ++i)
    copy->depth.data()[i] *= static_cast<float>(scale);
  return copy;
}

DepthMap StoredDepth::load() const {
  DepthMap map = *scaled();
  map.T_world_camera = T_world_camera;
  return map;
}

Expected<void> StoredDepth::put_away(const std::shared_ptr<Archive>& archive) const {
  return shared_->put_away(archive);
}

std::size_t StoredDepth::image_bytes() const {
  return shared_->depth_bytes + shared_->confidence_bytes;
}

const DepthAnswers& StoredDepth::answers() const { return shared_->answers; }

bool StoredDepth::in_memory() const {
  const std::lock_guard lock(shared_->mutex);
  return shared_->images != nullptr;
}

}  // namespace corvid
