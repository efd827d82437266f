#include <algorithm>
#include <array>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "benchmarks/peers/comparison.hpp"
#include "benchmarks/peers/saddle_points.hpp"
#include "calib/survey/tag_survey.hpp"
#include "core/image/image_file.hpp"
#include "tracking/detection/board_pose.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra::peers {

Result<RealVideo> load_real_video(const std::filesystem::path& folder) {
  RealVideo video;
  Footage& footage = video.footage;
  footage.name = folder.filename();
  CameraParameters lens;
  double tag_size_m = 0.0;
  try {
    const auto camera = nlohmann::json::parse(std::ifstream(folder / "cam.json"));
    lens.width = camera.at("w");
    lens.height = camera.at("h");
    lens.fx = camera.at("px");
    lens.fy = camera.at("py");
    lens.cx = camera.at("u0");
    lens.cy = camera.at("v0");
    tag_size_m = nlohmann::json::parse(std::ifstream(folder / "apriltag_data.json")).at("tag_size");
  } catch (const nlohmann::json::exception& e) {
    return fail("{}: cam.json or apriltag_data.json: {}", folder.string(), e.what());
  }
  const auto camera = CameraModel::make(lens);
  if (!camera) return tl::unexpected(camera.error());
  footage.camera = *camera;

  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "frames")) {
    if (entry.path().extension() == ".png") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  constexpr std::int64_t kFrame_ns = 1'000'000'000 / 30;
  for (const std::filesystem::path& file : files) {
    auto frame = load_image(file);
    if (!frame) return tl::unexpected(frame.error());
    frame->timestamp_ns = kFrame_ns * static_cast<std::int64_t>(footage.frames.size());
    footage.frames.push_back(std::move(*frame));
  }

  const std::array<TagFamily, 1> families = {TagFamily::tag36h11};
  TagDetector detector = TagDetector::create(families).value();
  std::vector<SurveyFrame> seen;
  std::vector<std::uint8_t> scratch;
  std::map<int, int> count;
  for (const Frame& frame : footage.frames) {
    seen.push_back({detector.detect(luma(frame, scratch)), {}});
    for (const TagDetection& tag : seen.back().tags) ++count[tag.id];
  }
  if (count.empty()) return fail("{}: no tag in any frame", folder.string());
  SurveyOptions options;
  options.tag_size_m = tag_size_m;
  // The table frame is the frame of the tag detected most often.
  options.anchor = std::max_element(count.begin(), count.end(), [](const auto& a, const auto& b) {
                     return a.second < b.second;
                   })->first;
  options.max_frames = static_cast<int>(footage.frames.size());
  options.plane = SurveyPlane::anchor;
  const auto survey = survey_tags(footage.camera, seen, options);
  if (!survey) return tl::unexpected(survey.error());
  std::vector<MappedTag> mapped;
  for (const SurveyedTag& tag : survey->tags) {
    mapped.push_back(tag.tag);
    // The adjustment keeps the first tag fixed, so the anchor must be first.
    if (tag.tag.id == options.anchor) std::swap(mapped.front(), mapped.back());
  }
  video.tags = static_cast<int>(mapped.size());

  // From here on, the reference does not use the detector, which is one of the compared methods.
  std::vector<CameraPose> poses;
  std::vector<std::vector<SaddlePoint>> points;
  std::vector<std::size_t> with_pose;  // indices of the frames with a camera pose
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (!survey->cameras[i]) continue;
    with_pose.push_back(i);
    poses.push_back(*survey->cameras[i]);
    points.push_back(
        find_saddle_points(footage.camera, mapped, poses.back(), luma(footage.frames[i], scratch)));
  }
  video.rms_px = adjust(footage.camera, points, mapped, poses);
  const auto tags = TagMap::make(mapped);
  if (!tags) return tl::unexpected(tags.error());
  footage.tags = *tags;
  for (std::size_t k = 0; k < with_pose.size(); ++k)
    footage.truth.poses.push_back({footage.frames[with_pose[k]].timestamp_ns, poses[k], {}});

  for (std::size_t i = 0; i < seen.size(); ++i) {
    std::vector<TagObservation> observations;
    for (const TagDetection& detection : seen[i].tags) {
      if (const MappedTag* tag = footage.tags.find(detection.family, detection.id))
        observations.push_back({tag->id, tag->corners(), detection.corners_px});
    }
    std::vector<PointObservation> corners;
    const auto board = estimate_board_pose(footage.camera, observations);
    if (board && !board->inconsistent) {
      for (const TagObservation& observation : observations) {
        if (std::count(board->rejected.begin(), board->rejected.end(), observation.index) > 0)
          continue;
        for (std::size_t k = 0; k < 4; ++k)
          corners.push_back({observation.corners_map[k], observation.corners_px[k]});
      }
    }
    video.corners.push_back(std::move(corners));
  }
  return video;
}

}  // namespace penumbra::peers
