#include "app/capture/v4l2/v4l2_source.hpp"

#include <linux/videodev2.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <mutex>
#include <tuple>
#include <utility>

#include "app/capture/camera_jpeg.hpp"
#include "app/capture/camera_search.hpp"
#include "app/capture/camera_trouble.hpp"
#include "app/capture/clocks.hpp"
#include "app/capture/frame_clock.hpp"
#include "app/capture/frame_layout.hpp"
#include "app/capture/v4l2/buffer_memory.hpp"
#include "app/capture/v4l2/buffer_ring.hpp"
#include "app/capture/v4l2/v4l2_device.hpp"
#include "app/capture/v4l2/v4l2_setup.hpp"
#include "app/logging.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

// One buffer each: filled by the driver, in its queue, in the mailbox, tracked, drawn and written.
constexpr unsigned kBuffers = 6;
// If the driver has fewer buffers, it would drop frames, so frames are copied instead of lent.
constexpr std::size_t kDriverNeeds = 2;
constexpr int kRetry_ms = 200;  // between attempts to open the camera again
// Maximum number of attempts to start the first stream. A camera just closed may need a moment.
constexpr int kFirstTries = 3;
// Interval between searches of all devices while the camera is missing and no device is added.
constexpr std::int64_t kSearchInterval_ns = 2'000'000'000;

struct KnownFormat {
  std::uint32_t fourcc;
  const char* option;  // value of --format
  const char* name;
  PixelFormat pixels;  // unused for JPEG
  bool jpeg;
};
// In ascending order of a frame's cost: read in place, unpacked, decoded. Grey is cheapest but
// comes last, because it is meant for cameras without colour.
constexpr std::array<KnownFormat, 6> kFormats{{
    {V4L2_PIX_FMT_NV12, "nv12", "NV12", PixelFormat::nv12, false},
    {V4L2_PIX_FMT_YUV420, "yu12", "YU12", PixelFormat::yuv420p, false},
    {V4L2_PIX_FMT_YUYV, "yuyv", "YUYV", PixelFormat::yuyv, false},
    {V4L2_PIX_FMT_MJPEG, "mjpeg", "MJPEG", PixelFormat::yuv420p, true},
    {V4L2_PIX_FMT_JPEG, "mjpeg", "JPEG", PixelFormat::yuv420p, true},
    {V4L2_PIX_FMT_GREY, "grey", "GREY", PixelFormat::grey8, false},
}};

tl::unexpected<StreamError> trouble(const V4l2Device& device, const char* call, int error) {
  return tl::unexpected<StreamError>(
      {fault_of(error), v4l2_call_error(device.path(), call, error)});
}

FrameLayout layout_of(const KnownFormat& known, const v4l2_pix_format& granted) {
  FrameLayout layout = frame_layout(known.pixels, static_cast<int>(granted.width),
                                    static_cast<int>(granted.height), granted.bytesperline);
  const VideoColors colors =
      v4l2_colors(granted.colorspace, granted.ycbcr_enc, granted.quantization);
  layout.frame.color_matrix = colors.matrix;
  layout.frame.color_range = colors.range;
  return layout;
}

// Returns the exposure time [s]; nullopt if it is automatic and so may differ between frames.
std::optional<double> exposure_in_effect(const V4l2Device& device) {
  const auto mode = device.control(V4L2_CID_EXPOSURE_AUTO);
  if (mode && *mode != V4L2_EXPOSURE_MANUAL && *mode != V4L2_EXPOSURE_SHUTTER_PRIORITY) {
    return std::nullopt;
  }
  const auto steps = device.control(V4L2_CID_EXPOSURE_ABSOLUTE);
  constexpr double kStep_s = 1e-4;
  return steps && *steps > 0 ? std::optional(kStep_s * *steps) : std::nullopt;
}

// A streaming device with its buffers. The destructor stops the stream; buffers in use stay mapped.
class Stream {
 public:
  // `as_before`: if given, only this format is accepted. `settings`: control values to restore;
  // requested values take precedence.
  static StreamResult<std::unique_ptr<Stream>> start(
      V4l2Device device, const V4l2Options& options, const std::optional<StreamFormat>& as_before,
      const std::vector<V4l2Setting>& settings = {}) {
    std::unique_ptr<Stream> stream(new Stream(std::move(device)));
    if (!as_before) reset_view(*stream->device_);
    PENUMBRA_TRY_VOID(stream->set_format(options, as_before));
    stream->set_rate(options.fps);
    // Read before restore(), which switches autofocus off as in the previous stream.
    stream->autofocus_before_ = stream->device_->control(V4L2_CID_FOCUS_AUTO);
    stream->device_->restore(settings);
    set_controls(*stream->device_, options.controls, !as_before);
    stream->focus_ = stream->device_->control(V4L2_CID_FOCUS_ABSOLUTE);
    stream->exposure_s_ = exposure_in_effect(*stream->device_);
    PENUMBRA_TRY_VOID(stream->map_buffers(options.dma_buf));
    if (!stream->ring_->queue_all()) return trouble(*stream->device_, "VIDIOC_QBUF", EINVAL);
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (const int error = stream->device_->call(VIDIOC_STREAMON, &type); error != 0) {
      return trouble(*stream->device_, "VIDIOC_STREAMON", error);
    }
    return stream;
  }
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;
  ~Stream() {
    if (ring_) ring_->close();
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    (void)device_->call(VIDIOC_STREAMOFF, &type);
    // Frees the device for other programs and for a restart, even if frames still map its memory.
    unsigned none = 0;
    (void)device_->request_buffers(none);
    // Restores the camera's autofocus for other programs.
    if (autofocus_before_ && *autofocus_before_ != 0) {
      (void)device_->set_control(V4L2_CID_FOCUS_AUTO, *autofocus_before_);
    }
  }

  [[nodiscard]] const std::shared_ptr<const V4l2Device>& device() const { return device_; }
  [[nodiscard]] BufferRing& ring() { return *ring_; }
  [[nodiscard]] const StreamFormat& format() const { return format_; }
  // Exposure time of every frame; nullopt under automatic exposure.
  [[nodiscard]] std::optional<double> exposure_s() const { return exposure_s_; }
  // The locked focus, in the camera's steps; nullopt if the camera does not report it.
  [[nodiscard]] std::optional<double> focus() const { return focus_; }
  [[nodiscard]] const KnownFormat& known() const { return *known_; }
  [[nodiscard]] const FrameLayout& layout() const { return layout_; }
  [[nodiscard]] const BufferMemory& buffer(unsigned index) const { return (*buffers_)[index]; }
  // Errno with which the driver last refused a buffer.
  [[nodiscard]] int refusal() const { return refusal_; }
  [[nodiscard]] bool shares() const { return buffer(0).is_shared(); }

 private:
  explicit Stream(V4l2Device device)
      : device_(std::make_shared<const V4l2Device>(std::move(device))) {}

  StreamResult<void> choose(const V4l2Options& options,
                            const std::optional<StreamFormat>& as_before) {
    using Merit = std::tuple<bool, double, int>;  // has the size, rate [1/s], -cost
    std::optional<Merit> best;
    for (const V4l2Format& offered : device_->formats()) {
      const auto known = std::ranges::find(kFormats, offered.fourcc, &KnownFormat::fourcc);
      if (known == kFormats.end()) continue;
      if (as_before && as_before->name != known->name) continue;
      if (options.format && *options.format != known->option) continue;
      bool has_size = offered.sizes.empty();  // an empty list counts as any size
      double rate = options.fps;
      for (const V4l2Size& size : offered.sizes) {
        if (!size.covers(options.width, options.height)) continue;
        has_size = true;
        if (!size.rates.empty()) rate = size.fastest();
      }
      constexpr double kEqualRates = 0.95;  // ratio of rates that count as equal (29.97 and 30)
      int cost = static_cast<int>(known - kFormats.begin());
      if (options.recording && known->jpeg) cost = -1;
      const Merit merit(has_size, rate >= kEqualRates * options.fps ? options.fps : rate, -cost);
      if (!best || merit > *best) {
        best = merit;
        known_ = &*known;
      }
    }
    if (best) return {};
    return fail_with(CaptureFault::wrong_format, "{}",
                     no_format_text(device_->path(), device_->formats(),
                                    as_before ? as_before->name : options.format.value_or("")));
  }

  StreamResult<void> set_format(const V4l2Options& options,
                                const std::optional<StreamFormat>& as_before) {
    PENUMBRA_TRY_VOID(choose(options, as_before));
    v4l2_format requested{};
    requested.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    requested.fmt.pix.width = static_cast<std::uint32_t>(options.width);
    requested.fmt.pix.height = static_cast<std::uint32_t>(options.height);
    requested.fmt.pix.pixelformat = known_->fourcc;
    requested.fmt.pix.field = V4L2_FIELD_NONE;
    if (const int error = device_->call(VIDIOC_S_FMT, &requested); error != 0) {
      return trouble(*device_, "VIDIOC_S_FMT", error);
    }
    const v4l2_pix_format& granted = requested.fmt.pix;
    format_.name = known_->name;
    format_.width = static_cast<int>(granted.width);
    format_.height = static_cast<int>(granted.height);
    const bool same =
        !as_before || (as_before->width == format_.width && as_before->height == format_.height);
    if (granted.pixelformat != known_->fourcc || !same || granted.width == 0 ||
        granted.height == 0) {
      return fail_with(CaptureFault::wrong_format,
                       "{}: grants {}x{} {} for {}x{} {}; choose another --size or --format",
                       device_->path().string(), granted.width, granted.height,
                       fourcc_text(granted.pixelformat), options.width, options.height,
                       known_->name);
    }
    if (const auto problem = field_problem(granted.field)) {
      return fail_with(CaptureFault::wrong_format,
                       "{0}: {1}; choose a progressive size or input (penumbra devices, v4l2-ctl "
                       "-d {0} --list-inputs)",
                       device_->path().string(), *problem);
    }
    if (auto filled = fill_frame(*device_, granted.width, granted.height); !filled) {
      return fail_with(CaptureFault::wrong_format, "{}", filled.error().message);
    }
    if (!known_->jpeg) layout_ = layout_of(*known_, granted);
    return {};
  }

  void set_rate(double fps) {
    v4l2_streamparm parameters{};
    parameters.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    v4l2_fract& interval = parameters.parm.capture.timeperframe;
    interval = {1000, static_cast<std::uint32_t>(std::lround(fps * 1000.0))};
    format_.interval_s = 1.0 / fps;
    // A driver that can't set the rate returns an error and keeps its current rate.
    format_.interval_granted = device_->call(VIDIOC_S_PARM, &parameters) == 0 &&
                               interval.numerator > 0 && interval.denominator > 0;
    if (format_.interval_granted) {
      format_.interval_s = static_cast<double>(interval.numerator) / interval.denominator;
    }
  }

  StreamResult<void> map_buffers(bool share) {
    unsigned count = kBuffers;
    if (const int error = device_->request_buffers(count); error != 0) {
      return trouble(*device_, "VIDIOC_REQBUFS", error);
    }
    if (count < kDriverNeeds) return trouble(*device_, "mapping its buffers", ENOMEM);
    auto buffers = std::make_shared<std::vector<BufferMemory>>();
    std::vector<std::span<const std::uint8_t>> views;
    for (unsigned i = 0; i < count; ++i) {
      auto buffer = BufferMemory::map(*device_, i, share);
      if (!buffer) return trouble(*device_, "mapping its buffers", buffer.error());
      views.push_back(buffer->bytes());
      buffers->push_back(std::move(*buffer));
    }
    buffers_ = buffers;
    const auto return_buffer = [&device = *device_, &refusal = refusal_, buffers](unsigned index) {
      (*buffers)[index].end_reading();
      v4l2_buffer buffer{};
      buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
      buffer.memory = V4L2_MEMORY_MMAP;
      buffer.index = index;
      const int error = device.call(VIDIOC_QBUF, &buffer);
      if (error != 0) refusal = error;
      return error == 0;
    };
    ring_ = BufferRing::create(std::move(views), {return_buffer, [buffers] { buffers->clear(); }});
    return {};
  }

  // The ring uses device_ and refusal_ until the destructor closes it.
  const std::shared_ptr<const V4l2Device> device_;
  std::atomic<int> refusal_ = EINVAL;  // errno of the last refused buffer
  const KnownFormat* known_ = nullptr;
  StreamFormat format_;
  std::optional<double> exposure_s_;
  std::optional<double> focus_;
  std::optional<std::int32_t> autofocus_before_;  // V4L2_CID_FOCUS_AUTO
  FrameLayout layout_;
  std::shared_ptr<const std::vector<BufferMemory>> buffers_;
  std::shared_ptr<BufferRing> ring_;
};

class V4l2Source final : public LiveSource {
 public:
  // `stop`: an eventfd; the source takes ownership.
  V4l2Source(V4l2Options options, std::unique_ptr<Stream> stream, int stop)
      : options_(with_focus(std::move(options), stream->focus())),
        path_(stream->device()->path()),
        card_(stream->device()->identity().card),
        search_(stream->device()->identity()),
        format_(stream->format()),
        shares_(stream->shares()),
        faults_(options_.device.string()),
        clock_(nanoseconds(format_.interval_s)),
        pace_(nanoseconds(format_.interval_s)),
        stop_(stop),
        device_(stream->device()),
        exposure_s_(stream->exposure_s()),
        controls_(device_->controls().value_or(V4l2Controls())),
        stream_(std::move(stream)) {
    check_input();
  }
  ~V4l2Source() override { close(stop_); }

  Result<std::optional<CapturedImage>> next_image() override {
    while (!stopped()) {
      if (!stream_) {
        // Also pauses between streams that fail immediately after their start.
        if (std::exchange(retrying_, true)) wait(kRetry_ms);
        if (!reopen()) continue;
      }
      if (auto image = dequeue()) {
        retrying_ = false;
        return image;
      }
    }
    set_stream(nullptr);
    return std::optional<CapturedImage>();
  }

  void stop() override {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = write(stop_, &one, sizeof(one));
  }
  [[nodiscard]] StreamFormat format() const override { return format_; }
  [[nodiscard]] FaultCounter& faults() override { return faults_; }
  [[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> controls() const override {
    std::shared_ptr<const V4l2Device> device;
    {
      const std::lock_guard lock(mutex_);
      device = device_;
    }
    // Read without the lock, because a device that disappears may answer slowly.
    auto controls = device ? device->controls() : std::nullopt;
    const auto exposure_s = controls ? exposure_in_effect(*device) : std::nullopt;
    const std::lock_guard lock(mutex_);
    if (controls) {
      controls_ = std::move(*controls);
      if (device == device_) exposure_s_ = exposure_s;
    }
    return controls_.named;
  }
  [[nodiscard]] std::optional<FocusReading> focus() const override {
    if (!options_.controls.focus) return std::nullopt;
    return FocusReading{*options_.controls.focus, 1.0};
  }
  [[nodiscard]] std::string description() const override {
    return fmt::format("{} ({}), {} {}x{} at {}{}", options_.device.string(), card_, format_.name,
                       format_.width, format_.height, rate_text(format_),
                       shares_ ? ", buffers shared by DMA-BUF" : "");
  }

 private:
  // A reconnected camera gets the focus that it had when it was first opened.
  static V4l2Options with_focus(V4l2Options options, std::optional<double> focus) {
    if (focus) options.controls.focus = focus;
    return options;
  }

  void check_input() {
    if (const auto problem = input_problem(*stream_->device())) {
      faults_.count(CaptureFault::no_signal, *problem);
    }
  }

  bool stopped() const { return wait(0); }
  // Returns true after stop().
  bool wait(int timeout_ms) const {
    pollfd waiting{stop_, POLLIN, 0};
    return poll(&waiting, 1, timeout_ms) > 0;
  }

  std::nullopt_t lose_stream(CaptureFault fault, const std::string& what,
                             const std::optional<std::string>& hud_text = std::nullopt) {
    outage_.begin({fault, what}, hud_text);
    is_gone_ = is_gone_ || fault == CaptureFault::disconnected;
    set_stream(nullptr);
    search_.begin();
    latest_search_.reset();
    return std::nullopt;
  }

  std::nullopt_t lose_stream(CaptureFault fault, const char* call, int error) {
    if (fault == CaptureFault::disconnected) {
      return lose_stream(fault, std::string(kDisconnected), "the camera was disconnected");
    }
    return lose_stream(
        fault,
        fmt::format("the stream failed ({}: {}); {}", call, message_of(error), kStreamIsRestarted),
        fmt::format("the stream failed: {}", message_of(error)));
  }

  // Finds the camera under its old or a new device number, possibly at another USB port.
  StreamResult<V4l2Device> find() {
    std::vector<std::filesystem::path> paths = {options_.device, path_};
    const bool search_all = should_search_all();
    if (search_all) {
      for (auto& path : list_v4l2_paths()) paths.push_back(std::move(path));
    }
    std::optional<StreamError> first;
    std::vector<V4l2Device> connected;
    std::vector<V4l2Identity> identities;
    for (const auto& path : paths) {
      auto device = V4l2Device::open(path);
      if (device) {
        if (search_.is_at_known_address(device->identity())) return std::move(*device);
        identities.push_back(device->identity());
        connected.push_back(std::move(*device));
      } else if (!first) {
        const bool exists = access(path.c_str(), F_OK) == 0;
        const bool allowed = exists && access(path.c_str(), R_OK | W_OK) == 0;
        first =
            StreamError{exists && !allowed ? CaptureFault::forbidden : CaptureFault::disconnected,
                        device.error().message};
      }
    }
    if (search_all) {
      if (const auto found = search_.find(identities)) return std::move(connected[*found]);
    }
    if (first) return tl::unexpected(*first);
    return fail_with(CaptureFault::disconnected,
                     "{}: is another camera now; connect the one that was used, or start again "
                     "with this one",
                     options_.device.string());
  }

  // Returns true if find() should open every device: immediately after the camera was lost, when a
  // device was added or removed or its owner changed, and every kSearchInterval_ns.
  bool should_search_all() {
    std::string listing;
    for (const auto& path : list_v4l2_paths()) {
      struct stat about {};
      if (stat(path.c_str(), &about) != 0) continue;
      listing += fmt::format("{} {} {}.{}\n", path.string(), about.st_rdev, about.st_ctim.tv_sec,
                             about.st_ctim.tv_nsec);
    }
    const std::int64_t now_ns = monotonic_ns();
    if (latest_search_ && latest_search_->first == listing &&
        now_ns - latest_search_->second < kSearchInterval_ns) {
      return false;
    }
    latest_search_.emplace(std::move(listing), now_ns);
    return true;
  }

  // Takes the lock, because other threads read the running stream's device.
  void set_stream(std::unique_ptr<Stream> stream) {
    {
      const std::lock_guard lock(mutex_);
      device_ = stream ? stream->device() : nullptr;
      if (stream) exposure_s_ = stream->exposure_s();
    }
    stream_ = std::move(stream);
  }

  bool reopen() {
    auto started = find().and_then([&](V4l2Device device) {
      // A camera loses its settings when it loses power.
      std::vector<V4l2Setting> settings;
      if (is_gone_) {
        const std::lock_guard lock(mutex_);
        settings = controls_.settings;
      }
      return Stream::start(std::move(device), options_, format_, settings);
    });
    if (!started) {
      outage_.begin(started.error());
      is_gone_ = is_gone_ || started.error().fault == CaptureFault::disconnected;
      return false;
    }
    latest_search_.reset();
    is_gone_ = false;
    set_stream(std::move(*started));
    path_ = stream_->device()->path();
    clock_.restart(nanoseconds(stream_->format().interval_s));
    pace_.restart(nanoseconds(stream_->format().interval_s));
    faults_.count_restart();
    check_input();
    return true;
  }

  // Returns the next good image, or nullopt on a fault.
  std::optional<CapturedImage> dequeue() {
    std::array<pollfd, 2> waiting{
        {{stream_->device()->descriptor(), POLLIN, 0}, {stop_, POLLIN, 0}}};
    constexpr std::int64_t kMs_ns = 1'000'000;
    const std::int64_t silent_ms = pace_.stall_timeout_ns() / kMs_ns;
    const int ready = poll(waiting.data(), waiting.size(), static_cast<int>(silent_ms));
    if (ready < 0 || waiting[1].revents != 0) return std::nullopt;
    if (ready == 0) {
      return lose_stream(CaptureFault::silent,
                         fmt::format("the stream stalled: no frame and no error for {:.2g} s; {}",
                                     1e-3 * static_cast<double>(silent_ms), kStreamIsRestarted),
                         "the stream stalled");
    }
    if (stream_->ring().refused()) {
      // The driver may report a failed or lost device here before VIDIOC_DQBUF does.
      const int error = stream_->refusal();
      return lose_stream(fault_of(error), "VIDIOC_QBUF", error);
    }
    v4l2_buffer buffer{};
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = V4L2_MEMORY_MMAP;
    const int error = stream_->device()->call(VIDIOC_DQBUF, &buffer);
    if (error == EAGAIN && (waiting[0].revents & (POLLERR | POLLHUP)) == 0) return std::nullopt;
    if (error != 0) {
      return lose_stream(fault_of(error == EAGAIN ? EIO : error), "VIDIOC_DQBUF",
                         error == EAGAIN ? EIO : error);
    }
    if (buffer.index >= stream_->ring().size()) {
      return lose_stream(
          CaptureFault::io_error,
          fmt::format("the driver returned a buffer that does not exist; {}", kStreamIsRestarted));
    }
    return receive(buffer);
  }

  std::optional<CapturedImage> skip(CapturedImage image, CaptureFault fault,
                                    std::string_view what) {
    faults_.count(fault, what);
    image.owner.reset();
    (void)wait(static_cast<int>(bad_frame_pause(format_.interval_s).count()));
    return std::nullopt;
  }

  std::optional<CapturedImage> receive(const v4l2_buffer& buffer) {
    CapturedImage image;
    image.owner = stream_->ring().lend(buffer.index);

    const std::int64_t driver_ns = static_cast<std::int64_t>(
        static_cast<std::uint64_t>(buffer.timestamp.tv_sec) * std::uint64_t{1'000'000'000} +
        static_cast<std::uint64_t>(buffer.timestamp.tv_usec) * 1000U);
    const bool monotonic =
        (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
    const FrameStamp stamp = clock_.next(buffer.sequence, driver_ns, monotonic, monotonic_ns());
    image.sequence = stamp.sequence;
    image.timestamp_ns = stamp.timestamp_ns;
    image.utc_ns = utc_at(stamp.timestamp_ns);
    {
      const std::lock_guard lock(mutex_);
      image.exposure_s = exposure_s_;
    }
    count_stamp(faults_, stamp, format_);
    pace_.observe(stamp.timestamp_ns);

    if ((buffer.flags & V4L2_BUF_FLAG_ERROR) != 0 || buffer.bytesused == 0) {
      return skip(
          std::move(image), CaptureFault::error_frame,
          fmt::format("a frame that the driver marked as bad is skipped; {}", kImproveTransfer));
    }
    stream_->buffer(buffer.index).begin_reading();
    auto bytes = stream_->ring().buffer(buffer.index);
    bytes = bytes.first(std::min<std::size_t>(bytes.size(), buffer.bytesused));
    if (stream_->known().jpeg) {
      auto received = receive_camera_jpeg(bytes, {format_.width, format_.height});
      if (!received) {
        return skip(std::move(image), received.error().fault, received.error().message);
      }
      bytes = received->bytes;
      if (received->frame) image.frame = std::move(*received->frame);
    } else if (bytes.size() < stream_->layout().bytes) {
      return skip(std::move(image), CaptureFault::error_frame,
                  fmt::format("a frame with too few bytes is skipped; {}", kImproveTransfer));
    }

    const bool copied = stream_->ring().in_driver() < kDriverNeeds;
    if (copied) {
      const std::shared_ptr<std::uint8_t[]> copy(new std::uint8_t[bytes.size()]);
      std::memcpy(copy.get(), bytes.data(), bytes.size());
      bytes = {copy.get(), bytes.size()};
      image.owner = copy;
    }
    if (stream_->known().jpeg) {
      image.jpeg = bytes;
    } else {
      image.frame = stream_->layout().frame;
      for (std::size_t i = 0; i < static_cast<std::size_t>(image.frame.plane_count); ++i) {
        image.frame.planes[i].data = bytes.data() + stream_->layout().offset[i];
      }
      if (const BufferMemory& memory = stream_->buffer(buffer.index);
          memory.is_shared() && !copied) {
        image.frame.dma_buf = {memory.descriptor(), memory.number(), stream_->layout().offset};
      }
      image.frame.sequence = image.sequence;
      image.frame.timestamp_ns = image.timestamp_ns;
    }
    if (outage_.end()) log_info("{}: frames come again", options_.device.string());
    faults_.count_frame();
    return image;
  }

  const V4l2Options options_;
  std::filesystem::path path_;  // current device of the camera
  const std::string card_;
  CameraSearch search_;
  std::optional<std::pair<std::string, std::int64_t>> latest_search_;  // device listing, time [ns]
  const StreamFormat format_;
  const bool shares_;  // the first stream shared its buffers
  FaultCounter faults_;
  Outage outage_{faults_};
  FrameClock clock_;
  FramePace pace_;
  const int stop_;         // an eventfd
  bool retrying_ = false;  // no frame arrived since the restart
  bool is_gone_ = false;   // the camera was unplugged since the last stream
  mutable std::mutex mutex_;
  std::shared_ptr<const V4l2Device> device_;  // device of the running stream; guarded by mutex_
  // Latest values; guarded by mutex_.
  mutable std::optional<double> exposure_s_;
  mutable V4l2Controls controls_;
  std::unique_ptr<Stream> stream_;
};

}  // namespace

VideoColors v4l2_colors(std::uint32_t colorspace, std::uint32_t ycbcr_enc,
                        std::uint32_t quantization) {
  const std::uint32_t encoding = ycbcr_enc != V4L2_YCBCR_ENC_DEFAULT
                                     ? ycbcr_enc
                                     : std::uint32_t{V4L2_MAP_YCBCR_ENC_DEFAULT(colorspace)};
  const bool bt601 = encoding == V4L2_YCBCR_ENC_601 || encoding == V4L2_YCBCR_ENC_XV601;
  const std::uint32_t range =
      quantization != V4L2_QUANTIZATION_DEFAULT
          ? quantization
          : std::uint32_t{V4L2_MAP_QUANTIZATION_DEFAULT(false, colorspace, encoding)};
  return {bt601 ? ColorMatrix::bt601 : ColorMatrix::bt709,
          range == V4L2_QUANTIZATION_FULL_RANGE ? ColorRange::full : ColorRange::limited};
}

bool reads_v4l2_format(std::uint32_t fourcc) {
  return std::ranges::find(kFormats, fourcc, &KnownFormat::fourcc) != kFormats.end();
}

Result<std::unique_ptr<LiveSource>> open_v4l2_source(const V4l2Options& options) {
  for (int attempt = 1;; ++attempt) {
    PENUMBRA_TRY(auto device, V4l2Device::open(options.device));
    auto stream = Stream::start(std::move(device), options, std::nullopt);
    if (stream) {
      const int stop = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
      if (stop >= 0) return std::make_unique<V4l2Source>(options, std::move(*stream), stop);
      return fail("{}: {}; close other programs, or raise the limit of open files (ulimit -n)",
                  options.device.string(), message_of(errno));
    }
    const CaptureFault fault = stream.error().fault;
    const bool again = fault == CaptureFault::refused || fault == CaptureFault::io_error;
    if (!again || attempt == kFirstTries) return fail("{}", stream.error().message);
    log_warning("{}; trying again", stream.error().message);
    poll(nullptr, 0, kRetry_ms);
  }
}

}  // namespace penumbra
