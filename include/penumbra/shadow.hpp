// Shadows of a model on a plane, as outlines. The formulas and their sources are in
// docs/shadows.md.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <penumbra/api.hpp>
#include <penumbra/types.hpp>
#include <string>
#include <vector>

namespace penumbra::shadow {

using types::Pose;
using types::Vector2;
using types::Vector3;

// Triangles in the object frame [m], z up. Triangles may overlap and have either orientation.
struct Mesh {
  std::vector<Vector3> positions;
  std::vector<std::array<std::uint32_t, 3>> triangles;  // indices into `positions`
};

// Which axis of the file points up. by_format: y of glTF, z of OBJ.
enum class UpAxis { by_format, y, z };

struct ModelOptions {
  UpAxis up = UpAxis::by_format;
  double unit_m = 1.0;  // length of the file's unit [m]
};

// A model that casts shadows. Object frame: z up, metres; a glTF file is turned when it is read,
// (x, y, z) -> (x, -z, y). Immutable; copies are cheap and share their data.
class PENUMBRA_API Model {
 public:
  // Throws for a mesh without triangles, an index out of range, or a coordinate that is not finite
  // or above 1e6 m. `name` is the model's name in messages.
  explicit Model(const Mesh& mesh, const std::string& name = "mesh");
  // Reads a .glb, .gltf or .obj file.
  [[nodiscard]] static Model load(const std::filesystem::path& file,
                                  const ModelOptions& options = {});
  Model(const Model&);
  Model& operator=(const Model&);
  ~Model();

  [[nodiscard]] std::size_t vertex_count() const;
  [[nodiscard]] std::size_t triangle_count() const;
  // About content of the file that is ignored, one line each.
  [[nodiscard]] const std::vector<std::string>& warnings() const;

 private:
  friend struct Access;
  struct Impl;
  PENUMBRA_LOCAL explicit Model(std::shared_ptr<const Impl> impl);
  std::shared_ptr<const Impl> impl_;
};

// How shadow kernels are computed (docs/shadows.md#kernels).
enum class KernelSource {
  automatic,  // centre of the largest disc near the vertex, in the silhouette of its part
  smooth,     // mean over all discs near a vertex: fewer twisted faces
  per_axis,   // composed of three kernel sets, one per axis (Layered Penumbrae, section 5.3)
  centroid,   // COCL: one kernel for the whole object, the centroid of its footprint
};

// Shadow kernels: for each vertex, the point from which the layers grow and to which the umbra
// shrinks. They depend on the model and on the direction that points up from the plane. Immutable.
class PENUMBRA_API Kernels {
 public:
  // `up`: direction in the object frame, of any length. `groups`: names of nodes, with wildcards,
  // whose parts share one light; "all" joins everything.
  [[nodiscard]] static Kernels make(const Model& model, const Vector3& up = {0.0, 0.0, 1.0},
                                    KernelSource source = KernelSource::automatic,
                                    const std::vector<std::string>& groups = {});
  // Reads a kernel file (JSON, docs/files.md).
  [[nodiscard]] static Kernels load(const std::filesystem::path& file);
  Kernels(const Kernels&);
  Kernels& operator=(const Kernels&);
  ~Kernels();

  // Writes a kernel file (JSON).
  void save(const std::filesystem::path& file) const;
  [[nodiscard]] Vector3 up() const;                   // unit, object frame
  [[nodiscard]] std::vector<Vector3> points() const;  // object frame [m], in the order of the file

 private:
  friend struct Access;
  struct Impl;
  PENUMBRA_LOCAL explicit Kernels(std::shared_ptr<const Impl> impl);
  std::shared_ptr<const Impl> impl_;
};

enum class Technique {
  layered,  // umbra, middle layer and penumbra, about kernels
  field,    // the same layers for one light size per part, without kernels
  simple,   // orthogonal projection onto the plane
  hard,     // projection from a point or directional light
};

enum class LightMode {
  proportional,  // the light's size follows the thickness of each part
  fixed,         // the light has one size for each part
};

// The constants of layers (docs/shadows.md#constants): height H of the light over the plane, which
// may be infinite, and its ratio a = light radius / object radius. The umbra vanishes at H / a.
struct LightConstants {
  double height_m = 0.9;                                // H
  std::optional<double> ratio = std::nullopt;           // a; 3 if neither is given
  std::optional<double> umbra_height_m = std::nullopt;  // H / a; an infinite H needs it
};

// Returns the constants for objects up to `max_height_m` above the plane, where the umbra vanishes
// and the middle layer is magnified by `magnification` > 1.
[[nodiscard]] PENUMBRA_API LightConstants light_for_workspace(double max_height_m,
                                                              double magnification);

// A point of the plane and its normal, of any length, towards the light. Coordinates (u, v) on the
// plane: v = n x u, and u is the projection of the x axis, or of y if n is near the x axis.
struct Plane {
  Vector3 normal{0.0, 0.0, 1.0};
  Vector3 point{0.0, 0.0, 0.0};
};

struct Options {
  Technique technique = Technique::layered;
  Pose T_world_object = {};
  double scale = 1.0;  // of the object, > 0
  Plane plane = {};    // world frame
  LightConstants light = {};
  KernelSource kernel_source = KernelSource::automatic;
  std::optional<Kernels> kernels = {};  // used instead of kernel_source
  LightMode light_mode = LightMode::proportional;
  std::vector<std::string> groups = {};  // as in Kernels::make()
  // hard: a position (x, y, z, 1) [m] or a direction towards the light (x, y, z, 0); world frame.
  std::array<double, 4> hard_light{0.0, 0.0, 1.0, 0.0};
};

// In coordinates (u, v) of the plane [m]. The first corner is not repeated.
struct Polygon {
  std::vector<Vector2> outer;               // counter-clockwise
  std::vector<std::vector<Vector2>> holes;  // clockwise
};

struct Layer {
  std::string name;  // "umbra", "middle", "penumbra"; simple and hard: "shadow"
  double area_m2 = 0.0;
  std::vector<Polygon> polygons;  // disjoint
};

struct Shadow {
  std::vector<Layer> layers;      // umbra, middle, penumbra; simple and hard: one
  Layer object;                   // "object": the model seen from straight above the plane
  std::string kernel_source;      // as `penumbra shadow` writes it
  std::size_t twisted_faces = 0;  // faces that fold over in a layer
  std::vector<std::string> warnings;
};

// Computes the shadow, with the same numbers as `penumbra shadow`. Throws for a value that is not
// finite or out of range, and for kernels of a model with another number of vertices. Kernels made
// before the model changed are computed again, with a warning. Thread-safe.
[[nodiscard]] PENUMBRA_API Shadow cast(const Model& model, const Options& options = {});

}  // namespace penumbra::shadow
