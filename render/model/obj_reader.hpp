// Components of the OBJ reader: text lines, materials, and meshes from faces. Internal to render.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"
#include "render/model/model.hpp"

namespace penumbra {

// Returns the words of a line, separated by blanks and tabs, without the comment.
[[nodiscard]] std::vector<std::string_view> obj_words(std::string_view line);
// Returns the line after its first word, trimmed.
[[nodiscard]] std::string_view after_keyword(std::string_view line);
// Returns 0 if the number underflows a double, nullopt if it overflows or is not a number.
[[nodiscard]] std::optional<double> finite_number(std::string_view word);
// Returns true for a number with a decimal comma, "0,5".
[[nodiscard]] bool has_decimal_comma(std::string_view word);
[[nodiscard]] bool is_one_of(std::string_view key, std::span<const std::string_view> keys);

// Collects warnings of a text file: one per kind, with its first line and the number of lines.
class LineWarnings {
 public:
  explicit LineWarnings(std::string file) : file_(std::move(file)) {}
  void add(std::size_t line, std::string_view kind);
  void append_to(std::vector<std::string>& warnings) const;

 private:
  struct Kind {
    std::string text;
    std::size_t first_line = 0, last_line = 0, count = 0;
  };
  std::string file_;
  std::vector<Kind> kinds_;
};

struct ObjCorner {
  std::int32_t position = -1, texcoord = -1, normal = -1;  // -1: none
};
struct ObjFace {
  std::size_t first_corner = 0;
  std::uint32_t corner_count = 0;
  std::int32_t material = -1;  // index into ObjFile::material_names
  std::uint32_t node = 0;      // index into ObjFile::nodes
  std::uint32_t line = 0;
};

// The contents of the file, with zero-based, validated indices.
struct ObjFile {
  std::vector<Eigen::Vector3d> positions;
  std::vector<glm::vec3> colors;  // sRGB-encoded, 0 to 1; one per position, or empty
  std::vector<glm::vec2> texcoords;
  std::vector<glm::vec3> normals;
  std::vector<ObjCorner> corners;
  std::vector<ObjFace> faces;
  std::vector<ModelNode> nodes;             // objects and groups with faces
  std::vector<std::string> material_names;  // from usemtl lines
  double step = 0.0;                        // resolution of the positions, set by add_obj_meshes()
};

struct ObjMaterial {
  Material material;
  std::string image;          // file of map_Kd, as written; may be ""
  bool clamps = false;        // the image is not repeated
  bool has_dissolve = false;  // a `d` line, which overrides `Tr`
};

// Materials of the .mtl files in mtllib lines. Errors in them become warnings.
class ObjMaterials {
 public:
  ObjMaterials(const std::filesystem::path& model_file, const ModelLimits& limits)
      : folder_(model_file.parent_path()), model_name_(model_file.string()), limits_(limits) {}

  // Reads the files of an mtllib line: one file with blanks in its name, or several files.
  void read_files(std::string_view names, std::size_t line);
  [[nodiscard]] std::optional<std::size_t> find(const std::string& name) const;
  // Moves all materials into the model, followed by the default material. `used`: per material,
  // whether to load its image.
  void move_to(Model& model, const std::vector<bool>& used);
  [[nodiscard]] std::size_t size() const { return materials_.size(); }
  [[nodiscard]] bool is_incomplete() const { return incomplete_; }  // a file could not be read

 private:
  void read_file_named(const std::string& name, std::size_t line);
  void read_text(std::string_view text, const std::string& file);
  void load_image(Model& model, ObjMaterial& from);

  std::filesystem::path folder_;
  std::string model_name_;
  const ModelLimits& limits_;
  std::vector<ObjMaterial> materials_;
  std::map<std::string, std::size_t> by_name_;
  std::map<std::string, int> images_;  // path -> index into Model::textures, -1: unreadable
  std::vector<std::string> warnings_;
  std::vector<std::filesystem::path> read_files_;
  std::set<std::string> files_;  // .mtl files of the mtllib lines so far
  bool incomplete_ = false;
};

// Adds the file's faces to the model: one mesh per material. `materials`: for each of
// ObjFile::material_names, its index into Model::materials.
[[nodiscard]] Result<void> add_obj_meshes(Model& model, ObjFile& file,
                                          const std::vector<int>& materials, LineWarnings& warnings,
                                          const ModelLimits& limits, const std::string& name);

}  // namespace penumbra
