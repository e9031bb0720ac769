#include "io/camera/mapped_buffer.h"

#include <fmt/format.h>
#include <libcamera/framebuffer.h>
#include <linux/dma-buf.h>
#include <sys/ioctl.h>
#include <sys/mman.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

namespace corvid {
namespace {

/// V4L2's format of separate planes for one of a single plane; itself if there is none.
std::uint32_t separate_planes(std::uint32_t fourcc) {
  for (const auto& [together, apart] : {std::pair("NV12", "NM12"), std::pair("NV21", "NM21"),
                                        std::pair("YU12", "YM12"), std::pair("YV12", "YM21")}) {
    if (fourcc == fourcc_of(together)) return fourcc_of(apart);
  }
  return fourcc;
}

}  // namespace

Expected<MappedBuffer> MappedBuffer::map(const libcamera::FrameBuffer& buffer) {
  MappedBuffer mapped;
  for (const libcamera::FrameBuffer::Plane& plane : buffer.planes()) {
    const std::size_t offset =
        plane.offset == libcamera::FrameBuffer::Plane::kInvalidOffset ? 0 : plane.offset;
    const auto at = std::find_if(mapped.regions_.begin(), mapped.regions_.end(),
                                 [&](const Region& region) { return region.fd == plane.fd.get(); });
    const auto index = static_cast<std::size_t>(at - mapped.regions_.begin());
    if (at == mapped.regions_.end()) mapped.regions_.push_back({plane.fd.get()});
    mapped.regions_[index].size = std::max(mapped.regions_[index].size, offset + plane.length);
    mapped.planes_.push_back({index, offset, plane.length});
  }
  for (Region& region : mapped.regions_) {
    void* data = mmap(nullptr, region.size, PROT_READ, MAP_SHARED, region.fd, 0);
    if (data == MAP_FAILED) {
      return fail(ErrorCode::io, fmt::format("a buffer of {} bytes cannot be mapped: {}",
                                             region.size, std::strerror(errno)));
    }
    region.data = static_cast<std::uint8_t*>(data);
  }
  return mapped;
}

MappedBuffer::MappedBuffer(MappedBuffer&& other) noexcept
    : regions_(std::exchange(other.regions_, {})), planes_(std::exchange(other.planes_, {})) {}

MappedBuffer::~MappedBuffer() {
  for (const Region& region : regions_) {
    if (region.data != nullptr) munmap(region.data, region.size);
  }
}

void MappedBuffer::begin_read() const { synchronise(DMA_BUF_SYNC_START | DMA_BUF_SYNC_READ); }
void MappedBuffer::end_read() const { synchronise(DMA_BUF_SYNC_END | DMA_BUF_SYNC_READ); }

void MappedBuffer::synchronise(std::uint64_t flags) const {
  for (const Region& region : regions_) {
    dma_buf_sync sync = {};
    sync.flags = flags;
    // Memory that needs no synchronising has no such call.
    ioctl(region.fd, DMA_BUF_IOCTL_SYNC, &sync);
  }
}

std::vector<RawPlane> MappedBuffer::planes(std::span<const std::size_t> bytes_used,
                                           std::size_t stride_bytes, std::uint32_t& fourcc) const {
  bool together = true;
  for (std::size_t i = 1; i < planes_.size(); ++i) {
    together = together && planes_[i].region == planes_[0].region &&
               planes_[i].offset == planes_[i - 1].offset + planes_[i - 1].size;
  }
  const std::uint32_t apart_fourcc = separate_planes(fourcc);
  std::vector<RawPlane> result;
  for (std::size_t i = 0; i < planes_.size(); ++i) {
    const Plane& plane = planes_[i];
    const std::size_t used = i < bytes_used.size() ? std::min(bytes_used[i], plane.size) : 0;
    if (i > 0 && together) {
      // The planes before are full: V4L2 counts the bytes of all of them as one.
      const std::size_t before = plane.offset - planes_[0].offset;
      const bool full = result[0].bytes.size() == before;
      if (full) result[0].bytes = {result[0].bytes.data(), before + used};
      continue;
    }
    // Three planes have their chroma in half the width; two have pairs of it.
    const std::size_t stride =
        i == 0 || planes_.size() == 2 ? stride_bytes : (stride_bytes + 1) / 2;
    result.push_back({{regions_[plane.region].data + plane.offset, used}, stride});
  }
  if (planes_.size() > 1 && !together) fourcc = apart_fourcc;
  return result;
}

}  // namespace corvid
