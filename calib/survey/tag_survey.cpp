#include "calib/survey/tag_survey.hpp"

#include <glog/logging.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <set>
#include <utility>
#include <vector>

#include "calib/survey/tag_graph.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/text/yaml_fields.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

// No tone curve and no blur that leaves a tag readable moves edges by more: what was found instead
// is an error of the model (a sheet that is not flat, a lens) that scale and shift took up
// together.
constexpr double kMostEdgeShift = 0.5;    // [px]
constexpr double kFlat = radians(6.0);    // tags of one table are parallel to this
constexpr double kHigh = 0.03;            // of the tag's size: further off the plane is not on it
constexpr double kMostLensSpread = 0.02;  // of the focal length: a worse one is not worth having

double size_of(const SurveyOptions& options, int id) {
  const auto named = options.sizes_m.find(id);
  return named != options.sizes_m.end() ? named->second : options.tag_size_m.value_or(0.0);
}

// The table's plane by the centres of the tags on it, in the anchor's frame, whose origin is the
// anchor's centre: `turn` takes the anchor's axes to the table's.
struct TablePlane {
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  // of the table, in the anchor's frame [m]
};

TablePlane plane_through(const Eigen::Matrix3Xd& centres) {
  const Eigen::Vector3d middle = centres.rowwise().mean();
  const Eigen::Matrix3Xd d = centres.colwise() - middle;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(d * d.transpose());
  Eigen::Vector3d z = eigen.eigenvectors().col(0);
  if (z.z() < 0.0) z = -z;
  TablePlane plane;
  const Eigen::Vector3d x = (Eigen::Vector3d::UnitX() - z.x() * z).normalized();
  plane.turn.row(0) = x.transpose();
  plane.turn.row(1) = z.cross(x).transpose();
  plane.turn.row(2) = z.transpose();
  plane.origin = z.dot(middle) * z;
  return plane;
}

// Ids of the tags that lie flat in one plane with the anchor (and face the same way), by growing
// sureness: first those near the anchor's own plane, then those near the plane through these.
std::vector<int> tags_on_table(const std::map<int, TagPose>& tags, int anchor,
                               const SurveyOptions& options) {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d on_plane = Eigen::Vector3d::Zero();
  double slack = std::tan(kFlat);  // of the distance: how far the normal may be off
  std::vector<int> members;
  for (int round = 0; round < 4; ++round) {
    members.clear();
    for (const auto& [id, pose] : tags) {
      const Eigen::Vector3d d = pose.translation() - on_plane;
      const double facing = (pose.rotation() * Eigen::Vector3d::UnitZ()).dot(normal);
      const double limit = kHigh * size_of(options, id) + slack * d.norm();
      if (facing > std::cos(kFlat) && std::abs(normal.dot(d)) < limit) members.push_back(id);
    }
    if (members.size() < 3) return {anchor};
    Eigen::Matrix3Xd centres(3, members.size());
    for (std::size_t i = 0; i < members.size(); ++i)
      centres.col(static_cast<Eigen::Index>(i)) = tags.at(members[i]).translation();
    const Eigen::Matrix3Xd around = centres.colwise() - centres.rowwise().mean();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(around * around.transpose());
    // On a line they leave the plane open.
    if (eigen.eigenvalues()[1] < std::pow(0.5 * size_of(options, anchor), 2)) return {anchor};
    const TablePlane plane = plane_through(centres);
    normal = plane.turn.row(2).transpose();
    on_plane = plane.origin;
    slack = 0.0;
  }
  return members;
}

// Turns what was solved in the anchor's frame into the table's, covariance included.
void settle_on_plane(TagSurvey& survey, std::map<int, TagPose> tags, const GraphCovariance& found,
                     const std::vector<int>& on_plane, int anchor) {
  std::vector<int> ids;
  for (const auto& [id, pose] : tags) ids.push_back(id);
  const auto n = static_cast<Eigen::Index>(ids.size());
  Eigen::Matrix3Xd centres(3, n);
  for (Eigen::Index i = 0; i < n; ++i)
    centres.col(i) = tags.at(ids[static_cast<std::size_t>(i)]).translation();
  const auto plane_of = [&](const Eigen::Matrix3Xd& at) {
    if (on_plane.size() < 3) return TablePlane{};
    Eigen::Matrix3Xd members(3, on_plane.size());
    Eigen::Index k = 0;
    for (Eigen::Index i = 0; i < n; ++i) {
      if (std::binary_search(on_plane.begin(), on_plane.end(), ids[static_cast<std::size_t>(i)]))
        members.col(k++) = at.col(i);
    }
    return plane_through(members);
  };
  const TablePlane plane = plane_of(centres);
  const Transform<frame::Table, frame::Table> T_table_anchor(plane.turn,
                                                             -(plane.turn * plane.origin));
  // How plane and origin follow the centres: [turn about the table's axes; origin in them].
  Eigen::MatrixXd follow = Eigen::MatrixXd::Zero(6, 3 * n);
  if (on_plane.size() >= 3) {
    constexpr double kStep = 1e-6;  // [m]
    for (Eigen::Index c = 0; c < 3 * n; ++c) {
      if (ids[static_cast<std::size_t>(c / 3)] == anchor) continue;
      Eigen::Matrix3Xd after = centres;
      Eigen::Matrix3Xd before = centres;
      after(c % 3, c / 3) += kStep;
      before(c % 3, c / 3) -= kStep;
      const TablePlane a = plane_of(after);
      const TablePlane b = plane_of(before);
      const Eigen::Matrix3d W = (a.turn - b.turn) * plane.turn.transpose() / (2.0 * kStep);
      follow.col(c).head<3>() = Eigen::Vector3d(W(2, 1), W(0, 2), W(1, 0));
      follow.col(c).tail<3>() = plane.turn * (a.origin - b.origin) / (2.0 * kStep);
    }
  }
  std::map<int, Eigen::Index> row;  // in the covariance; the anchor has none
  for (std::size_t i = 0; i < found.ids.size(); ++i)
    row[found.ids[i]] = 6 * static_cast<Eigen::Index>(i);
  double heights = 0.0;
  for (Eigen::Index i = 0; i < n; ++i) {
    const int id = ids[static_cast<std::size_t>(i)];
    SurveyedTag& tag = survey.tags[static_cast<std::size_t>(i)];
    tag.tag.T_table_tag = T_table_anchor * tags.at(id);
    const Eigen::Vector3d p = tag.tag.T_table_tag.translation();
    if (std::binary_search(on_plane.begin(), on_plane.end(), id)) heights += p.z() * p.z();
    Eigen::Matrix3d cross;
    cross << 0.0, -p.z(), p.y(), p.z(), 0.0, -p.x(), -p.y(), p.x(), 0.0;
    // Moved as a whole with plane and origin, and by itself.
    Eigen::MatrixXd J = Eigen::MatrixXd::Zero(6, found.tags.cols());
    for (Eigen::Index k = 0; k < n; ++k) {
      const auto at = row.find(ids[static_cast<std::size_t>(k)]);
      if (at == row.end()) continue;
      const Eigen::MatrixXd turned = follow.block(0, 3 * k, 3, 3);
      J.block(0, at->second, 3, 3) = -cross * turned - follow.block(3, 3 * k, 3, 3);
      J.block(3, at->second, 3, 3) = turned;
    }
    if (const auto own = row.find(id); own != row.end()) {
      J.block(0, own->second, 3, 3) += plane.turn;
      J.block(3, own->second + 3, 3, 3) += plane.turn;
    }
    tag.covariance = J * found.tags * J.transpose();
  }
  for (auto& camera : survey.cameras) {
    if (camera) camera = T_table_anchor * *camera;
  }
  survey.tags_on_plane = static_cast<int>(on_plane.size());
  survey.flatness_m = std::sqrt(heights / static_cast<double>(on_plane.size()));
  survey.plane_tilt_rad = std::acos(std::min(1.0, plane.turn(2, 2)));
}

// Which frames are used, and what of them: tags with a known size, once and whole in the picture.
struct SurveyInput {
  std::vector<std::vector<TagSighting>> frames;
  std::vector<std::size_t> of;  // their numbers in what was given
  std::map<int, int> seen;      // frames, by id
  std::set<int> without_size;
};

SurveyInput input_of(const CameraModel& camera, std::span<const SurveyFrame> frames,
                     const SurveyOptions& options) {
  SurveyInput input;
  const auto is_measured = [](const SurveyFrame& frame, std::size_t i) {
    return i < frame.measured.size() && frame.measured[i].has_value();
  };
  std::map<int, int> detected;
  std::map<int, int> measured;
  for (const SurveyFrame& frame : frames) {
    for (std::size_t i = 0; i < frame.tags.size(); ++i) {
      ++detected[frame.tags[i].id];
      if (is_measured(frame, i)) ++measured[frame.tags[i].id];
    }
  }
  const auto most = static_cast<std::size_t>(options.most_frames);
  const std::size_t step = std::max<std::size_t>(1, (frames.size() + most - 1) / most);
  for (std::size_t f = 0; f < frames.size(); f += step) {
    const SurveyFrame& frame = frames[f];
    std::map<int, int> times;
    for (const TagDetection& tag : frame.tags) ++times[tag.id];
    std::vector<TagSighting>& here = input.frames.emplace_back();
    input.of.push_back(f);
    for (std::size_t i = 0; i < frame.tags.size(); ++i) {
      const TagDetection& tag = frame.tags[i];
      if (times[tag.id] > 1) continue;  // two of them: nobody knows which is meant
      double size = size_of(options, tag.id);
      if (size <= 0.0) {
        // Not placed, but its size can be told.
        input.without_size.insert(tag.id);
        size = size_of(options, options.anchor);
        if (size <= 0.0) continue;
      }
      const bool inside = std::all_of(
          tag.corners_px.begin(), tag.corners_px.end(), [&](const Eigen::Vector2d& corner) {
            return corner.x() > 2.0 && corner.y() > 2.0 && corner.x() < camera.width() - 3 &&
                   corner.y() < camera.height() - 3;
          });
      if (!inside) continue;
      // Where a tag's edges are found in most frames, one without them is partly hidden.
      const bool edges = is_measured(frame, i);
      if (!edges && 2 * measured[tag.id] > detected[tag.id]) continue;
      here.push_back(edges ? sighting_of(tag.id, size, *frame.measured[i])
                           : sighting_of(tag.id, size, tag.corners_px));
      if (input.without_size.count(tag.id) == 0) ++input.seen[tag.id];
    }
  }
  return input;
}

// From the anchor outwards: cameras from placed tags, tags from posed cameras, all but `without`.
Result<void> chain(TagGraph& graph, const SurveyInput& input, int anchor,
                   const std::set<int>& without) {
  constexpr double kPlaced = 3.0;  // [px], of most frames: beyond, better cameras are waited for
  graph.tags[anchor] = Pose6{};
  for (bool grew = true; grew;) {
    grew = false;
    graph.pose_cameras();
    std::optional<std::pair<int, TagPlacement>> next_best;
    for (const auto& [id, count] : input.seen) {
      if (graph.tags.count(id) > 0 || without.count(id) > 0) continue;
      auto fit = graph.place(id);
      if (!fit) continue;
      if (fit->median_px() < kPlaced) {
        graph.tags[id] = packed(fit->T_anchor_tag);
        grew = true;
      } else if (!next_best || fit->median_px() < next_best->second.median_px()) {
        next_best.emplace(id, std::move(*fit));
      }
    }
    if (!grew && next_best && next_best->second.median_px() < kFarOff) {
      graph.tags[next_best->first] = packed(next_best->second.T_anchor_tag);
      grew = true;
    }
    if (grew && !graph.adjust(true))
      return fail(
          "the tags' places do not settle; sweep slower, and over two or more tags at a time");
  }
  if (std::none_of(graph.cameras.begin(), graph.cameras.end(),
                   [](const auto& pose) { return pose.has_value(); })) {
    return fail("tag {} alone never tells where the camera is; come closer to it, at an angle",
                anchor);
  }
  return {};
}

struct SettledGraph {
  TagGraph graph;  // without outliers
  double rms_px = 0.0;
  std::map<int, double> lost;  // by tag that was placed: share of its sightings that are outliers
  std::set<int> misfits;       // seen where cameras are known, and not placed
};

// Chains and adjusts all tags but `without`.
Result<SettledGraph> settle(const CameraModel& camera, const SurveyInput& input, int anchor,
                            const std::set<int>& without, const SurveyOptions& options) {
  SettledGraph result{TagGraph(camera, anchor), 0.0, {}, {}};
  TagGraph& graph = result.graph;
  graph.stop = options.stop;
  graph.frames = input.frames;
  graph.shift_is_free = false;
  PENUMBRA_TRY_VOID(chain(graph, input, anchor, without));
  const TagGraph chained = graph;
  graph.shift_is_free = options.edge_shift;
  int corners = 0;
  const auto adjust = [&] {
    for (int round = 0; round < 4; ++round) {
      if (!graph.adjust(round == 0)) return false;
      if (!graph.drop_outliers(result.rms_px, corners) && round > 0) break;
    }
    return true;
  };
  bool settled = adjust();
  if (settled && std::abs(graph.shift) > kMostEdgeShift) {
    graph = chained;
    settled = adjust();
  }
  if (settled && options.refine_camera) {
    graph.lens_is_free = true;
    settled = adjust();
  }
  if (!settled) return fail("the tags' places do not settle; sweep slower");
  std::map<int, std::pair<int, int>> counts;  // seen, of these left
  for (std::size_t f = 0; f < input.frames.size(); ++f) {
    if (!graph.cameras[f]) continue;
    for (const TagSighting& sighting : input.frames[f]) ++counts[sighting.id].first;
    for (const TagSighting& sighting : graph.frames[f]) ++counts[sighting.id].second;
  }
  for (const auto& [id, count] : counts) {
    if (graph.tags.count(id) > 0) {
      result.lost[id] = 1.0 - static_cast<double>(count.second) / count.first;
    } else if (count.first >= 2 && input.without_size.count(id) == 0) {
      result.misfits.insert(id);
    }
  }
  return result;
}

// A tag that lay in one place up to a frame, and in another one from it on.
struct Movement {
  std::size_t frame = 0;
  double distance_m = 0.0;  // of the corner that moved furthest
  double mean_px = 0.0;     // as TagPlacement's
};

// `judge` has all sightings, and cameras that this tag has no part in (or not much).
std::optional<Movement> movement_of(const TagGraph& judge, int id, double size_m) {
  constexpr std::size_t kFewest = 3;  // sightings in either place
  const auto seen = judge.seen_of(id);
  if (seen.size() < 2 * kFewest) return std::nullopt;
  std::optional<Movement> best;
  for (const double share : {0.25, 0.5, 0.75}) {
    std::size_t split =
        std::clamp(static_cast<std::size_t>(share * static_cast<double>(seen.size())), kFewest,
                   seen.size() - kFewest);
    std::optional<TagPlacement> before;
    std::optional<TagPlacement> after;
    const auto fit_parts = [&] {
      before = judge.fit(id, false, 0, seen[split].first);
      after = judge.fit(id, false, seen[split].first);
      return before && after;
    };
    if (!fit_parts()) continue;
    // Where the one explains less from then on than the other.
    judge.measure(*before, id);
    judge.measure(*after, id);
    double sum = after->mean_px() * static_cast<double>(seen.size());
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k + kFewest <= seen.size(); ++k) {
      if (k >= kFewest && sum < least) {
        least = sum;
        split = k;
      }
      sum += std::min(before->errors_px[k].second, kFarOff) -
             std::min(after->errors_px[k].second, kFarOff);
    }
    if (!fit_parts()) continue;
    const auto n = static_cast<double>(seen.size());
    Movement here;
    here.frame = seen[split].first;
    here.mean_px = (before->mean_px() * static_cast<double>(split) +
                    after->mean_px() * (n - static_cast<double>(split))) /
                   n;
    for (const double x : {-0.5 * size_m, 0.5 * size_m}) {
      for (const double y : {-0.5 * size_m, 0.5 * size_m}) {
        const Eigen::Vector3d corner(x, y, 0.0);
        here.distance_m = std::max(
            here.distance_m, (before->T_anchor_tag * corner - after->T_anchor_tag * corner).norm());
      }
    }
    if (!best || here.mean_px < best->mean_px) best = here;
  }
  return best;
}

// Why a tag does not fit the others, if it does not.
struct Contradiction {
  std::string words;                  // "tag 7: looks ..."
  bool moved = false;                 // it is where it is said to be, at times
  std::optional<MappedTag> apparent;  // its size explains it; T_anchor_tag
};

std::optional<Contradiction> contradiction_of(const TagGraph& judge, const SurveyInput& input,
                                              int id, const SurveyOptions& options) {
  constexpr double kExplains = 0.5;  // of the error that is left otherwise
  const bool sized = input.without_size.count(id) == 0;
  const double nominal_m = size_of(options, sized ? id : options.anchor);
  const auto free = judge.fit(id, true);
  const auto given = sized ? judge.fit(id, false) : free;
  if (!free || !given) return std::nullopt;
  const auto moved = movement_of(judge, id, nominal_m);
  Contradiction result;
  if (!sized || (free->mean_px() < kExplains * given->mean_px() &&
                 (!moved || free->mean_px() < 1.5 * moved->mean_px))) {
    MappedTag tag;
    tag.id = id;
    tag.family = options.family;
    tag.size_m = free->scale * nominal_m;
    tag.T_table_tag = free->T_anchor_tag;
    result.apparent = tag;
    result.words =
        sized ? fmt::format(
                    "tag {}: looks {:.1f} mm in size, where {:.1f} mm is given; say its size "
                    "with --sizes",
                    id, tag.size_m * 1e3, nominal_m * 1e3)
              : fmt::format("tag {}: has no size, and looks {:.1f} mm; say its size with --sizes",
                            id, tag.size_m * 1e3);
    return result;
  }
  if (moved && moved->mean_px < kExplains * given->mean_px()) {
    result.moved = true;
    result.words = fmt::format(
        "tag {}: moved by {:.1f} mm at about frame {}; sweep again while all of them rest", id,
        moved->distance_m * 1e3, input.of[moved->frame]);
    return result;
  }
  result.words =
      fmt::format("tag {}: is {:.1f} px off what the others say; is it flat, and did it rest?", id,
                  given->mean_px());
  return result;
}

// All tags that agree, and what is to be said of the others.
struct Agreement {
  SettledGraph settled;
  std::map<int, Contradiction> others;
};

// Takes out one tag after the other that contradicts the rest, worst first.
Result<Agreement> agree(const CameraModel& camera, const SurveyInput& input, int anchor,
                        const SurveyOptions& options) {
  constexpr double kMostLost = 0.5;    // of the sightings
  constexpr double kSuspicious = 0.1;  // that many may be blurred or hidden
  std::set<int> without;
  for (;;) {
    auto settled = settle(camera, input, anchor, without, options);
    if (options.stop.stop_requested()) return fail("ended early");
    if (!settled) return tl::unexpected(settled.error());
    TagGraph judge = settled->graph;
    judge.frames = input.frames;
    std::optional<std::pair<double, int>> worst;
    for (const auto& [id, lost] : settled->lost) {
      if (id != anchor && lost > kMostLost && (!worst || lost > worst->first)) worst = {lost, id};
    }
    for (const auto& [id, lost] : settled->lost) {
      if (worst || lost <= kSuspicious) continue;
      const auto reported = contradiction_of(judge, input, id, options);
      if (!reported || !reported->moved) continue;
      if (id == anchor) return fail("the anchor, {}", reported->words);
      worst = {lost, id};
    }
    if (worst) {
      without.insert(worst->second);
      continue;
    }
    Agreement result{std::move(*settled), {}};
    std::set<int> untold = result.settled.misfits;
    untold.insert(input.without_size.begin(), input.without_size.end());
    for (const int id : untold) {
      if (auto reported = contradiction_of(judge, input, id, options))
        result.others[id] = std::move(*reported);
    }
    return result;
  }
}

// Whether so many contradict the anchor that it may be the one that is wrong.
bool anchor_is_doubtful(const Agreement& agreement, const SurveyInput& input, int anchor) {
  const auto lost = agreement.settled.lost.find(anchor);
  if (lost != agreement.settled.lost.end() && lost->second > 0.5) return true;
  const std::size_t misfits = agreement.settled.misfits.size();
  return misfits >= 2 && 2 * misfits > input.seen.size() - 1;
}

// What the others say of the anchor, if they agree among themselves.
tl::unexpected<Error> blame(const CameraModel& camera, const SurveyInput& input,
                            const SurveyOptions& options) {
  std::vector<std::pair<int, int>> by_count;
  for (const auto& [id, count] : input.seen) {
    if (id != options.anchor) by_count.emplace_back(-count, id);
  }
  std::sort(by_count.begin(), by_count.end());
  constexpr std::size_t kTried = 3;
  for (std::size_t i = 0; i < std::min(kTried, by_count.size()); ++i) {
    const int other = by_count[i].second;
    const auto agreement = agree(camera, input, other, options);
    if (!agreement || anchor_is_doubtful(*agreement, input, other)) continue;
    const auto reported = agreement->others.find(options.anchor);
    if (reported == agreement->others.end()) continue;
    return fail("the anchor, {}; or choose another anchor", reported->second.words);
  }
  return fail(
      "the tags contradict each other: did some of them move, are the sizes right, and is the "
      "camera's file of this camera?");
}

}  // namespace

Result<TagSurvey> survey_tags(const CameraModel& camera, std::span<const SurveyFrame> frames,
                              const SurveyOptions& options) {
  // Ceres says on standard error what it tries in vain; what matters is in the result.
  FLAGS_minloglevel = std::max(FLAGS_minloglevel, static_cast<int>(google::GLOG_ERROR));
  const SurveyInput input = input_of(camera, frames, options);
  if (input.seen.empty()) {
    return fail(
        "no tag of the family {} with a known size is seen{}; name the family (--family) "
        "and the sizes",
        to_string(options.family),
        input.without_size.empty()
            ? ""
            : fmt::format(" (without size: {})", joined(std::vector(input.without_size.begin(),
                                                                    input.without_size.end()))));
  }
  if (input.seen.count(options.anchor) == 0) {
    std::vector<int> ids;
    for (const auto& [id, count] : input.seen) ids.push_back(id);
    return fail("the anchor, tag {}, is never seen{}; choose one of {}", options.anchor,
                input.without_size.count(options.anchor) > 0 ? " with a size" : "", joined(ids));
  }
  PENUMBRA_TRY(auto agreement, agree(camera, input, options.anchor, options));
  if (anchor_is_doubtful(agreement, input, options.anchor)) return blame(camera, input, options);
  TagGraph& graph = agreement.settled.graph;
  TagSurvey result;
  result.rms_px = agreement.settled.rms_px;
  if (result.rms_px > 3.0) {
    return fail(
        "the tags contradict each other by {:.1f} px: did some of them move, are the sizes right, "
        "and is the camera's file of this camera?",
        result.rms_px);
  }
  PENUMBRA_TRY(const auto covariance, graph.covariance());
  Result<CameraModel> lens = graph.camera();
  if (!lens) {
    return fail(
        "the sweep leads to no lens ({}); look at the tags from lower and from more sides, or "
        "leave the camera as it is",
        lens.error().message);
  }
  result.camera = std::move(*lens);
  result.lens_covariance = covariance.lens;
  if (options.refine_camera) {
    const double spread = std::sqrt(covariance.lens(0, 0)) / result.camera.parameters().fx;
    if (!(spread < kMostLensSpread)) {
      return fail(
          "the sweep leaves the focal length open by {:.1f} %; look at the tags from lower and "
          "from more sides, or leave the camera as it is",
          spread * 100.0);
    }
  }
  result.clustering = covariance.clustering;
  result.edge_shift_px = graph.shift;
  result.cameras.resize(frames.size());
  for (std::size_t f = 0; f < graph.frames.size(); ++f) {
    if (!graph.cameras[f] || graph.frames[f].empty()) continue;
    ++result.frames_used;
    result.cameras[input.of[f]] =
        unpacked<frame::Camera, frame::Table>(*graph.cameras[f]).inverse();
  }
  std::map<int, TagPose> poses;
  for (const auto& [id, pose] : graph.tags) {
    poses[id] = unpacked<frame::Table, frame::Tag>(pose);
    SurveyedTag tag;
    tag.tag.id = id;
    tag.tag.family = options.family;
    tag.tag.size_m = size_of(options, id);
    tag.frames = static_cast<int>(graph.seen_of(id).size());
    result.tags.push_back(tag);
  }
  const std::vector<int> on_plane = options.plane == SurveyPlane::fitted
                                        ? tags_on_table(poses, options.anchor, options)
                                        : std::vector{options.anchor};
  settle_on_plane(result, std::move(poses), covariance, on_plane, options.anchor);
  const TagPose T_table_anchor =
      std::find_if(result.tags.begin(), result.tags.end(), [&](const SurveyedTag& tag) {
        return tag.tag.id == options.anchor;
      })->tag.T_table_tag;
  const Transform<frame::Table, frame::Table> settled_on(T_table_anchor.rotation(),
                                                         T_table_anchor.translation());
  std::set<int> left_out = input.without_size;
  for (const auto& [id, count] : input.seen) {
    if (graph.tags.count(id) == 0) left_out.insert(id);
  }
  for (const int id : left_out) {
    const auto reported = agreement.others.find(id);
    if (reported != agreement.others.end()) {
      result.left_out.push_back(reported->second.words);
      if (reported->second.apparent) {
        result.misfits.push_back(*reported->second.apparent);
        result.misfits.back().T_table_tag = settled_on * result.misfits.back().T_table_tag;
      }
    } else if (input.without_size.count(id) > 0) {
      result.left_out.push_back(fmt::format("tag {}: has no size", id));
    } else {
      const int count = input.seen.at(id);
      result.left_out.push_back(
          fmt::format("tag {}: seen in {} frame{}, not often enough with others that are placed",
                      id, count, count == 1 ? "" : "s"));
    }
  }
  return result;
}

SurveyFrame measured_frame(const TagSurvey& survey, std::size_t index, const SurveyFrame& frame,
                           ImageView luma) {
  SurveyFrame result = frame;
  result.measured.assign(frame.tags.size(), std::nullopt);
  if (index >= survey.cameras.size() || !survey.cameras[index]) return result;
  const auto T_camera_table = survey.cameras[index]->inverse();
  for (std::size_t i = 0; i < frame.tags.size(); ++i) {
    const int id = frame.tags[i].id;
    const auto placed = std::find_if(survey.tags.begin(), survey.tags.end(),
                                     [id](const SurveyedTag& tag) { return tag.tag.id == id; });
    const auto misfit = std::find_if(survey.misfits.begin(), survey.misfits.end(),
                                     [id](const MappedTag& tag) { return tag.id == id; });
    if (placed == survey.tags.end() && misfit == survey.misfits.end()) continue;
    const MappedTag& tag = placed != survey.tags.end() ? placed->tag : *misfit;
    const auto pattern = TagPattern::make(tag.family, tag.id);
    if (!pattern) continue;
    result.measured[i] =
        measure_tag(luma, survey.camera, *pattern, tag.size_m, T_camera_table * tag.T_table_tag);
  }
  return result;
}

Result<void> save_tag_survey(const std::filesystem::path& file, const TagSurvey& survey) {
  std::string text =
      "# Tag frame: origin at the tag's centre, x right and y up on the upright printed tag, z out "
      "of\n# the paper. size_m: edge of the black border's outer square. position, "
      "quaternion_xyzw: the tag\n# frame in the table frame. covariance: of [position; rotation] "
      "about table axes [m, rad], row by\n# row.\ntags:\n";
  for (const SurveyedTag& tag : survey.tags) {
    const Eigen::Vector3d& p = tag.tag.T_table_tag.translation();
    const Eigen::Quaterniond& q = tag.tag.T_table_tag.rotation();
    const Eigen::Matrix<double, 6, 6, Eigen::RowMajor> covariance = tag.covariance;
    text += fmt::format(
        "  - {{id: {}, family: {}, size_m: {}, position: [{}, {}, {}], "
        "quaternion_xyzw: [{}, {}, {}, {}],\n     covariance: [{}]}}\n",
        tag.tag.id, to_string(tag.tag.family), tag.tag.size_m, p.x(), p.y(), p.z(), q.x(), q.y(),
        q.z(), q.w(),
        joined({covariance.data(), static_cast<std::size_t>(covariance.size())}, "{:.6g}"));
  }
  return write_text_file(file, text);
}

Result<std::map<int, double>> load_tag_sizes(const std::filesystem::path& file) {
  PENUMBRA_TRY(const YAML::Node root, load_yaml_map(file));
  try {
    std::map<int, double> sizes;
    if (YamlFields(root, file.string()).has("tags")) {
      PENUMBRA_TRY(const TagMap map, load_tag_map(file));
      for (const MappedTag& tag : map.tags()) sizes[tag.id] = tag.size_m;
      return sizes;
    }
    for (const auto& entry : root) {
      const std::string key = entry.first.IsScalar() ? entry.first.Scalar() : "";
      const std::int64_t id = parse_integer(key).value_or(-1);
      const double size =
          entry.second.IsScalar() ? parse_number(entry.second.Scalar()).value_or(0.0) : 0.0;
      if (id < 0 || id > 1'000'000 || !(size >= 0.001 && size <= 10.0)) {
        return fail("{}: line {}: is no tag's size; give ID: METRES (0.001 to 10)", file.string(),
                    entry.first.Mark().line + 1);
      }
      sizes[static_cast<int>(id)] = size;
    }
    if (sizes.empty()) return fail("{}: names no tag; give lines of ID: METRES", file.string());
    return sizes;
  } catch (const std::exception& error) {  // yaml-cpp's own, should one get past the checks
    return fail("{}: is not readable as sizes of tags ({}); correct the file", file.string(),
                error.what());
  }
}

}  // namespace penumbra
