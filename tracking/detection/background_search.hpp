// The tags of a frame, searched for beside the tracking of the frames after it.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <thread>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/frame.hpp"
#include "core/image/image_view.hpp"
#include "core/stopwatch.hpp"
#include "tracking/detection/tag_detector.hpp"
#include "tracking/detection/tag_search.hpp"

namespace penumbra {

// What was found in a frame of the past.
struct PastTags {
  std::int64_t timestamp_ns = 0;
  std::vector<TagDetection> tags;
  StageTime time;  // of the thread that searched
};

// One frame at a time: who asks goes on with newer frames meanwhile, and gives the next one when
// this one is done. All of it is called by one thread.
class BackgroundSearch {
 public:
  // `own_thread`: searched by a thread that lives as long as this; else by whoever takes the
  // result. The same tags either way.
  [[nodiscard]] static Result<std::unique_ptr<BackgroundSearch>> create(
      std::span<const TagFamily> families, const TagDetectorOptions& options,
      std::optional<double> tone_exponent, bool own_thread);
  BackgroundSearch(const BackgroundSearch&) = delete;
  BackgroundSearch& operator=(const BackgroundSearch&) = delete;
  ~BackgroundSearch();  // waits for the search that is under way

  [[nodiscard]] bool has_thread() const { return thread_.joinable(); }
  // Whether nothing was begun that has not been taken.
  [[nodiscard]] bool idle() const { return !begun_; }
  // Has to be idle. The luma is copied, nothing else of the frame is kept.
  void begin(ImageView luma, std::int64_t timestamp_ns, SearchResolution resolution);
  // What was found; nothing when idle or, unless `wait`, while it is still searched.
  [[nodiscard]] std::optional<PastTags> take(bool wait);

 private:
  enum class State { empty, asked, done };

  BackgroundSearch(TagSearch search, bool own_thread);
  [[nodiscard]] PastTags search();
  void serve();

  bool begun_ = false;  // of the caller's thread alone, as is all that it writes while `empty`
  TagSearch search_;
  std::vector<std::uint8_t> pixels_;
  ImageView luma_;  // of pixels_
  std::int64_t timestamp_ns_ = 0;
  SearchResolution resolution_ = SearchResolution::full;

  std::mutex mutex_;
  std::condition_variable changed_;
  State state_ = State::empty;  // guarded by mutex_
  bool ends_ = false;           // guarded by mutex_
  PastTags found_;              // the thread's while `asked`, the caller's when `done`
  std::thread thread_;          // last: it sees everything above
};

}  // namespace penumbra
