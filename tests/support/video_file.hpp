// Lossless video files for tests, written through libav: FFV1 or raw planes in Matroska.
#pragma once

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/imgutils.h>
#include <libavutil/opt.h>
}

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>

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
  const AVCodec* codec = avcodec_find_encoder(spec.codec);
  if (codec == nullptr) throw std::runtime_error("test video: no encoder");
  struct FreeContext {
    void operator()(AVCodecContext* context) const { avcodec_free_context(&context); }
    void operator()(AVFormatContext* format) const {
      if (format->pb != nullptr) avio_closep(&format->pb);
      avformat_free_context(format);
    }
    void operator()(AVFrame* frame) const { av_frame_free(&frame); }
    void operator()(AVPacket* packet) const { av_packet_free(&packet); }
  };
  const std::unique_ptr<AVCodecContext, FreeContext> encoder(avcodec_alloc_context3(codec));
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
    check(av_opt_set_int(encoder->priv_data, "slicecrc", 1, 0), "slicecrc");
  }
  check(avcodec_open2(encoder.get(), codec, nullptr), "encoder");

  AVFormatContext* opened = nullptr;
  check(avformat_alloc_output_context2(&opened, nullptr, "matroska", file.c_str()), "muxer");
  const std::unique_ptr<AVFormatContext, FreeContext> muxer(opened);
  AVStream* stream = avformat_new_stream(muxer.get(), nullptr);
  check(avcodec_parameters_from_context(stream->codecpar, encoder.get()), "parameters");
  stream->time_base = encoder->time_base;
  check(avio_open(&muxer->pb, file.c_str(), AVIO_FLAG_WRITE), "file");
  check(avformat_write_header(muxer.get(), nullptr), "header");

  const std::unique_ptr<AVPacket, FreeContext> packet(av_packet_alloc());
  const auto drain = [&] {
    while (true) {
      const int status = avcodec_receive_packet(encoder.get(), packet.get());
      if (status == AVERROR(EAGAIN) || status == AVERROR_EOF) return;
      check(status, "encode");
      av_packet_rescale_ts(packet.get(), encoder->time_base, stream->time_base);
      packet->stream_index = 0;
      check(av_interleaved_write_frame(muxer.get(), packet.get()), "write");
    }
  };
  for (int i = 0; i < spec.frames; ++i) {
    const std::unique_ptr<AVFrame, FreeContext> frame(av_frame_alloc());
    frame->width = spec.width;
    frame->height = spec.height;
    frame->format = spec.format;
    frame->pts = i;
    frame->color_range = spec.range;
    frame->colorspace = spec.matrix;
    check(av_frame_get_buffer(frame.get(), 0), "buffer");
    fill(*frame, i);
    check(avcodec_send_frame(encoder.get(), frame.get()), "send");
    drain();
  }
  check(avcodec_send_frame(encoder.get(), nullptr), "flush");
  drain();
  check(av_write_trailer(muxer.get()), "trailer");
}

}  // namespace penumbra::test
