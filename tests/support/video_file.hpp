// Lossless video files for tests, written through libav: FFV1 or raw planes in Matroska.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <stdexcept>
#include <string>

#include "app/libav.hpp"

namespace penumbra::test {

struct VideoSpec {
  AVPixelFormat format = AV_PIX_FMT_YUV420P;
  AVCodecID codec = AV_CODEC_ID_FFV1;
  int width = 64;
  int height = 48;
  int frames = 8;
  int gop = 1;  // frames from key frame to key frame
  AVColorRange range = AVCOL_RANGE_UNSPECIFIED;
  AVColorSpace matrix = AVCOL_SPC_UNSPECIFIED;
};

// Writes a video; `fill` sets the samples of frame `index`. Throws std::runtime_error, which fails
// the test.
inline void write_video(const std::filesystem::path& file, const VideoSpec& spec,
                        const std::function<void(AVFrame&, int index)>& fill) {
  const auto check = [](int status, const char* what) {
    if (status < 0) throw std::runtime_error(std::string("test video: ") + what);
  };
  if (!load_libav()) throw std::runtime_error("test video: no libav");
  AvEncoding av;
  check(av.allocate(avcodec_find_encoder(spec.codec), "matroska", file), "encoder");
  AVCodecContext* const encoder = av.encoder.get();
  encoder->width = spec.width;
  encoder->height = spec.height;
  encoder->pix_fmt = spec.format;
  encoder->time_base = {1, 30};
  encoder->gop_size = spec.gop;
  encoder->color_range = spec.range;
  encoder->colorspace = spec.matrix;
  encoder->thread_count = 1;
  encoder->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  if (spec.codec == AV_CODEC_ID_FFV1) {
    encoder->level = 3;
    encoder->slices = 4;
    check(av.open_encoder({{"slicecrc", "1"}}), "encoder");
  } else {
    check(av.open_encoder({}), "encoder");
  }
  check(av.add_stream(), "stream");
  check(av.write_header(file), "header");
  AVFormatContext* const muxer = av.muxer.get();
  const auto drain = [&] {
    while (true) {
      const int status = avcodec_receive_packet(encoder, av.packet.get());
      if (status == AVERROR(EAGAIN) || status == AVERROR_EOF) return;
      check(status, "encode");
      av_packet_rescale_ts(av.packet.get(), encoder->time_base, muxer->streams[0]->time_base);
      av.packet->stream_index = 0;
      check(av_interleaved_write_frame(muxer, av.packet.get()), "write");
    }
  };
  for (int i = 0; i < spec.frames; ++i) {
    const Av<AVFrame> frame(av_frame_alloc());
    frame->width = spec.width;
    frame->height = spec.height;
    frame->format = spec.format;
    frame->pts = i;
    frame->color_range = spec.range;
    frame->colorspace = spec.matrix;
    check(av_frame_get_buffer(frame.get(), 0), "buffer");
    fill(*frame, i);
    check(avcodec_send_frame(encoder, frame.get()), "send");
    drain();
  }
  check(avcodec_send_frame(encoder, nullptr), "flush");
  drain();
  check(av_write_trailer(muxer), "trailer");
}

}  // namespace penumbra::test
