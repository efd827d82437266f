// Reads a whole video with libav: stored images, times and colour tags.
#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "app/libav.hpp"

namespace penumbra::test {

struct DecodedImage {
  double time_s = 0.0;
  // planes one after the other, rows without padding; 0RGB32: 4 bytes B G R X per pixel
  std::vector<std::uint8_t> bytes;
};

struct DecodedVideo {
  bool opened = false;
  std::string container;
  AVCodecID codec = AV_CODEC_ID_NONE;
  AVPixelFormat format = AV_PIX_FMT_NONE;
  int width = 0, height = 0;
  AVColorSpace color_space = AVCOL_SPC_UNSPECIFIED;
  AVColorRange color_range = AVCOL_RANGE_UNSPECIFIED;
  std::vector<DecodedImage> images;
};

inline DecodedVideo decode_video(const std::filesystem::path& file) {
  DecodedVideo video;
  if (!load_libav()) return video;
  AVFormatContext* container = nullptr;
  if (avformat_open_input(&container, file.c_str(), nullptr, nullptr) != 0) return video;
  const AVStream* stream = container->streams[0];
  const AVCodec* codec = avcodec_find_decoder(stream->codecpar->codec_id);
  AVCodecContext* decoder = avcodec_alloc_context3(codec);
  avcodec_parameters_to_context(decoder, stream->codecpar);
  decoder->err_recognition = AV_EF_CRCCHECK | AV_EF_EXPLODE;  // verify FFV1's checksums
  if (avcodec_open2(decoder, codec, nullptr) == 0) {
    video.opened = true;
    video.container = container->iformat->name;
    AVPacket* packet = av_packet_alloc();
    AVFrame* frame = av_frame_alloc();
    bool at_end = false;
    while (!at_end) {
      at_end = av_read_frame(container, packet) < 0;
      avcodec_send_packet(decoder, at_end ? nullptr : packet);
      if (!at_end) av_packet_unref(packet);
      while (avcodec_receive_frame(decoder, frame) == 0) {
        DecodedImage image;
        image.time_s = static_cast<double>(frame->pts) * av_q2d(stream->time_base);
        const bool packed = frame->format == AV_PIX_FMT_0RGB32;
        for (int plane = 0; plane < (packed ? 1 : 3); ++plane) {
          const int width = packed       ? frame->width * 4
                            : plane == 0 ? frame->width
                                         : frame->width / 2;
          const int height = plane == 0 ? frame->height : frame->height / 2;
          for (int y = 0; y < height; ++y) {
            const std::uint8_t* row = frame->data[plane] + y * frame->linesize[plane];
            image.bytes.insert(image.bytes.end(), row, row + width);
          }
        }
        video.format = static_cast<AVPixelFormat>(frame->format);
        video.width = frame->width;
        video.height = frame->height;
        video.color_space = frame->colorspace;
        video.color_range = frame->color_range;
        video.images.push_back(std::move(image));
      }
    }
    video.codec = decoder->codec_id;
    av_frame_free(&frame);
    av_packet_free(&packet);
  }
  avcodec_free_context(&decoder);
  avformat_close_input(&container);
  return video;
}

}  // namespace penumbra::test
