#include "app/capture/libcamera_source.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <libcamera/camera.h>
#include <libcamera/camera_manager.h>
#include <libcamera/control_ids.h>
#include <libcamera/formats.h>
#include <libcamera/framebuffer_allocator.h>
#include <libcamera/logging.h>
#include <libcamera/property_ids.h>
#include <libcamera/request.h>
#include <libcamera/transform.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <filesystem>
#include <functional>
#include <map>
#include <mutex>
#include <type_traits>
#include <utility>

#include "app/capture/camera_jpeg.hpp"
#include "app/capture/camera_trouble.hpp"
#include "app/capture/clocks.hpp"
#include "app/capture/frame_clock.hpp"
#include "app/capture/frame_layout.hpp"
#include "app/capture/libcamera_versions.hpp"
#include "app/capture/v4l2/buffer_memory.hpp"
#include "app/capture/v4l2/buffer_ring.hpp"
#include "app/logging.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

namespace lc = libcamera;

// v4l2_source.cpp explains the first two constants.
constexpr unsigned kBuffers = 6;
constexpr std::size_t kDriverNeeds = 2;
constexpr auto kRetry = std::chrono::milliseconds(500);  // an attempt enumerates all cameras
constexpr std::uint64_t kMaxBufferBytes = std::uint64_t{1} << 30U;  // largest size of one buffer

struct KnownFormat {
  lc::PixelFormat format;
  const char* option;  // value of --format
  const char* name;
  PixelFormat pixels;  // unused for JPEG
  bool jpeg;
};
// In ascending order of a frame's cost; see v4l2_source.cpp.
const std::array<KnownFormat, 6>& known_formats() {
  static const std::array<KnownFormat, 6> kFormats{{
      {lc::formats::NV12, "nv12", "NV12", PixelFormat::nv12, false},
      {lc::formats::YUV420, "yu12", "YU12", PixelFormat::yuv420p, false},
      {lc::formats::YUYV, "yuyv", "YUYV", PixelFormat::yuyv, false},
      {lc::formats::MJPEG, "mjpeg", "MJPEG", PixelFormat::yuv420p, true},
      // libcamera's name lists the most significant byte first: in memory it is R, G, B.
      {lc::formats::BGR888, "rgb", "RGB", PixelFormat::rgb24, false},
      {lc::formats::R8, "grey", "GREY", PixelFormat::grey8, false},
  }};
  return kFormats;
}

const KnownFormat* find_format(const lc::PixelFormat& format) {
  const auto known = std::ranges::find(known_formats(), format, &KnownFormat::format);
  return known == known_formats().end() ? nullptr : &*known;
}

// libcamera allows one manager per process. The manager must exist as long as its cameras.
Result<std::shared_ptr<lc::CameraManager>> camera_manager() {
  static std::mutex mutex;
  static std::weak_ptr<lc::CameraManager> shared;
  const std::lock_guard lock(mutex);
  if (auto manager = shared.lock()) return manager;
  // Switches libcamera's log off, because its calls return errors. The user can keep the log on.
  if (std::getenv("LIBCAMERA_LOG_LEVELS") == nullptr) lc::logSetTarget(lc::LoggingTargetNone);
  std::shared_ptr<lc::CameraManager> manager(new lc::CameraManager, [](lc::CameraManager* ended) {
    ended->stop();
    delete ended;
  });
  if (const int error = manager->start(); error != 0) {
    return fail("libcamera: does not start: {}; try v4l2:/dev/video0", message_of(error));
  }
  shared = manager;
  return manager;
}

std::string model_of(const lc::Camera& camera) {
  return camera.properties().get(lc::properties::Model).value_or(std::string());
}

StreamResult<std::shared_ptr<lc::Camera>> find_camera(const lc::CameraManager& manager,
                                                      const std::string& name) {
  const auto cameras = manager.cameras();
  if (const auto index = parse_integer(name);
      index && *index >= 0 && static_cast<std::uint64_t>(*index) < cameras.size()) {
    return cameras[static_cast<std::size_t>(*index)];
  }
  for (const auto& camera : cameras) {
    if (camera->id() == name || model_of(*camera) == name) return camera;
  }
  if (const auto closed = forbidden_camera_device(); cameras.empty() && closed) {
    return fail_with(CaptureFault::forbidden, "libcamera:{}: libcamera finds no camera, and has {}",
                     name, *closed);
  }
  if (cameras.empty()) {
    return fail_with(CaptureFault::disconnected,
                     "libcamera:{}: libcamera finds no camera; plug one in, or see what penumbra "
                     "devices says of it",
                     name);
  }
  return fail_with(CaptureFault::disconnected,
                   "libcamera:{}: there is no such camera; penumbra devices lists the {} that "
                   "there are",
                   name, cameras.size());
}

// A buffer of a stream, mapped read-only. libcamera's buffers are always DMA-BUF.
class MappedBuffer {
 public:
  // Fails with an errno.
  static tl::expected<MappedBuffer, int> map(const lc::FrameBuffer& buffer) {
    std::map<int, std::size_t> lengths;  // keyed by libcamera's descriptor
    for (const auto& plane : buffer.planes()) {
      const std::uint64_t end = std::uint64_t{offset_of(plane)} + plane.length;
      if (end == 0 || end > kMaxBufferBytes) return tl::unexpected(EINVAL);
      std::size_t& length = lengths[plane.fd.get()];
      length = std::max<std::size_t>(length, end);
    }
    if (lengths.empty()) return tl::unexpected(EINVAL);
    MappedBuffer mapped;
    std::map<int, std::span<const std::uint8_t>> bytes;
    for (const auto& [descriptor, length] : lengths) {
      // Duplicates the descriptor, because frames may outlive the camera.
      const int duplicate = fcntl(descriptor, F_DUPFD_CLOEXEC, 0);
      if (duplicate < 0) return tl::unexpected(errno);
      PENUMBRA_TRY(auto memory, BufferMemory::map(duplicate, length));
      bytes[descriptor] = memory.bytes();
      mapped.memories_.push_back(std::move(memory));
    }
    for (const auto& plane : buffer.planes()) {
      mapped.planes_.push_back(bytes[plane.fd.get()].subspan(offset_of(plane), plane.length));
    }
    return mapped;
  }

  [[nodiscard]] const std::vector<std::span<const std::uint8_t>>& planes() const { return planes_; }
  // Returns the memory that all planes share; nullptr if they lie in several memories.
  [[nodiscard]] const BufferMemory* memory() const {
    return memories_.size() == 1 ? &memories_.front() : nullptr;
  }
  void begin_reading() const {
    for (const BufferMemory& memory : memories_) memory.begin_reading();
  }
  void end_reading() const {
    for (const BufferMemory& memory : memories_) memory.end_reading();
  }

 private:
  static unsigned offset_of(const lc::FrameBuffer::Plane& plane) {
    return plane.offset == lc::FrameBuffer::Plane::kInvalidOffset ? 0 : plane.offset;
  }
  std::vector<BufferMemory> memories_;
  std::vector<std::span<const std::uint8_t>> planes_;
};

// Queue of completed requests from libcamera's thread to the reader's.
class CompletedRequests {
 public:
  void put(lc::Request* request) {
    change([&] { requests_.push_back(request); });
  }
  void disconnect() {
    change([&] { disconnected_ = true; });
  }
  void stop() {
    change([&] { stopped_ = true; });
  }
  [[nodiscard]] bool stopped() const {
    const std::lock_guard lock(mutex_);
    return stopped_;
  }
  [[nodiscard]] bool disconnected() const {
    const std::lock_guard lock(mutex_);
    return disconnected_;
  }
  // Returns nullptr after the timeout, disconnect() or stop().
  [[nodiscard]] lc::Request* take(std::chrono::milliseconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout,
                      [&] { return stopped_ || disconnected_ || !requests_.empty(); });
    if (stopped_ || disconnected_ || requests_.empty()) return nullptr;
    lc::Request* request = requests_.front();
    requests_.pop_front();
    return request;
  }
  void wait_for_stop(std::chrono::milliseconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [&] { return stopped_; });
  }
  // Empties the queue for the next stream.
  void clear() {
    const std::lock_guard lock(mutex_);
    requests_.clear();
    disconnected_ = false;
  }

 private:
  template <class Change>
  void change(const Change& change) {
    {
      const std::lock_guard lock(mutex_);
      change();
    }
    changed_.notify_all();
  }

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<lc::Request*> requests_;  // guarded by mutex_
  bool disconnected_ = false;          // guarded by mutex_
  bool stopped_ = false;               // guarded by mutex_
};

// Returns true if an open video device of this process was removed. Without udev, libcamera 0.0.3
// does not detect the removal, and an assertion in its Camera::stop() fails because requests are
// still pending (pipeline_handler.cpp).
bool a_device_is_gone() {
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd", error)) {
    const auto target = std::filesystem::read_symlink(entry.path(), error);
    if (error || !target.string().starts_with("/dev/video")) continue;
    const auto descriptor = parse_integer(entry.path().filename().string());
    v4l2_capability about{};
    if (descriptor && ioctl(static_cast<int>(*descriptor), VIDIOC_QUERYCAP, &about) != 0 &&
        errno == ENODEV) {
      return true;
    }
  }
  return false;
}

std::optional<double> number_of(const lc::ControlValue& value) {
  if (value.isArray()) return std::nullopt;
  switch (value.type()) {
    case lc::ControlTypeInteger32:
      return value.get<std::int32_t>();
    case lc::ControlTypeInteger64:
      return static_cast<double>(value.get<std::int64_t>());
    case lc::ControlTypeFloat:
      return value.get<float>();
    default:
      return std::nullopt;
  }
}

// A streaming camera. The destructor stops it; buffers of frames in use stay mapped.
class Stream {
 public:
  struct PreviousStream {
    std::string id;
    StreamFormat format;
  };
  // `as_before`: the previous stream; if given, only its camera and format are accepted.
  static StreamResult<std::unique_ptr<Stream>> start(const LibcameraOptions& options,
                                                     const std::optional<PreviousStream>& as_before,
                                                     CompletedRequests& completed) {
    auto manager = camera_manager();
    if (!manager) return fail_with(CaptureFault::io_error, "{}", manager.error().message);
    PENUMBRA_TRY(auto camera, find_camera(**manager, as_before ? as_before->id : options.camera));
    std::unique_ptr<Stream> stream(new Stream(std::move(*manager), std::move(camera), completed));
    PENUMBRA_TRY_VOID(stream->run(options, as_before));
    return stream;
  }
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;
  ~Stream() {
    if (ring_) ring_->close();
    if (running_) {
      if (a_device_is_gone()) {
        wait_for_libcamera();
      } else {
        camera_->stop();
      }
    }
    camera_->requestCompleted.disconnect();
    camera_->disconnected.disconnect();
    completed_.clear();
    requests_.clear();
    allocator_.reset();
    if (acquired_) camera_->release();
  }

  [[nodiscard]] const StreamFormat& format() const { return format_; }
  [[nodiscard]] const KnownFormat& known() const { return *known_; }
  [[nodiscard]] const FrameLayout& layout() const { return layout_; }
  [[nodiscard]] BufferRing& ring() { return *ring_; }
  [[nodiscard]] const std::string& id() const { return camera_->id(); }
  [[nodiscard]] std::string model() const { return model_of(*camera_); }
  // Returns true if a GPU can read the buffers in place.
  [[nodiscard]] bool shares() const {
    return share_ && !known_->jpeg && buffers_->front().memory() != nullptr;
  }
  [[nodiscard]] const MappedBuffer& buffer(std::size_t index) const { return (*buffers_)[index]; }

  // Returns a view of buffer `index`, or nullopt if the buffer is too short.
  [[nodiscard]] std::optional<Frame> frame(std::size_t index) const {
    const MappedBuffer& buffer = (*buffers_)[index];
    const auto& planes = buffer.planes();
    Frame frame = layout_.frame;
    const auto count = static_cast<std::size_t>(frame.plane_count);
    for (std::size_t i = 0; i < count; ++i) {
      const bool separate = planes.size() == count;  // else planes[0] holds all image planes
      const std::span<const std::uint8_t> memory = separate ? planes[i] : planes[0];
      const std::size_t offset = separate ? 0 : layout_.offset[i];
      const std::size_t bytes = static_cast<std::size_t>(frame.planes[i].stride) *
                                static_cast<std::size_t>(frame.planes[i].height);
      if (offset + bytes > memory.size()) return std::nullopt;
      frame.planes[i].data = memory.data() + offset;
      if (share_ && buffer.memory() != nullptr) {
        frame.dma_buf.offset[i] =
            static_cast<std::size_t>(frame.planes[i].data - buffer.memory()->bytes().data());
      }
    }
    if (share_ && buffer.memory() != nullptr) {
      frame.dma_buf.descriptor = buffer.memory()->descriptor();
      frame.dma_buf.buffer = buffer.memory()->number();
    }
    return frame;
  }
  [[nodiscard]] lc::FrameBuffer* buffer_of(const lc::Request& request) const {
    return request.findBuffer(stream_);
  }

 private:
  Stream(std::shared_ptr<lc::CameraManager> manager, std::shared_ptr<lc::Camera> camera,
         CompletedRequests& completed)
      : manager_(std::move(manager)), camera_(std::move(camera)), completed_(completed) {}

  [[nodiscard]] tl::unexpected<StreamError> trouble(const char* what, int error) const {
    const CaptureFault fault = fault_of(error);
    std::string_view remedy =
        "see libcamera's log (LIBCAMERA_LOG_LEVELS=*:DEBUG) and the kernel's (dmesg)";
    if (std::abs(error) == ENOSPC) {
      remedy = kFreeBandwidth;
    } else if (fault == CaptureFault::busy) {
      remedy = "another program uses it; close that one";
    } else if (fault == CaptureFault::forbidden) {
      remedy = kJoinVideoGroup;
    } else if (fault == CaptureFault::disconnected) {
      remedy = "connect the camera again";
    }
    return fail_with(fault, "libcamera:{}: {} fails: {}; {}", id(), what, message_of(error),
                     remedy);
  }

  StreamResult<void> run(const LibcameraOptions& options,
                         const std::optional<PreviousStream>& as_before) {
    if (const int error = camera_->acquire(); error != 0) return trouble("opening it", error);
    acquired_ = true;
    std::unique_ptr<lc::CameraConfiguration> configuration =
        camera_->generateConfiguration({lc::StreamRole::Viewfinder});
    if (!configuration || configuration->empty()) return trouble("its viewfinder stream", EINVAL);
    PENUMBRA_TRY_VOID(configure(*configuration, options, as_before));
    share_ = options.dma_buf;
    PENUMBRA_TRY_VOID(allocate());
    lc::ControlList controls = start_controls(options);
    camera_->requestCompleted.connect(this, &Stream::complete);
    camera_->disconnected.connect(this, &Stream::disconnect);
    if (const int error = camera_->start(&controls); error != 0) {
      return trouble("starting it", error);
    }
    running_ = true;
    if (!ring_->queue_all()) return trouble("queueing a request", EINVAL);
    return {};
  }

  StreamResult<void> configure(lc::CameraConfiguration& configuration,
                               const LibcameraOptions& options,
                               const std::optional<PreviousStream>& as_before) {
    lc::StreamConfiguration& requested = configuration.at(0);
    const lc::Size size(static_cast<unsigned>(options.width),
                        static_cast<unsigned>(options.height));
    const std::vector<lc::PixelFormat> offered = requested.formats().pixelformats();
    // In ascending order of cost; formats that lack the requested size come last.
    std::vector<const KnownFormat*> candidates;
    for (const KnownFormat& known : known_formats()) {
      if (std::ranges::find(offered, known.format) == offered.end()) continue;
      if (as_before && as_before->format.name != known.name) continue;
      if (options.format && *options.format != known.option) continue;
      candidates.push_back(&known);
    }
    std::ranges::stable_sort(candidates, std::greater(), [&](const KnownFormat* known) {
      const bool has_size = requested.formats().range(known->format).contains(size) ||
                            std::ranges::count(requested.formats().sizes(known->format), size) > 0;
      return std::pair(has_size, options.recording && known->jpeg);
    });
    if (candidates.empty()) {
      const std::string format = as_before ? as_before->format.name : options.format.value_or("");
      return fail_with(
          CaptureFault::wrong_format,
          "libcamera:{}: gives no {} frames; choose another --format (see penumbra devices)", id(),
          format.empty() ? "NV12, YU12, YUYV, MJPEG, RGB or GREY" : format);
    }
    known_ = candidates.front();
    requested.pixelFormat = known_->format;
    requested.size = size;
    requested.bufferCount = kBuffers;
    show_upright(
        configuration, camera_->properties().get(lc::properties::Rotation).value_or(0),
        [](int angle, bool* possible) { return lc::transformFromRotation(angle, possible); });
    if (configuration.validate() == lc::CameraConfiguration::Invalid) {
      return trouble("this size and format", EINVAL);
    }
    const lc::StreamConfiguration& granted = configuration.at(0);
    known_ = find_format(granted.pixelFormat);
    format_.width = static_cast<int>(granted.size.width);
    format_.height = static_cast<int>(granted.size.height);
    const bool same = !as_before || (known_ != nullptr && as_before->format.name == known_->name &&
                                     as_before->format.width == format_.width &&
                                     as_before->format.height == format_.height);
    if (known_ == nullptr || !same || granted.size.isNull()) {
      return fail_with(CaptureFault::wrong_format,
                       "libcamera:{}: grants {} for {}x{} {}; choose another --size or --format",
                       id(), granted.toString(), options.width, options.height,
                       candidates.front()->name);
    }
    format_.name = known_->name;
    format_.interval_s = 1.0 / options.fps;
    if (const int error = camera_->configure(&configuration); error != 0) {
      return trouble("setting it up", error);
    }
    stream_ = granted.stream();
    if (known_->jpeg) return {};
    layout_ = frame_layout(known_->pixels, format_.width, format_.height, granted.stride);
    if (granted.colorSpace) {
      const lc::ColorSpace& space = *granted.colorSpace;
      layout_.frame.color_matrix = space.ycbcrEncoding == lc::ColorSpace::YcbcrEncoding::Rec709
                                       ? ColorMatrix::bt709
                                       : ColorMatrix::bt601;
      layout_.frame.color_range =
          space.range == lc::ColorSpace::Range::Limited ? ColorRange::limited : ColorRange::full;
    }
    return {};
  }

  StreamResult<void> allocate() {
    allocator_ = std::make_unique<lc::FrameBufferAllocator>(camera_);
    if (const int count = allocator_->allocate(stream_); count <= 0) {
      return trouble("getting memory for frames", count == 0 ? ENOMEM : count);
    }
    auto buffers = std::make_shared<std::vector<MappedBuffer>>();
    std::vector<std::span<const std::uint8_t>> first_planes;
    for (const auto& buffer : allocator_->buffers(stream_)) {
      auto mapped = MappedBuffer::map(*buffer);
      if (!mapped) return trouble("mapping its buffers", mapped.error());
      first_planes.push_back(mapped->planes().front());
      buffers->push_back(std::move(*mapped));
      std::unique_ptr<lc::Request> request = camera_->createRequest(requests_.size());
      if (!request) return trouble("making a request", ENOMEM);
      if (const int error = request->addBuffer(stream_, buffer.get()); error != 0) {
        return trouble("making a request", error);
      }
      requests_.push_back(std::move(request));
      never_queued_.push_back(true);
    }
    if (requests_.size() < kDriverNeeds) return trouble("getting memory for frames", ENOMEM);
    buffers_ = buffers;
    const auto queue = [this, buffers](unsigned index) {
      lc::Request& request = *requests_[index];
      if (!never_queued_[index]) {
        (*buffers)[index].end_reading();
        request.reuse(lc::Request::ReuseBuffers);
      }
      never_queued_[index] = false;
      return camera_->queueRequest(&request) == 0;
    };
    ring_ = BufferRing::create(std::move(first_planes), {queue, [buffers] { buffers->clear(); }});
    return {};
  }

  [[nodiscard]] bool has(const lc::ControlId& control) const {
    const lc::ControlInfoMap& known = camera_->controls();
    return known.find(&control) != known.end();
  }
  void warn_of_missing(const char* name) {
    log_warning("libcamera:{}: the camera has no {} to set; it stays as it is", id(), name);
  }

  // Requests a constant interval between frames, within the range of this size and format.
  void set_frame_duration(lc::ControlList& list, double fps) {
    namespace c = lc::controls;
    format_.interval_granted = has(c::FrameDurationLimits);
    if (!format_.interval_granted) return;
    auto duration_us = static_cast<std::int64_t>(std::llround(1e6 / fps));
    const lc::ControlInfo& range = camera_->controls().find(&c::FrameDurationLimits)->second;
    const auto is_time = [](const lc::ControlValue& value) {
      return value.type() == lc::ControlTypeInteger64 && !value.isArray();
    };
    if (is_time(range.min()) && is_time(range.max())) {
      const auto shortest_us = range.min().get<std::int64_t>();
      const auto longest_us = range.max().get<std::int64_t>();
      if (0 < shortest_us && shortest_us <= longest_us) {
        duration_us = std::clamp(duration_us, shortest_us, longest_us);
      }
    }
    format_.interval_s = 1e-6 * static_cast<double>(duration_us);
    const std::array<std::int64_t, 2> limits = {duration_us, duration_us};
    list.set(c::FrameDurationLimits, lc::Span<const std::int64_t, 2>(limits));
  }

  struct NumberControl {
    const char* name;
    const char* unit;       // with a leading space, or empty
    double steps_per_unit;  // libcamera's steps in one unit of the option
  };
  // Sets a control to the requested value, clamped to its range; warns if it was clamped or there
  // is no such control.
  template <class T>
  void set_number(lc::ControlList& list, const lc::Control<T>& control, const NumberControl& about,
                  double requested) {
    const auto found = camera_->controls().find(&control);
    if (found == camera_->controls().end()) return warn_of_missing(about.name);
    const lc::ControlInfo& info = found->second;
    ControlRange range;
    if (const auto lowest = number_of(info.min()), highest = number_of(info.max());
        lowest && highest) {
      range = {*lowest / about.steps_per_unit, *highest / about.steps_per_unit};
    }
    const GrantedControl granted = granted_control(about.name, about.unit, requested, range);
    if (granted.warning) log_warning("libcamera:{}: {}", id(), *granted.warning);
    const double steps = granted.value * about.steps_per_unit;
    list.set(control, static_cast<T>(std::is_integral_v<T> ? std::round(steps) : steps));
  }
  void set_switch(lc::ControlList& list, const lc::Control<bool>& control, bool value) const {
    if (has(control)) list.set(control, value);
  }

  // Returns the requested controls that this camera has; warns about the others.
  [[nodiscard]] lc::ControlList start_controls(const LibcameraOptions& options) {
    namespace c = lc::controls;
    lc::ControlList list(camera_->controls());
    const CameraControls& requested = options.controls;
    set_frame_duration(list, options.fps);
    // Refocusing would invalidate the calibration.
    if (has(c::AfMode)) list.set(c::AfMode, static_cast<std::int32_t>(c::AfModeManual));
    if (requested.focus) {
      set_number(list, c::LensPosition, {"focus", " dioptres", 1.0}, *requested.focus);
    }
    if (requested.auto_exposure) {
      set_switch(list, c::AeEnable, true);
      if (!has(c::AeEnable)) warn_of_missing("automatic exposure");
    } else if (requested.exposure_ms) {
      set_switch(list, c::AeEnable, false);
      set_number(list, c::ExposureTime, {"exposure", " ms", 1e3}, *requested.exposure_ms);
    }
    if (requested.gain) set_number(list, c::AnalogueGain, {"gain", "", 1.0}, *requested.gain);
    if (requested.auto_white_balance || requested.white_balance_k) {
      set_switch(list, c::AwbEnable, requested.auto_white_balance);
      if (!has(c::AwbEnable)) warn_of_missing("white balance");
    }
    if (requested.white_balance_k) {
      set_number(list, c::ColourTemperature, {"white balance", " K", 1.0},
                 *requested.white_balance_k);
    }
    return list;
  }

  void complete(lc::Request* request) {
    if (request->status() != lc::Request::RequestCancelled) completed_.put(request);
  }
  void disconnect() { completed_.disconnect(); }

  // Waits until libcamera's thread no longer completes or queues requests of a removed camera, for
  // which stop() must not be called. release() fails while the camera streams, but it is a blocking
  // call to that thread, which does its pending work first. That work may queue more: two calls.
  void wait_for_libcamera() {
    for (int i = 0; i < 2; ++i) {
      static_cast<void>(camera_->invokeMethod(&lc::Camera::release, lc::ConnectionTypeBlocking));
    }
  }

  // Declared in this order, because the manager must be destroyed after all of its objects.
  const std::shared_ptr<lc::CameraManager> manager_;
  const std::shared_ptr<lc::Camera> camera_;
  CompletedRequests& completed_;
  bool acquired_ = false, running_ = false;
  const KnownFormat* known_ = nullptr;
  StreamFormat format_;
  FrameLayout layout_;
  lc::Stream* stream_ = nullptr;
  std::unique_ptr<lc::FrameBufferAllocator> allocator_;
  std::vector<std::unique_ptr<lc::Request>> requests_;
  std::vector<bool> never_queued_;  // not queued so far; guarded by the ring's lock
  bool share_ = true;               // share buffers with a GPU
  std::shared_ptr<const std::vector<MappedBuffer>> buffers_;
  std::shared_ptr<BufferRing> ring_;
};

class LibcameraSource final : public LiveSource {
 public:
  LibcameraSource(LibcameraOptions options, std::unique_ptr<CompletedRequests> completed,
                  std::unique_ptr<Stream> stream)
      : options_(std::move(options)),
        before_{stream->id(), stream->format()},
        model_(stream->model()),
        shares_(stream->shares()),
        faults_("libcamera:" + options_.camera),
        clock_(nanoseconds(before_.format.interval_s)),
        pace_(nanoseconds(before_.format.interval_s)),
        completed_(std::move(completed)),
        stream_(std::move(stream)) {}

  Result<std::optional<CapturedImage>> next_image() override {
    while (!completed_->stopped()) {
      if (!stream_) {
        // Also pauses between streams that fail immediately after their start.
        if (std::exchange(retrying_, true)) completed_->wait_for_stop(kRetry);
        if (!reopen()) continue;
      }
      if (auto image = receive()) {
        retrying_ = false;
        return image;
      }
    }
    stream_.reset();
    return std::optional<CapturedImage>();
  }
  void stop() override { completed_->stop(); }
  [[nodiscard]] StreamFormat format() const override { return before_.format; }
  [[nodiscard]] FaultCounter& faults() override { return faults_; }
  [[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> controls() const override {
    Readings now;
    {
      const std::lock_guard lock(mutex_);
      now = readings_;
    }
    std::vector<std::pair<std::string, std::int64_t>> values;
    const auto add = [&values](const char* name, const auto& value, double factor) {
      if (!value) return;
      const double number = factor * static_cast<double>(*value);
      if (std::isfinite(number) && std::abs(number) < 1e15) {
        values.emplace_back(name, std::llround(number));
      }
    };
    add("exposure_time_us", now.exposure_us, 1.0);
    add("analogue_gain_thousandths", now.gain, 1e3);
    add("lens_position_millidioptres", now.lens_position, 1e3);
    add("colour_temperature_k", now.white_balance_k, 1.0);
    return values;
  }
  [[nodiscard]] std::optional<FocusReading> focus() const override {
    const std::lock_guard lock(mutex_);
    if (!readings_.lens_position || !std::isfinite(*readings_.lens_position)) return std::nullopt;
    constexpr double kStep_dioptres = 0.1;
    return FocusReading{*readings_.lens_position, kStep_dioptres};
  }
  [[nodiscard]] std::string description() const override {
    return fmt::format("libcamera:{} ({}), {} {}x{} at {}{}", before_.id, model_,
                       before_.format.name, before_.format.width, before_.format.height,
                       rate_text(before_.format), shares_ ? ", buffers shared by DMA-BUF" : "");
  }

 private:
  std::nullopt_t lose_stream(CaptureFault fault, const std::string& what) {
    outage_.begin({fault, what});
    stream_.reset();
    return std::nullopt;
  }

  bool reopen() {
    auto started = Stream::start(options_, before_, *completed_);
    if (!started) {
      outage_.begin(started.error());
      return false;
    }
    stream_ = std::move(*started);
    clock_.restart(nanoseconds(before_.format.interval_s));
    pace_.restart(nanoseconds(before_.format.interval_s));
    faults_.count_restart();
    return true;
  }

  std::optional<CapturedImage> receive() {
    const auto silent = std::chrono::duration_cast<std::chrono::milliseconds>(
        std::chrono::nanoseconds(pace_.stall_timeout_ns()));
    lc::Request* request = completed_->take(silent);
    if (request == nullptr) {
      if (completed_->stopped()) return std::nullopt;
      if (completed_->disconnected()) {
        return lose_stream(CaptureFault::disconnected, std::string(kDisconnected));
      }
      return lose_stream(
          CaptureFault::silent,
          fmt::format("the stream stalled: no frame and no error for {:.2g} s; {}",
                      1e-3 * static_cast<double>(silent.count()), kStreamIsRestarted));
    }
    const auto index = static_cast<unsigned>(request->cookie());
    CapturedImage image;
    stream_->buffer(index).begin_reading();
    image.owner = stream_->ring().lend(index);
    if (stream_->ring().refused()) {
      image.owner.reset();
      return lose_stream(CaptureFault::refused,
                         fmt::format("libcamera refused a request; {}", kStreamIsRestarted));
    }
    remember_controls(request->metadata());
    lc::FrameBuffer* buffer = stream_->buffer_of(*request);
    if (buffer == nullptr) return std::nullopt;
    const lc::FrameMetadata& metadata = buffer->metadata();
    const FrameStamp stamp = clock_.next(
        metadata.sequence, static_cast<std::int64_t>(metadata.timestamp), true, monotonic_ns());
    image.sequence = stamp.sequence;
    image.timestamp_ns = stamp.timestamp_ns;
    image.utc_ns = utc_at(stamp.timestamp_ns);
    if (const auto us = request->metadata().get(lc::controls::ExposureTime); us && *us > 0) {
      image.exposure_s = 1e-6 * *us;
    }
    count_stamp(faults_, stamp, before_.format);
    pace_.observe(stamp.timestamp_ns);
    std::size_t bytes = 0;
    for (const auto& plane : metadata.planes()) bytes += plane.bytesused;
    if (metadata.status != lc::FrameMetadata::FrameSuccess || bytes == 0) {
      faults_.count(
          CaptureFault::error_frame,
          fmt::format("a frame that the driver marked as bad is skipped; {}", kImproveTransfer));
      return skip(std::move(image));
    }
    if (!(stream_->known().jpeg ? read_jpeg(index, bytes, image) : read_planes(index, image))) {
      return skip(std::move(image));
    }
    if (outage_.end()) log_info("libcamera:{}: frames come again", options_.camera);
    faults_.count_frame();
    return image;
  }

  std::optional<CapturedImage> skip(CapturedImage image) {
    image.owner.reset();
    completed_->wait_for_stop(bad_frame_pause(before_.format.interval_s));
    return std::nullopt;
  }

  bool read_jpeg(unsigned index, std::size_t used, CapturedImage& image) {
    auto bytes = stream_->ring().buffer(index);
    auto received = receive_camera_jpeg(bytes.first(std::min(bytes.size(), used)),
                                        {before_.format.width, before_.format.height});
    if (!received) {
      faults_.count(received.error().fault, received.error().message);
      return false;
    }
    bytes = received->bytes;
    if (received->frame) image.frame = std::move(*received->frame);
    if (stream_->ring().in_driver() < kDriverNeeds) {
      auto copy = std::make_shared<std::vector<std::uint8_t>>(bytes.begin(), bytes.end());
      bytes = *copy;
      image.owner = std::move(copy);
    }
    image.jpeg = bytes;
    return true;
  }

  bool read_planes(unsigned index, CapturedImage& image) {
    auto frame = stream_->frame(index);
    if (!frame) {
      faults_.count(CaptureFault::error_frame,
                    fmt::format("a frame with too few bytes is skipped; {}", kImproveTransfer));
      return false;
    }
    if (stream_->ring().in_driver() < kDriverNeeds) {
      const FrameLayout& layout = stream_->layout();
      const std::shared_ptr<std::uint8_t[]> copy(new std::uint8_t[layout.bytes]);
      for (std::size_t i = 0; i < static_cast<std::size_t>(frame->plane_count); ++i) {
        PixelPlane& plane = frame->planes[i];
        std::uint8_t* out = copy.get() + layout.offset[i];
        std::memcpy(
            out, plane.data,
            static_cast<std::size_t>(plane.stride) * static_cast<std::size_t>(plane.height));
        plane.data = out;
      }
      frame->dma_buf = {};
      image.owner = copy;
    }
    image.frame = *frame;
    image.frame.sequence = image.sequence;
    image.frame.timestamp_ns = image.timestamp_ns;
    return true;
  }

  struct Readings {
    std::optional<std::int32_t> exposure_us;
    std::optional<float> gain;           // factor
    std::optional<float> lens_position;  // [dioptres]
    std::optional<std::int32_t> white_balance_k;
  };
  void remember_controls(const lc::ControlList& metadata) {
    namespace c = lc::controls;
    const Readings now = {metadata.get(c::ExposureTime), metadata.get(c::AnalogueGain),
                          metadata.get(c::LensPosition), metadata.get(c::ColourTemperature)};
    const std::lock_guard lock(mutex_);
    readings_ = now;
  }

  const LibcameraOptions options_;
  const Stream::PreviousStream before_;
  const std::string model_;
  const bool shares_;  // the first stream shared its buffers
  FaultCounter faults_;
  Outage outage_{faults_};
  FrameClock clock_;
  FramePace pace_;
  mutable std::mutex mutex_;
  Readings readings_;  // guarded by mutex_
  const std::unique_ptr<CompletedRequests> completed_;
  bool retrying_ = false;  // no frame arrived since the restart
  std::unique_ptr<Stream> stream_;
};

}  // namespace

Result<std::unique_ptr<LiveSource>> open_libcamera_source(const LibcameraOptions& options) {
  auto completed = std::make_unique<CompletedRequests>();
  auto stream = Stream::start(options, std::nullopt, *completed);
  if (!stream) return fail("{}", stream.error().message);
  return std::make_unique<LibcameraSource>(options, std::move(completed), std::move(*stream));
}

Result<std::vector<LibcameraCamera>> list_libcamera_cameras() {
  PENUMBRA_TRY(const auto manager, camera_manager());
  std::vector<LibcameraCamera> list;
  for (const auto& camera : manager->cameras()) {
    LibcameraCamera& about = list.emplace_back();
    about.id = camera->id();
    about.model = model_of(*camera);
    if (const int error = camera->acquire(); error == 0) {
      camera->release();
    } else {
      about.problem = std::abs(error) == EBUSY ? "another program uses it" : message_of(error);
    }
    const auto configuration = camera->generateConfiguration({lc::StreamRole::Viewfinder});
    if (!configuration || configuration->empty()) {
      about.problem = "it has no viewfinder stream";
      continue;
    }
    const lc::StreamFormats& formats = configuration->at(0).formats();
    bool usable = false;
    for (const lc::PixelFormat& format : formats.pixelformats()) {
      const KnownFormat* known = find_format(format);
      LibcameraFormat& added = about.formats.emplace_back();
      added.name = known != nullptr ? known->name : format.toString();
      added.usable = known != nullptr;
      usable = usable || added.usable;
      for (const lc::Size& size : formats.sizes(format)) added.sizes.push_back(size.toString());
    }
    if (!usable) about.problem = "it gives no NV12, YU12, YUYV, MJPEG, RGB or GREY frames";
  }
  return list;
}

}  // namespace penumbra
