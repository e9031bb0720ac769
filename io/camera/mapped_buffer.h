#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "corvid/error.h"
#include "io/camera/raw_image.h"

namespace libcamera {
class FrameBuffer;
}  // namespace libcamera

namespace corvid {

/// A buffer of libcamera's, mapped for reading until destruction.
class MappedBuffer {
 public:
  /// Errors: io (it cannot be mapped).
  [[nodiscard]] static Expected<MappedBuffer> map(const libcamera::FrameBuffer& buffer);
  ~MappedBuffer();
  MappedBuffer(MappedBuffer&& other) noexcept;
  MappedBuffer& operator=(MappedBuffer&&) = delete;

  /// Call these around reading: what device and processor see of the memory is made the same.
  void begin_read() const;
  void end_read() const;

  /// The planes as convert_raw() wants them for V4L2's `fourcc`: one where they follow one another
  /// in memory, as V4L2's formats of one plane have them. Where they lie apart, `fourcc` becomes
  /// that of the format's separate planes.
  /// @param bytes_used    of each of the buffer's planes.
  /// @param stride_bytes  of the first plane.
  [[nodiscard]] std::vector<RawPlane> planes(std::span<const std::size_t> bytes_used,
                                             std::size_t stride_bytes, std::uint32_t& fourcc) const;

 private:
  MappedBuffer() = default;
  /// The memory behind one file descriptor.
  struct Region {
    int fd = -1;
    std::uint8_t* data = nullptr;
    std::size_t size = 0;
  };
  struct Plane {
    std::size_t region = 0;
    std::size_t offset = 0, size = 0;
  };
  void synchronise(std::uint64_t flags) const;

  std::vector<Region> regions_;
  std::vector<Plane> planes_;
};

}  // namespace corvid
