// Tag, TagMap, Tracker and its results.
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <limits>
#include <memory>
#include <penumbra/tracking.hpp>

#include "bindings.hpp"

namespace penumbra::python {
namespace {

using tracking::Estimate;
using tracking::GroupEstimate;
using tracking::Tag;
using tracking::TagMap;
using tracking::TrackedFrame;

constexpr Names<tracking::Mode, 4> kModes = {{
    {"auto", tracking::Mode::automatic},
    {"fast", tracking::Mode::fast},
    {"accurate", tracking::Mode::accurate},
    {"detect", tracking::Mode::detect},
}};

constexpr Names<tracking::Search, 3> kSearches = {{
    {"next_frame", tracking::Search::next_frame},
    {"in_frame", tracking::Search::in_frame},
    {"when_done", tracking::Search::when_done},
}};

// A tracker and whether a call uses it.
struct Tracker {
  tracking::Tracker tracker;
  std::atomic<bool> busy = false;
};

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Returns the pose, or one of NaN if the state is lost.
types::Pose checked_pose(const Estimate& estimate, const types::Pose& pose) {
  if (estimate.has_pose()) return pose;
  return {{kNan, kNan, kNan}, {kNan, kNan, kNan, kNan}};
}
py::array_t<double> covariance_array(const Estimate& estimate) {
  types::Matrix6 covariance = estimate.covariance;
  if (!estimate.has_pose()) covariance.fill(kNan);
  return matrix_of(covariance.data(), 6, 6);
}

std::string summary(const Estimate& estimate) {
  std::string text = tracking::to_string(estimate.state);
  if (!estimate.reason.empty()) text += " (" + estimate.reason + ")";
  return text;
}

void bind_tags(py::module_& module) {
  py::class_<Tag>(module, "Tag", R"(A tag of a tag map. Immutable.

Tag frame: origin at the tag's centre, x right and y up on the upright tag, z out of the paper.)")
      .def(py::init([](int id, double size_m, const py::object& T_table_tag,
                       const std::string& family, const std::string& group,
                       const py::object& curvature) {
             return Tag{id,     family,
                        size_m, pose_of(T_table_tag, "T_table_tag"),
                        group,  numbers<3>(curvature, "curvature")};
           }),
           py::arg("id"), py::arg("size_m"), py::arg("T_table_tag"), py::arg("family") = "tag36h11",
           py::arg("group") = "table", py::arg("curvature") = py::make_tuple(0.0, 0.0, 0.0),
           R"(id: number of the tag in its family.
size_m: outer edge of the black border, without the white margin [m].
T_table_tag: a Pose or a 4 x 4 matrix.
family: 'tag36h11' and other families of AprilTag, or a dictionary of OpenCV ('DICT_4X4_50').
group: tags of one group move as a rigid body; only 'table' is fixed to the table frame.
curvature: of the paper, xx, xy and yy [1/m] in the tag frame.

TagMap checks the values.)")
      .def_readonly("id", &Tag::id, "Number of the tag in its family.")
      .def_readonly("family", &Tag::family, "Family of tags: 'tag36h11', ...")
      .def_readonly("size_m", &Tag::size_m,
                    "Outer edge of the black border, without the white margin [m].")
      .def_readonly("pose", &Tag::T_table_tag, "T_table_tag as a Pose.")
      .def_property_readonly(
          "T_table_tag", [](const Tag& tag) { return array_of(tag.T_table_tag); },
          "Pose of the tag in the table frame, shape (4, 4) [m].")
      .def_readonly("group", &Tag::group, "Group of tags that move together; 'table' rests.")
      .def_property_readonly(
          "curvature", [](const Tag& tag) { return array_of(tag.curvature); },
          "Curvature of the paper, xx, xy and yy [1/m], shape (3,).")
      .def(py::pickle(
          [](const Tag& tag) {
            return py::make_tuple(tag.id, tag.family, tag.size_m, tag.T_table_tag, tag.group,
                                  tag.curvature);
          },
          [](const py::tuple& state) {
            check_fields(state, 6);
            return Tag{state[0].cast<int>(),         state[1].cast<std::string>(),
                       state[2].cast<double>(),      state[3].cast<types::Pose>(),
                       state[4].cast<std::string>(), numbers<3>(state[5], "curvature")};
          }))
      .def("__repr__", [](const Tag& tag) {
        return py::str("<penumbra.Tag {} of {}, {} mm, group '{}'>")
            .format(tag.id, tag.family, 1e3 * tag.size_m, tag.group);
      });

  py::class_<TagMap>(module, "TagMap", R"(The tags on the table. Immutable; threads may share it.

Table frame: origin at the board's centre, x right, y up on the sheet, z out of the table.)")
      .def(py::init<const std::vector<Tag>&>(), py::arg("tags"), R"(Map of a list of Tag.

Raises Error for an empty list, an unknown family, a repeated tag, a size that is not positive, or a
pose that is not finite.)")
      .def_static("load", &TagMap::load, py::arg("file"), py::call_guard<Unlocked>(),
                  "Reads a tags.yaml. Raises Error.")
      .def("save", &TagMap::save, py::arg("file"), py::call_guard<Unlocked>(),
           "Writes a tags.yaml, from which load() reads the same numbers. Raises Error.")
      .def_property_readonly("tags", &TagMap::tags, "The tags, in the order of the map.")
      .def("__len__", [](const TagMap& map) { return map.tags().size(); })
      .def(py::pickle([](const TagMap& map) { return py::make_tuple(map.tags()); },
                      [](const py::tuple& state) {
                        check_fields(state, 1);
                        return TagMap(state[0].cast<std::vector<Tag>>());
                      }))
      .def("__repr__", [](const TagMap& map) {
        return py::str("<penumbra.TagMap of {} tags>").format(map.tags().size());
      });
}

void bind_estimates(py::module_& module) {
  py::class_<tracking::RejectedTag>(module, "RejectedTag", "A tag that was seen but not used.")
      .def_readonly("id", &tracking::RejectedTag::id, "Number of the tag.")
      .def_readonly("reason", &tracking::RejectedTag::reason,
                    "Key of the reason, as in docs/reports.md: 'tags_left_out' means inconsistent "
                    "with the map.")
      .def("__repr__", [](const tracking::RejectedTag& tag) {
        return py::str("<penumbra.RejectedTag {}: {}>").format(tag.id, tag.reason);
      });

  py::class_<Estimate>(module, "Estimate", "Quality of the pose of the table or of a group.")
      .def_property_readonly(
          "state", [](const Estimate& estimate) { return tracking::to_string(estimate.state); },
          R"('tracked': verified, with a predicted overlay error (1 sigma) below 2 px.
'uncertain': the predicted error is larger, or two poses are possible.
'held': not measured in this frame, but extrapolated from the latest motion (coasting).
'lost': no pose.)")
      .def_property_readonly("has_pose", &Estimate::has_pose, "False if the state is 'lost'.")
      .def_readonly("reason", &Estimate::reason,
                    "Why the state is not 'tracked', in words; '' if it is.")
      .def_property_readonly("covariance", &covariance_array,
                             R"(Covariance of the right perturbation T exp([nu, omega]) [m, rad].

In the camera frame, translation first, shape (6, 6); of T_table_camera, or of the camera over the
middle of a group. NaN if the state is 'lost'.)")
      .def_property_readonly(
          "predicted_overlay_px",
          [](const Estimate& estimate) {
            return estimate.has_pose() ? estimate.predicted_overlay_px
                                       : std::numeric_limits<double>::quiet_NaN();
          },
          R"(Predicted overlay error (1 sigma) [px]; NaN if the state is 'lost'.

RMS over the corners of a cube of 0.2 m that stands on the table's origin, or on the middle of a
group. Includes the uncertainty of the lens.)")
      .def_readonly("reprojection_rms_px", &Estimate::reprojection_rms_px,
                    "RMS reprojection error of the corners of the tags [px]; 0 without tags.")
      .def_readonly("tags_used", &Estimate::tags_used,
                    "Number of tags; 0 if the pose is not measured in this frame.")
      .def_readonly("tags_rejected", &Estimate::tags_rejected, "The RejectedTags.")
      .def_readonly("age_s", &Estimate::age_s,
                    "Time since the latest measured pose [s]; 0 unless the state is 'held'.");
}

void bind_table_and_groups(py::module_& module) {
  py::class_<tracking::TableEstimate, Estimate>(module, "TableEstimate",
                                                "Pose of the camera over the table.")
      .def_property_readonly(
          "T_table_camera",
          [](const tracking::TableEstimate& table) {
            return array_of(checked_pose(table, table.T_table_camera));
          },
          "Maps points of the camera frame to the table frame [m], shape (4, 4). NaN if the state "
          "is 'lost'.")
      .def_property_readonly(
          "pose",
          [](const tracking::TableEstimate& table) {
            return checked_pose(table, table.T_table_camera);
          },
          "T_table_camera as a Pose, with the numbers of `penumbra replay --poses`. NaN if the "
          "state is 'lost'.")
      .def("__repr__", [](const tracking::TableEstimate& table) {
        return "<penumbra.TableEstimate: " + summary(table) + ">";
      });

  py::class_<GroupEstimate, Estimate>(module, "GroupEstimate",
                                      R"(Pose of a group of tags on the table.

The group frame moves with the group. It is the table frame while the group is at its place in the
tag map.)")
      .def_readonly("name", &GroupEstimate::name, "Name of the group.")
      .def_property_readonly(
          "T_table_group",
          [](const GroupEstimate& group) {
            return array_of(checked_pose(group, group.T_table_group));
          },
          "Maps points of the group frame to the table frame [m], shape (4, 4). NaN if the state "
          "is 'lost'.")
      .def_property_readonly(
          "pose",
          [](const GroupEstimate& group) { return checked_pose(group, group.T_table_group); },
          "T_table_group as a Pose. NaN if the state is 'lost'.")
      .def_property_readonly(
          "T_group_middle",
          [](const GroupEstimate& group) { return array_of(group.T_group_middle); },
          "Middle of the group's tags, with the axes of its first tag, shape (4, 4) [m].")
      .def_readonly("rests", &GroupEstimate::rests,
                    "True if the group rests on the table, within the measurement noise.")
      .def("__repr__", [](const GroupEstimate& group) {
        return "<penumbra.GroupEstimate '" + group.name + "': " + summary(group) + ">";
      });
}

void bind_frames(py::module_& module) {
  py::class_<TrackedFrame>(module, "TrackedFrame", "What Tracker.track() found in a frame.")
      .def_readonly("time_ns", &TrackedFrame::timestamp_ns, "Time of the frame [ns].")
      .def_readonly("table", &TrackedFrame::table, "TableEstimate: the camera over the table.")
      .def_property_readonly(
          "groups",
          [](const py::object& self) {
            py::dict groups;
            for (const GroupEstimate& group : self.cast<const TrackedFrame&>().groups) {
              groups[py::str(group.name)] =
                  py::cast(&group, py::return_value_policy::reference_internal, self);
            }
            return groups;
          },
          "GroupEstimates by the name of the group, in the order of the tag map.")
      .def_readonly("notices", &TrackedFrame::notices,
                    R"(Causes of systematic errors that this frame reveals: the tag map, the lens or
the row time. A line each, with size and remedy; each cause only once.)")
      .def("__repr__", [](const TrackedFrame& frame) {
        return py::str("<penumbra.TrackedFrame at {} ns: {}, {} groups>")
            .format(frame.timestamp_ns, summary(frame.table), frame.groups.size());
      });
}

std::unique_ptr<Tracker> make_tracker(const types::CameraModel& camera, const TagMap& tags,
                                      const std::string& mode, double pose_budget_px,
                                      const std::string& search, bool search_thread, double hold_s,
                                      const py::object& groups) {
  tracking::Options options;
  options.mode = value_of(kModes, "mode", mode);
  options.pose_budget_px = pose_budget_px;
  options.search = value_of(kSearches, "search", search);
  options.search_thread = search_thread;
  options.hold_s = hold_s;
  if (!groups.is_none()) options.groups = strings(groups, "groups");
  return unlocked([&] {
    return std::unique_ptr<Tracker>(new Tracker{tracking::Tracker(camera, tags, options)});
  });
}

TrackedFrame track(Tracker& self, const py::object& image, const py::object& time_ns,
                   std::optional<double> exposure_s, const std::optional<std::string>& format) {
  const types::ImageView view = image_view(image, format.value_or(""));
  const std::int64_t timestamp_ns = nanoseconds(time_ns, "time_ns");
  const Busy busy(self.busy, "tracker");
  return unlocked([&] { return self.tracker.track(view, timestamp_ns, exposure_s); });
}

}  // namespace

void bind_tracking(py::module_& module) {
  bind_tags(module);
  bind_estimates(module);
  bind_table_and_groups(module);
  bind_frames(module);
  py::class_<Tracker>(module, "Tracker", R"(Tracks the tags through the frames of one camera.

The same frames give the same poses, bit for bit, as `penumbra replay`, except with the search
'when_done'. Other Python threads run while it computes. One thread at a time may use an object; a
second one gets an Error.)")
      .def(py::init(&make_tracker), py::arg("camera"), py::arg("tags"), py::kw_only(),
           py::arg("mode") = "auto", py::arg("pose_budget_px") = 0.0,
           py::arg("search") = "next_frame", py::arg("search_thread") = false,
           py::arg("hold_s") = 0.5, py::arg("groups") = py::none(),
           R"(camera: CameraModel of the frames.
tags: TagMap.
mode: 'auto' (fast while the view moves; accurate if it rests or has fewer than three tags), 'fast',
    'accurate', or 'detect' (detects tags in every frame, less accurate).
pose_budget_px: samples pixels until the predicted overlay error is below this [px]; 0: no budget.
search: when a frame is searched for lost tags. 'next_frame': the next frame waits for it;
    'in_frame': the frame waits for it; 'when_done': another thread searches, and a later frame uses
    the result.
search_thread: with 'next_frame', searches in a second thread, with the same results.
hold_s: maximum time to extrapolate a pose without a measurement [s].
groups: names of the groups to track beside the table; None: all.

Raises Error if no tag belongs to the group 'table', or for an option out of range.)")
      .def("track", &track, py::arg("image"), py::arg("time_ns"),
           py::arg("exposure_s") = py::none(), py::kw_only(), py::arg("format") = py::none(),
           R"(Tracks the next frame and returns a TrackedFrame.

image: uint8 array of the camera's size, which is read without a copy and not kept. (height, width)
    is grey; (height, width, 3) is RGB in this order. Rows may be apart, as in a slice.
time_ns: of any clock, at the middle of the exposure where known; it must increase.
exposure_s: exposure time, if known; it improves motion blur.
format: other layouts. 'yuyv': (height, width, 2) or (height, 2 * width). 'nv12', 'yuv420p',
    'yuv422p', 'yuv444p': only the plane Y, (height, width), which is frame[:height] of an OpenCV
    frame in such a format.

Raises Error if the size is not the camera's or the time does not increase, ArgumentError for
another shape or strides, TypeError for another dtype. The frame is then ignored.)")
      .def(
          "set_tag_map",
          [](Tracker& self, const TagMap& tags) {
            const Busy busy(self.busy, "tracker");
            unlocked([&] { self.tracker.set_tag_map(tags); });
          },
          py::arg("tags"), R"(Replaces the places of the table's tags from the next frame on.

The groups keep theirs. Raises Error unless the map has the same tags in the same groups.)");
}

}  // namespace penumbra::python
