#include "app/live/live_host.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "app/live/live_camera.hpp"
#include "app/output/output_file.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

constexpr double kMaxStart_s = 10.0;  // longest wait for the first image of a slow camera

// Number of frames that arrived damaged.
std::uint64_t damaged_frames(const CaptureStats& stats) {
  return stats.of(CaptureFault::damaged) + stats.of(CaptureFault::error_frame);
}

}  // namespace

std::vector<std::pair<std::string, std::int64_t>> fault_counts(const CaptureStats& stats) {
  std::vector<std::pair<std::string, std::int64_t>> counts;
  for (std::size_t i = 0; i < kCaptureFaultCount; ++i) {
    if (stats.faults[i] == 0) continue;
    counts.emplace_back(name_of(static_cast<CaptureFault>(i)),
                        static_cast<std::int64_t>(stats.faults[i]));
  }
  if (stats.restarts > 0) counts.emplace_back("restarts", stats.restarts);
  return counts;
}

LiveHost::LiveHost(Session& session, RunRecorder& run, LiveSource& source, LiveRecorder& recorder,
                   const LiveRequest& request)
    : SessionHost(session, run), source_(source), recorder_(recorder), request_(request) {
  if (auto played = played_recording(request.camera.source))
    set_played_recording(std::move(*played));
}

std::string LiveHost::toggle_recording() {
  if (const auto writer = recorder_.writer()) {
    const bool failed = writer->counts().error.has_value();
    const std::string folder = writer->folder().string();
    recorder_.stop();
    // A failed recording has ended already; the key starts a new one.
    if (!failed) return "recording ended: " + folder;
  }
  const std::filesystem::path folder =
      request_.record ? free_name(*request_.record, "") : free_name("");
  const auto played = played_recording(request_.camera.source);
  if (played && lies_in(folder, *played)) {
    return "this folder is the recording that is played; start elsewhere to record";
  }
  recorder_.begin(folder);
  return "recording to " + folder.string();
}

void LiveHost::describe(HudState& state, bool debug) const {
  SessionHost::describe(state, debug);
  state.live = true;
  state.calibrated = !request_.camera.fov_deg;
  if (state.has_image) state.stalled_s = stall_s_;
  if (!stall_s_) state.latency_ms = run_.recent_ms("latency");
  const CaptureStats stats = source_.faults().stats();
  state.frames_dropped =
      std::max(0, static_cast<int>(stats.frames - stats.undecoded) - run_.frames());
  state.trouble = stats.trouble;
  if (!state.trouble && stall_s_ && damaged_frames(stats) > damaged_) {
    state.trouble = "every frame is damaged";
  }
  state.faults = fault_counts(stats);
  if (const auto writer = recorder_.writer()) {
    const RecordingCounts counts = writer->counts();
    state.recording =
        HudRecording{writer->folder().string(), counts.written, counts.dropped, counts.error};
  }
}

std::string LiveHost::calibrate() {
  if (!has_begun_) return "the camera has given no image yet";
  constexpr double kSecondPress_ms = 4000.0;
  const bool again = since_asked_ && since_asked_->elapsed().wall_ms < kSecondPress_ms;
  if (!request_.camera.fov_deg && !again) {
    since_asked_.emplace();
    return "V again ends this session and calibrates the camera";
  }
  calibrates_ = true;
  return {};
}

bool LiveHost::is_over() const {
  if (calibrates_) return true;
  if (!request_.duration_s) return false;
  const double longest_s =
      has_begun_ ? *request_.duration_s : std::max(*request_.duration_s, kMaxStart_s);
  return watch_.elapsed().wall_ms >= longest_s * 1e3;
}

std::string LiveHost::no_frame_text() const {
  const std::string& camera = request_.camera.source;
  const CaptureStats stats = source_.faults().stats();
  const std::uint64_t unusable = damaged_frames(stats) + stats.of(CaptureFault::wrong_format);
  if (unusable > 0) {
    return fmt::format(
        "{}: gave no frame that can be used: {} are damaged or of another size or format; the "
        "warnings above have the remedy",
        camera, unusable);
  }
  if (!is_over()) return fmt::format("{}: gave no frame before the session was ended", camera);
  return fmt::format(
      "{}: gave no frame in {:.0f} s; choose another --format or --size, try another USB port, or "
      "see the kernel's log (dmesg)",
      camera, std::max(request_.duration_s.value_or(0.0), kMaxStart_s));
}

void LiveHost::set_live() {
  if (!std::exchange(has_begun_, true)) watch_.restart();
  stall_s_.reset();
  damaged_ = damaged_frames(source_.faults().stats());
}

void LiveHost::set_stalled(std::int64_t stall_ns) {
  stall_s_ = seconds(stall_ns);
}

}  // namespace penumbra
