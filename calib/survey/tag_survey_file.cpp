// Writes and reads files of tag surveys.
#include "calib/survey/tag_survey.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/text/yaml_fields.hpp"

namespace penumbra {

Result<void> save_tag_survey(const std::filesystem::path& file, const TagSurvey& survey) {
  std::string text =
      "# Tag frame: origin at the tag's centre, x right and y up on the upright printed tag, z out "
      "of\n# the paper. size_m: edge of the black border's outer square. position, "
      "quaternion_xyzw: the tag\n# frame in the table frame. covariance: of [position; rotation] "
      "about table axes [m, rad], row by\n# row. surface: curvatures [xx, xy, yy] of the paper in "
      "the tag frame [1/m].\ntags:\n";
  for (const SurveyedTag& tag : survey.tags) {
    const Eigen::Vector3d& p = tag.tag.T_table_tag.translation();
    const Eigen::Quaterniond& q = tag.tag.T_table_tag.rotation();
    const Eigen::Matrix<double, 6, 6, Eigen::RowMajor> covariance = tag.covariance;
    const TagCurvature& c = tag.tag.curvature;
    const std::string curved =
        c.is_flat() ? ""
                    : fmt::format("\n     surface: [{:.6g}, {:.6g}, {:.6g}],", c.xx, c.xy, c.yy);
    text += fmt::format(
        "  - {{id: {}, family: {}, size_m: {}, position: [{}, {}, {}], "
        "quaternion_xyzw: [{}, {}, {}, {}],{}\n     covariance: [{}]}}\n",
        tag.tag.id, to_string(tag.tag.family), tag.tag.size_m, p.x(), p.y(), p.z(), q.x(), q.y(),
        q.z(), q.w(), curved,
        joined({covariance.data(), static_cast<std::size_t>(covariance.size())}, "{:.6g}"));
  }
  return write_text_file(file, text);
}

Result<std::map<int, double>> load_tag_sizes(const std::filesystem::path& file) {
  using Sizes = std::map<int, double>;
  return read_yaml_map(file, "sizes of tags", [&](const YAML::Node& root) -> Result<Sizes> {
    Sizes sizes;
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
        return fail("{}: line {}: is not a tag's size; give ID: METRES (0.001 to 10)",
                    file.string(), entry.first.Mark().line + 1);
      }
      sizes[static_cast<int>(id)] = size;
    }
    if (sizes.empty()) return fail("{}: names no tag; give lines of ID: METRES", file.string());
    return sizes;
  });
}

}  // namespace penumbra
