#include "io/ffv1_encoder.h"

#include <fmt/format.h>

#include <cstring>
#include <utility>

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavutil/opt.h>
}

namespace corvid {

struct Ffv1Encoder::Context {
  AVCodecContext* codec = nullptr;
  AVFrame* frame = nullptr;
  AVPacket* packet = nullptr;
  std::int64_t count = 0;
  ~Context() {
    av_packet_free(&packet);
    av_frame_free(&frame);
    avcodec_free_context(&codec);
  }
};

Ffv1Encoder::Ffv1Encoder(int width_px, int height_px, bool colour)
    : width_px_(width_px), height_px_(height_px), colour_(colour) {}
Ffv1Encoder::~Ffv1Encoder() = default;

Expected<std::unique_ptr<Ffv1Encoder>> Ffv1Encoder::create(int width_px, int height_px,
                                                           bool colour) {
  std::unique_ptr<Ffv1Encoder> encoder(new Ffv1Encoder(width_px, height_px, colour));
  auto context = encoder->make_context();
  if (!context) return tl::unexpected(context.error());
  encoder->idle_.push_back(std::move(*context));
  return encoder;
}

Expected<std::unique_ptr<Ffv1Encoder::Context>> Ffv1Encoder::make_context() const {
  auto context = std::make_unique<Context>();
  const AVCodec* codec = avcodec_find_encoder(AV_CODEC_ID_FFV1);
  if (codec == nullptr)
    return fail(ErrorCode::unsupported, "this FFmpeg has no FFV1 encoder", "FFV1",
                "record as a folder, or install a whole FFmpeg");
  context->codec = avcodec_alloc_context3(codec);
  context->frame = av_frame_alloc();
  context->packet = av_packet_alloc();
  AVCodecContext& c = *context->codec;
  c.width = width_px_;
  c.height = height_px_;
  c.pix_fmt = colour_ ? AV_PIX_FMT_BGR0 : AV_PIX_FMT_GRAY8;
  c.color_range = AVCOL_RANGE_JPEG;
  c.time_base = {1, 1000};
  c.gop_size = 1;  // no packet leans on an older one, which another thread may have made
  c.level = 3;
  c.thread_count = 1;
  c.slices = 4;
  av_opt_set_int(c.priv_data, "slicecrc", 1, 0);
  AVFrame& f = *context->frame;
  f.width = width_px_;
  f.height = height_px_;
  f.format = c.pix_fmt;
  if (avcodec_open2(&c, codec, nullptr) < 0 || av_frame_get_buffer(&f, 0) < 0) {
    return fail(ErrorCode::unsupported,
                fmt::format("FFV1 does not take pictures of {} x {} px", width_px_, height_px_),
                "FFV1", "record as a folder");
  }
  return context;
}

Expected<void> Ffv1Encoder::describe(AVCodecParameters& parameters) {
  const std::scoped_lock lock(mutex_);
  if (avcodec_parameters_from_context(&parameters, idle_.front()->codec) < 0)
    return fail(ErrorCode::io, "out of memory", "FFV1");
  return {};
}

Expected<std::vector<std::uint8_t>> Ffv1Encoder::encode(const Frame& frame) {
  std::unique_ptr<Context> context;
  {
    const std::scoped_lock lock(mutex_);
    if (!idle_.empty()) {
      context = std::move(idle_.back());
      idle_.pop_back();
    }
  }
  if (!context) {
    auto made = make_context();
    if (!made) return tl::unexpected(made.error());
    context = std::move(*made);
  }
  const auto failed = [&] {
    return fail(ErrorCode::io, fmt::format("frame {} cannot be encoded", frame.id.value), "FFV1");
  };
  AVFrame& f = *context->frame;
  if (av_frame_make_writable(&f) < 0) return failed();
  for (int y = 0; y < height_px_; ++y) {
    std::uint8_t* to = f.data[0] + static_cast<std::ptrdiff_t>(y) * f.linesize[0];
    if (!colour_) {
      std::memcpy(to, frame.grey.row(y), static_cast<std::size_t>(width_px_));
      continue;
    }
    for (const Rgb8 *p = frame.colour.row(y), *end = p + width_px_; p != end; ++p, to += 4) {
      to[0] = p->b;
      to[1] = p->g;
      to[2] = p->r;
      to[3] = 0;
    }
  }
  f.pts = context->count++;
  if (avcodec_send_frame(context->codec, &f) < 0 ||
      avcodec_receive_packet(context->codec, context->packet) < 0)
    return failed();
  std::vector<std::uint8_t> bytes(context->packet->data,
                                  context->packet->data + context->packet->size);
  av_packet_unref(context->packet);
  const std::scoped_lock lock(mutex_);
  idle_.push_back(std::move(context));
  return bytes;
}

}  // namespace corvid
