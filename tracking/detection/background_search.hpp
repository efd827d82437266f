// Searches a frame for tags while later frames are tracked.
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
  StageTime time;  // time of the searching thread
};

// Searches one frame at a time. Call all functions from one thread.
class BackgroundSearch {
 public:
  // `own_thread`: true searches in a separate thread, false in take(). The result is the same.
  [[nodiscard]] static Result<std::unique_ptr<BackgroundSearch>> create(
      std::span<const TagFamily> families, std::optional<double> tone_exponent, bool own_thread);
  BackgroundSearch(const BackgroundSearch&) = delete;
  BackgroundSearch& operator=(const BackgroundSearch&) = delete;
  ~BackgroundSearch();  // waits for the running search

  [[nodiscard]] bool has_thread() const { return thread_.joinable(); }
  // Returns true if no search was begun since the latest result of take().
  [[nodiscard]] bool idle() const { return !begun_; }
  // Copies the luma and begins to search it. The object must be idle.
  void begin(ImageView luma, std::int64_t timestamp_ns, SearchResolution resolution);
  // Returns the result of the search; nullopt if idle or, without `wait`, if the search is running.
  [[nodiscard]] std::optional<PastTags> take(bool wait);

 private:
  enum class State { empty, requested, done };

  BackgroundSearch(TagSearch search, bool own_thread);
  [[nodiscard]] PastTags search();
  void serve();

  bool begun_ = false;  // used only by the caller's thread
  // The thread owns these members in the state `requested`, otherwise the caller owns them.
  TagSearch search_;
  std::vector<std::uint8_t> pixels_;
  ImageView luma_;  // view of pixels_
  std::int64_t timestamp_ns_ = 0;
  SearchResolution resolution_ = SearchResolution::full;
  PastTags found_;

  std::mutex mutex_;
  std::condition_variable changed_;
  State state_ = State::empty;  // guarded by mutex_
  bool ends_ = false;           // guarded by mutex_
  std::thread thread_;          // declared last, because it uses the members above
};

}  // namespace penumbra
