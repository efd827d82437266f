// Searches a frame for tags while the frames after it are tracked.
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
#include "core/image/image_view.hpp"
#include "core/stopwatch.hpp"
#include "tracking/detection/tag_search.hpp"

namespace penumbra {

// Tags found in an earlier frame.
struct PastTags {
  std::int64_t timestamp_ns = 0;
  std::vector<TagDetection> tags;
  StageTime time;  // of the thread that searched
};

// Searches one frame at a time. All functions are called by one thread.
class BackgroundSearch {
 public:
  // `own_thread`: a thread of this object searches; else take() does. The tags are the same.
  [[nodiscard]] static Result<std::unique_ptr<BackgroundSearch>> create(
      std::span<const TagFamily> families, std::optional<double> tone_exponent, bool own_thread);
  BackgroundSearch(const BackgroundSearch&) = delete;
  BackgroundSearch& operator=(const BackgroundSearch&) = delete;
  ~BackgroundSearch();  // waits for the search that is under way

  [[nodiscard]] bool has_thread() const { return thread_.joinable(); }
  // True if take() has returned the last search, or none was begun.
  [[nodiscard]] bool idle() const { return !begun_; }
  // Begins a search of a copy of the luma. The object must be idle.
  void begin(ImageView luma, std::int64_t timestamp_ns, SearchResolution resolution);
  // The result of the search; nothing when idle or, unless `wait`, while the search goes on.
  [[nodiscard]] std::optional<PastTags> take(bool wait);

 private:
  enum class State { empty, asked, done };

  BackgroundSearch(TagSearch search, bool own_thread);
  [[nodiscard]] PastTags search();
  void serve();

  bool begun_ = false;  // only the caller's thread uses it
  // The thread owns these while `asked`, the caller else.
  TagSearch search_;
  std::vector<std::uint8_t> pixels_;
  ImageView luma_;  // of pixels_
  std::int64_t timestamp_ns_ = 0;
  SearchResolution resolution_ = SearchResolution::full;
  PastTags found_;

  std::mutex mutex_;
  std::condition_variable changed_;
  State state_ = State::empty;  // guarded by mutex_
  bool ends_ = false;           // guarded by mutex_
  std::thread thread_;          // last: it uses everything above
};

}  // namespace penumbra
