#include "app/recording/recording_writer.hpp"
#include "app/libav.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <exception>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <set>
#include <span>
#include <system_error>
#include <thread>
#include <variant>

#include "app/logging.hpp"
#include "app/output/output_file.hpp"
#include "app/recording/lossless_video.hpp"
#include "app/recording/recording_source.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/image/jpeg_outline.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

// Limits of the queue: one second of video, and lines for a much longer time.
constexpr std::size_t kMaxImages = 32;
constexpr std::size_t kMaxLines = 4096;
// Interval of writing controls.json: its largest age if the program is killed.
constexpr std::chrono::seconds kControlsAge(1);

// A new file that is only appended to.
class GrowingFile {
 public:
  GrowingFile() = default;
  GrowingFile(const GrowingFile&) = delete;
  GrowingFile& operator=(const GrowingFile&) = delete;
  ~GrowingFile() {
    if (descriptor_ >= 0) close(descriptor_);
  }
  Result<void> create(const fs::path& file, const char* remedy = "choose another place") {
    file_ = file;
    descriptor_ = ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC, 0666);
    return descriptor_ < 0 ? failed(remedy) : Result<void>();
  }
  Result<void> add(std::span<const std::uint8_t> bytes) {
    while (!bytes.empty()) {
      const ssize_t count = write(descriptor_, bytes.data(), bytes.size());
      if (count < 0 && errno == EINTR) continue;
      if (count <= 0) return failed(kFreeSpace);
      bytes = bytes.subspan(static_cast<std::size_t>(count));
    }
    return {};
  }
  Result<void> add_line(std::string_view line) {
    const std::string whole = std::string(line) + '\n';
    return add({reinterpret_cast<const std::uint8_t*>(whole.data()), whole.size()});
  }

  static constexpr const char* kFreeSpace = "free some space or choose another place";

 private:
  [[nodiscard]] Result<void> failed(const char* remedy) const {
    return fail("{}: cannot be written: {}; {}", file_.string(), system_message(errno), remedy);
  }
  fs::path file_;
  int descriptor_ = -1;
};

struct PoseLine {
  std::string text;
  std::string group;  // empty: pose of the camera
};
struct EventLine {
  std::string text;
  std::vector<KeptFile> files = {};  // copied before the line is written
};
using Item = std::variant<CapturedImage, PoseLine, EventLine>;

std::string event_text(std::int64_t timestamp_ns, std::string_view event, std::string_view detail) {
  Json json;
  json["event"] = event;
  if (!detail.empty()) json["detail"] = detail;
  const std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  // Written as text, because a JSON double would lose the nanoseconds.
  return fmt::format("{{\"timestamp_s\":{},{}", format_ns_as_seconds(timestamp_ns), text.substr(1));
}

}  // namespace

struct RecordingWriter::Impl {
  Impl(fs::path folder_to_make, RecordingHead recording_head)
      : folder(std::move(folder_to_make)), head(std::move(recording_head)) {}

  const fs::path folder;
  RecordingHead head;
  GrowingFile timestamps, poses, events;
  std::map<std::string, GrowingFile> group_poses;  // files of the groups tracked so far
  std::set<std::string> nameless_groups;           // have no file name; reported once
  std::optional<LosslessVideo> video;
  SessionStore session;
  bool with_exposure = false;  // the first image has an exposure time
  bool with_utc = false;       // the first image has a UTC time
  bool is_open = false;        // the folder was created

  mutable std::mutex mutex;
  std::condition_variable changed;
  std::deque<Item> queue;          // guarded by mutex
  std::size_t images_waiting = 0;  // guarded by mutex
  RecordingCounts counts;          // guarded by mutex
  bool closing = false;            // guarded by mutex
  std::uint64_t gap_frames = 0;    // guarded by mutex: images dropped since an accepted one
  std::int64_t gap_start_ns = 0;   // guarded by mutex: time of the first of these images
  std::chrono::steady_clock::time_point controls_written;
  std::thread thread;

  [[nodiscard]] RecordingCounts counts_now() const {
    const std::lock_guard lock(mutex);
    return counts;
  }
  void set_error(const Error& error) {
    const std::lock_guard lock(mutex);
    counts.error = error.message;
  }

  Result<void> write_controls() {
    Json json;
    const RecordingCounts now = counts_now();
    if (head.read_controls) {
      if (auto read = head.read_controls(); !read.empty()) head.controls = std::move(read);
    }
    controls_written = std::chrono::steady_clock::now();
    json["camera"] = head.camera;
    json["format"] = head.format.name;
    json["width"] = head.format.width;
    json["height"] = head.format.height;
    json["interval_s"] = head.format.interval_s;
    json["interval_granted"] = head.format.interval_granted;
    json["controls"] = Json::object();
    for (const auto& [name, value] : head.controls) json["controls"][name] = value;
    json["frames_written"] = now.written;
    json["frames_dropped"] = now.dropped;
    json["lines_dropped"] = now.lines_dropped;
    PENUMBRA_TRY(auto file, OutputFile::create(folder / "controls.json"));
    return write_text(file, json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
  }

  Result<void> open() {
    if (!is_jpeg()) PENUMBRA_TRY_VOID(load_libav());
    std::error_code error;
    if (fs::exists(folder, error) &&
        (!fs::is_directory(folder, error) ||
         fs::directory_iterator(folder, error) != fs::directory_iterator())) {
      return fail("{}: exists and is not empty; name a new folder to record to", folder.string());
    }
    // Created folders, deepest first: the order of removal if a later step fails.
    std::vector<fs::path> made;
    for (fs::path part = folder; !part.empty() && !fs::exists(part, error);
         part = part.parent_path()) {
      made.push_back(part);
    }
    auto filled = fill();
    if (!filled) {
      for (const char* name : {"camera.yaml", "tags.yaml", "scene", "session.json", "controls.json",
                               "events.jsonl", "poses.tum", "timestamps.csv", "frames"}) {
        fs::remove_all(folder / name, error);
      }
      for (const fs::path& part : made) fs::remove(part, error);
    }
    is_open = filled.has_value();
    return filled;
  }

  // Creates the folder and its first files.
  Result<void> fill() {
    std::error_code error;
    fs::create_directories(folder, error);
    if (!error && is_jpeg()) fs::create_directories(folder / "frames", error);
    if (error) {
      return fail("{}: cannot be made: {}; choose another place", folder.string(), error.message());
    }
    PENUMBRA_TRY_VOID(write_text_file(folder / "camera.yaml", head.camera_yaml));
    PENUMBRA_TRY_VOID(write_text_file(folder / "tags.yaml", head.tags_yaml));
    if (!head.session.scene_text.empty()) {
      PENUMBRA_TRY_VOID(session.begin(folder, head.session));
    }
    PENUMBRA_TRY_VOID(write_controls());
    PENUMBRA_TRY_VOID(events.create(folder / "events.jsonl"));
    PENUMBRA_TRY_VOID(poses.create(folder / "poses.tum"));
    PENUMBRA_TRY_VOID(
        poses.add_line("# timestamp tx ty tz qx qy qz qw (T_table_camera, tracked poses)"));
    return timestamps.create(folder / "timestamps.csv");
  }

  [[nodiscard]] bool is_jpeg() const {
    return head.format.name == "MJPEG" || head.format.name == "JPEG";
  }

  // Writes the header line, which depends on the first image.
  Result<void> begin_listing() {
    // wall_time_ns comes last: the reader ignores it in a line that a crash cut off.
    return timestamps.add_line(fmt::format("frame,timestamp_s,file{}{}",
                                           with_exposure ? ",exposure_s" : "",
                                           with_utc ? ",wall_time_ns" : ""));
  }

  Result<void> write_jpeg(const CapturedImage& image, const fs::path& file) {
    GrowingFile out;
    PENUMBRA_TRY_VOID(out.create(file, GrowingFile::kFreeSpace));
    const auto outline = outline_jpeg(image.jpeg);
    const Result<void> written =
        outline ? out.add(normalized_jpeg(*outline, head.format.height)) : out.add(image.jpeg);
    if (!written) {
      std::error_code ignored;
      fs::remove(file, ignored);
    }
    return written;
  }

  // Writes the image before the line that lists it.
  Result<void> write_image(const CapturedImage& image, std::uint64_t number) {
    std::string name = "video.mkv";
    if (image.is_jpeg()) {
      name = fmt::format("frames/{:06}.jpg", number);
      PENUMBRA_TRY_VOID(write_jpeg(image, folder / name));
    } else {
      if (!video) {
        PENUMBRA_TRY(video, LosslessVideo::create(folder / name, image.frame));
      }
      PENUMBRA_TRY_VOID(video->write(image.frame));
    }
    std::string line =
        fmt::format("{},{},{}", number, format_ns_as_seconds(image.timestamp_ns), name);
    if (with_exposure) {
      line += image.exposure_s ? fmt::format(",{:.7g}", *image.exposure_s) : std::string(",");
    }
    if (with_utc) line += image.utc_ns ? fmt::format(",{}", *image.utc_ns) : std::string(",");
    return timestamps.add_line(line);
  }

  Result<void> write_group(const PoseLine& pose) {
    auto file = group_poses.find(pose.group);
    if (file == group_poses.end()) {
      const auto name = group_file(pose.group);
      if (!name) {
        if (nameless_groups.insert(pose.group).second) {
          log_warning(
              "group '{}': its name cannot be the name of a file, so its poses are not recorded; "
              "rename it in the tag file",
              pose.group);
        }
        return {};
      }
      const fs::path in = folder / kGroupPosesFolder;
      std::error_code error;
      fs::create_directories(in, error);
      if (error) {
        return fail("{}: cannot be made: {}; free some space or choose another place", in.string(),
                    error.message());
      }
      file = group_poses.try_emplace(pose.group).first;
      PENUMBRA_TRY_VOID(file->second.create(in / *name));
      PENUMBRA_TRY_VOID(
          file->second.add_line("# timestamp tx ty tz qx qy qz qw (T_table_group, tracked poses)"));
    }
    return file->second.add_line(pose.text);
  }

  Result<void> write(const Item& item) {
    if (const auto* image = std::get_if<CapturedImage>(&item)) {
      const std::uint64_t number = counts_now().written;
      if (number == 0) {
        with_exposure = image->exposure_s.has_value();
        with_utc = image->utc_ns.has_value();
        PENUMBRA_TRY_VOID(begin_listing());
      }
      PENUMBRA_TRY_VOID(write_image(*image, number));
      {
        const std::lock_guard lock(mutex);
        ++counts.written;
      }
      const bool old = std::chrono::steady_clock::now() - controls_written >= kControlsAge;
      return number == 0 || old ? write_controls() : Result<void>();
    }
    if (const auto* pose = std::get_if<PoseLine>(&item)) {
      return pose->group.empty() ? poses.add_line(pose->text) : write_group(*pose);
    }
    const auto& event = std::get<EventLine>(item);
    if (!event.files.empty()) {
      // Without the copy, the recording is replayed with the user's file.
      if (const auto kept = session.add(event.files); !kept)
        log_warning("{}", kept.error().message);
    }
    return events.add_line(event.text);
  }

  template <class Work>
  Result<void> guarded(const Work& work) {
    try {
      return work();
    } catch (const std::exception& error) {
      return fail("{}: {}", folder.string(), error.what());
    }
  }

  // `opened`: the folder was created.
  void run(bool opened) {
    if (!opened) {
      if (auto made = guarded([this] { return open(); }); !made) {
        log_warning("{}; nothing is recorded, the session continues", made.error().message);
        set_error(made.error());
      }
    }
    while (true) {
      std::optional<Item> item;
      {
        std::unique_lock lock(mutex);
        changed.wait(lock, [this] { return closing || !queue.empty(); });
        if (queue.empty()) return;
        item = std::move(queue.front());
        queue.pop_front();
        if (std::holds_alternative<CapturedImage>(*item)) --images_waiting;
        if (counts.error) continue;  // drops all further items
      }
      if (auto written = guarded([&] { return write(*item); }); !written) {
        log_warning("{}; the recording is closed, the session continues", written.error().message);
        set_error(written.error());
      }
    }
  }

  // Queues an event that reports dropped images. The caller holds the mutex.
  void report_gap() {
    if (gap_frames == 0) return;
    queue.push_back(
        EventLine{event_text(gap_start_ns, "left_out",
                             fmt::format("{} {}, the disk or the encoder was too slow", gap_frames,
                                         gap_frames == 1 ? "frame" : "frames"))});
    gap_frames = 0;
  }

  void add(Item item) {
    bool first_dropped = false;
    bool first_line_dropped = false;
    {
      const std::lock_guard lock(mutex);
      if (closing) return;
      const bool is_image = std::holds_alternative<CapturedImage>(item);
      if (counts.error) {
        counts.dropped += is_image ? 1 : 0;
        return;
      }
      if (is_image ? images_waiting >= kMaxImages : queue.size() >= kMaxLines) {
        if (is_image) {
          first_dropped = ++counts.dropped == 1;
          if (gap_frames++ == 0) gap_start_ns = std::get<CapturedImage>(item).timestamp_ns;
        } else {
          first_line_dropped = ++counts.lines_dropped == 1;
        }
      } else {
        if (is_image) {
          report_gap();
          ++images_waiting;
        }
        queue.push_back(std::move(item));
      }
    }
    changed.notify_one();
    if (first_dropped) {
      log_warning(
          "{}: frames are dropped from the recording, because the disk or the encoder is too slow; "
          "record to a faster disk, with --format mjpeg, or at a smaller --size or --fps (reported "
          "once, then counted)",
          folder.string());
    }
    if (first_line_dropped) {
      log_warning(
          "{}: poses, light and events are dropped from the recording, because the disk is too "
          "slow; record to a faster disk (reported once)",
          folder.string());
    }
  }
};

RecordingWriter::RecordingWriter(std::unique_ptr<Impl> impl, bool opened) : impl_(std::move(impl)) {
  impl_->thread = std::thread([m = impl_.get(), opened] { m->run(opened); });
}

RecordingWriter::~RecordingWriter() {
  (void)finish();
}

Result<std::unique_ptr<RecordingWriter>> RecordingWriter::create(const fs::path& folder,
                                                                 const RecordingHead& head) {
  auto impl = std::make_unique<Impl>(folder, head);
  PENUMBRA_TRY_VOID(impl->open());
  return std::unique_ptr<RecordingWriter>(new RecordingWriter(std::move(impl), true));
}

std::unique_ptr<RecordingWriter> RecordingWriter::begin(const fs::path& folder,
                                                        const RecordingHead& head) {
  return std::unique_ptr<RecordingWriter>(
      new RecordingWriter(std::make_unique<Impl>(folder, head), false));
}

void RecordingWriter::add_image(const CapturedImage& image) {
  impl_->add(image);
}

void RecordingWriter::add_pose(std::int64_t timestamp_ns, const PoseEstimate& pose) {
  if (pose.status != TrackStatus::tracked) return;
  impl_->add(PoseLine{format_tum({timestamp_ns, pose.T_table_camera, {}}), {}});
}

void RecordingWriter::add_group(std::int64_t timestamp_ns, const GroupEstimate& group) {
  if (group.status != TrackStatus::tracked) return;
  const CameraPose pose(group.T_table_group.rotation(), group.T_table_group.translation());
  impl_->add(PoseLine{format_tum({timestamp_ns, pose, {}}), group.name});
}

void RecordingWriter::add_event(std::int64_t timestamp_ns, std::string_view event,
                                std::string_view detail) {
  impl_->add(EventLine{event_text(timestamp_ns, event, detail)});
}

void RecordingWriter::add_scene_edit(const SceneEvent& event) {
  const auto* added = std::get_if<ObjectAdded>(&event.edit);
  if (added == nullptr || added->model == nullptr || added->model->files.empty()) {
    return impl_->add(EventLine{event_line(event)});
  }
  SceneEvent kept = event;
  std::vector<KeptFile> files;
  {
    const std::lock_guard lock(impl_->mutex);
    std::get<ObjectAdded>(kept.edit).model_file =
        impl_->head.session.models.keep(*added->model, files).string();
  }
  impl_->add(EventLine{event_line(kept), std::move(files)});
}

void RecordingWriter::add_light(const LitFrame& lit) {
  impl_->add(EventLine{light_line(lit)});
}

const std::filesystem::path& RecordingWriter::folder() const {
  return impl_->folder;
}

RecordingCounts RecordingWriter::counts() const {
  return impl_->counts_now();
}

Result<void> RecordingWriter::finish() {
  Impl& m = *impl_;
  if (!m.thread.joinable()) return {};
  {
    const std::lock_guard lock(m.mutex);
    m.report_gap();
    m.closing = true;
  }
  m.changed.notify_all();
  m.thread.join();
  const auto attempt = [&m](const Result<void>& done) {
    if (!done && !m.counts.error) m.counts.error = done.error().message;
  };
  if (m.video && !m.counts.error) attempt(m.video->finish());
  if (!m.counts.error && m.counts.written == 0) attempt(m.begin_listing());
  // Tries to write the controls even after an error.
  if (m.is_open) attempt(m.write_controls());
  if (m.counts.error) return fail("{}", *m.counts.error);
  return {};
}

}  // namespace penumbra
