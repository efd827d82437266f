// libav (FFmpeg's libraries), loaded when a session first reads or writes a video, and its objects
// with their deleters. Linking libav and the 95 libraries behind it would double the time that the
// program takes to start.
#pragma once

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/crc.h>
#include <libavutil/error.h>
#include <libavutil/mem.h>
#include <libavutil/pixdesc.h>
#include <libavutil/sha.h>
#include <libswscale/swscale.h>
}

#include <array>
#include <cerrno>
#include <initializer_list>
#include <memory>
#include <string>
#include <utility>

#include "core/error.hpp"

// All functions of libav that the program calls, with the library of each.
#define PENUMBRA_LIBAV_FUNCTIONS(FUNCTION)           \
  FUNCTION(avutil, av_crc)                           \
  FUNCTION(avutil, av_crc_get_table)                 \
  FUNCTION(avutil, av_d2q)                           \
  FUNCTION(avutil, av_dict_free)                     \
  FUNCTION(avutil, av_dict_set)                      \
  FUNCTION(avutil, av_frame_alloc)                   \
  FUNCTION(avutil, av_frame_free)                    \
  FUNCTION(avutil, av_frame_get_buffer)              \
  FUNCTION(avutil, av_frame_make_writable)           \
  FUNCTION(avutil, av_free)                          \
  FUNCTION(avutil, av_get_pix_fmt_name)              \
  FUNCTION(avutil, av_log_format_line2)              \
  FUNCTION(avutil, av_log_set_callback)              \
  FUNCTION(avutil, av_pix_fmt_count_planes)          \
  FUNCTION(avutil, av_pix_fmt_desc_get)              \
  FUNCTION(avutil, av_rescale_rnd)                   \
  FUNCTION(avutil, av_sha_alloc)                     \
  FUNCTION(avutil, av_sha_final)                     \
  FUNCTION(avutil, av_sha_init)                      \
  FUNCTION(avutil, av_sha_update)                    \
  FUNCTION(avutil, av_strerror)                      \
  FUNCTION(avcodec, av_packet_alloc)                 \
  FUNCTION(avcodec, av_packet_clone)                 \
  FUNCTION(avcodec, av_packet_free)                  \
  FUNCTION(avcodec, av_packet_rescale_ts)            \
  FUNCTION(avcodec, av_packet_unref)                 \
  FUNCTION(avcodec, avcodec_alloc_context3)          \
  FUNCTION(avcodec, avcodec_find_decoder)            \
  FUNCTION(avcodec, avcodec_find_encoder)            \
  FUNCTION(avcodec, avcodec_find_encoder_by_name)    \
  FUNCTION(avcodec, avcodec_free_context)            \
  FUNCTION(avcodec, avcodec_get_name)                \
  FUNCTION(avcodec, avcodec_open2)                   \
  FUNCTION(avcodec, avcodec_parameters_from_context) \
  FUNCTION(avcodec, avcodec_parameters_to_context)   \
  FUNCTION(avcodec, avcodec_receive_frame)           \
  FUNCTION(avcodec, avcodec_receive_packet)          \
  FUNCTION(avcodec, avcodec_send_frame)              \
  FUNCTION(avcodec, avcodec_send_packet)             \
  FUNCTION(avformat, av_find_input_format)           \
  FUNCTION(avformat, av_interleaved_write_frame)     \
  FUNCTION(avformat, av_read_frame)                  \
  FUNCTION(avformat, av_write_frame)                 \
  FUNCTION(avformat, av_write_trailer)               \
  FUNCTION(avformat, avformat_alloc_output_context2) \
  FUNCTION(avformat, avformat_close_input)           \
  FUNCTION(avformat, avformat_find_stream_info)      \
  FUNCTION(avformat, avformat_free_context)          \
  FUNCTION(avformat, avformat_new_stream)            \
  FUNCTION(avformat, avformat_open_input)            \
  FUNCTION(avformat, avformat_write_header)          \
  FUNCTION(avformat, avio_closep)                    \
  FUNCTION(avformat, avio_flush)                     \
  FUNCTION(avformat, avio_open)                      \
  FUNCTION(avformat, avio_seek)                      \
  FUNCTION(swscale, sws_freeContext)                 \
  FUNCTION(swscale, sws_getCoefficients)             \
  FUNCTION(swscale, sws_getContext)                  \
  FUNCTION(swscale, sws_scale)                       \
  FUNCTION(swscale, sws_setColorspaceDetails)

namespace penumbra {

// Pointers with the functions' own names, which hide the declarations of libav in this namespace.
// nullptr until load_libav() succeeds.
#define PENUMBRA_DECLARE(library, name) extern decltype(&::name) name;
PENUMBRA_LIBAV_FUNCTIONS(PENUMBRA_DECLARE)
#undef PENUMBRA_DECLARE

// Loads the libraries in the first call; their messages go to the log. Thread-safe. Call it before
// any other function of libav.
[[nodiscard]] Result<void> load_libav();

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
