// libav's objects with their deleters.
#pragma once

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/error.h>
}

#include <array>
#include <cerrno>
#include <initializer_list>
#include <memory>
#include <string>
#include <utility>

namespace penumbra {

struct FreeAv {
  void operator()(AVCodecContext* codec) const { avcodec_free_context(&codec); }
  void operator()(AVPacket* packet) const { av_packet_free(&packet); }
  void operator()(AVFrame* frame) const { av_frame_free(&frame); }
};
template <class T>
using Av = std::unique_ptr<T, FreeAv>;

struct CloseAvInput {
  void operator()(AVFormatContext* input) const { avformat_close_input(&input); }
};
using AvInput = std::unique_ptr<AVFormatContext, CloseAvInput>;

// Closes the written file and frees the muxer.
struct CloseAvOutput {
  void operator()(AVFormatContext* output) const {
    avio_closep(&output->pb);
    avformat_free_context(output);
  }
};
using AvOutput = std::unique_ptr<AVFormatContext, CloseAvOutput>;

// Returns libav's message for a negative result.
inline std::string av_error_text(int error) {
  std::array<char, AV_ERROR_MAX_STRING_SIZE> text{};
  av_strerror(error, text.data(), text.size());
  return text.data();
}

// A video file being encoded. All functions return a negative libav error on failure.
struct AvEncoding {
  AvOutput muxer;
  Av<AVCodecContext> encoder;
  Av<AVFrame> image;
  Av<AVPacket> packet;

  int allocate(const AVCodec* codec, const char* container, const std::string& file) {
    AVFormatContext* made = nullptr;
    const int error = avformat_alloc_output_context2(&made, nullptr, container, file.c_str());
    muxer.reset(made);
    encoder.reset(avcodec_alloc_context3(codec));
    image.reset(av_frame_alloc());
    packet.reset(av_packet_alloc());
    if (error < 0) return error;
    return encoder && image && packet ? 0 : AVERROR(ENOMEM);
  }
  // Call this after the settings of `encoder` are complete.
  int open_encoder(std::initializer_list<std::pair<const char*, const char*>> options) {
    AVDictionary* dictionary = nullptr;
    for (const auto& [name, value] : options) av_dict_set(&dictionary, name, value, 0);
    const int error = avcodec_open2(encoder.get(), encoder->codec, &dictionary);
    av_dict_free(&dictionary);
    return error;
  }
  // Allocates the buffer of `image` in the encoder's format.
  int allocate_image() {
    image->format = encoder->pix_fmt;
    image->width = encoder->width;
    image->height = encoder->height;
    image->colorspace = encoder->colorspace;
    image->color_primaries = encoder->color_primaries;
    image->color_trc = encoder->color_trc;
    image->color_range = encoder->color_range;
    return av_frame_get_buffer(image.get(), 0);
  }
  int add_stream() {
    AVStream* stream = avformat_new_stream(muxer.get(), nullptr);
    if (stream == nullptr) return AVERROR(ENOMEM);
    stream->time_base = encoder->time_base;
    return avcodec_parameters_from_context(stream->codecpar, encoder.get());
  }
  // Opens the file and writes its header. "file:" prevents libav from reading a colon in the name
  // as the end of a protocol.
  int write_header(const std::string& file, AVDictionary* options = nullptr) {
    int error = avio_open(&muxer->pb, ("file:" + file).c_str(), AVIO_FLAG_WRITE);
    if (error >= 0) error = avformat_write_header(muxer.get(), &options);
    av_dict_free(&options);
    return error;
  }
};

}  // namespace penumbra
