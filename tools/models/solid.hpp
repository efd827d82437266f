// Closed triangle surfaces: lofts, tubes and prisms, painted along curves and joined into a Model.
// Object frame: z up. Lengths are in millimetres here and in metres in the Model.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "render/model/model.hpp"

namespace penumbra::models {

using Point = glm::dvec3;  // [mm]
using Points = std::vector<Point>;
using Field = std::function<double(const Point&)>;  // negative inside

struct Face {
  std::array<std::uint32_t, 3> corners{};  // counter-clockwise seen from outside
  int material = 0;
};

// One or more closed surfaces; adjacent faces share their vertices.
struct Solid {
  Points points;
  std::vector<Face> faces;
};

// Joins rings with equal numbers of points into a tube. Closes each end with a fan around the given
// centre. Faces point outwards for rings of either direction.
[[nodiscard]] Solid loft(const std::vector<Points>& rings, const Point& first_centre,
                         const Point& last_centre);
// A loft with flat ends.
[[nodiscard]] Solid loft(const std::vector<Points>& rings);
// Rotates a profile of (radius, z) about the z axis. The profile of revolve() ends on the axis;
// that of revolve_loop() is a closed loop off the axis.
[[nodiscard]] Solid revolve(const std::vector<glm::dvec2>& profile, int segments);
[[nodiscard]] Solid revolve_loop(const std::vector<glm::dvec2>& profile, int segments);
// A round tube along a path, with one radius for each of its points.
[[nodiscard]] Solid tube(const Points& path, const std::vector<double>& radii, int sides);
[[nodiscard]] Solid tube(const Points& path, double radius, int sides);
[[nodiscard]] Solid sphere(const Point& centre, const Point& radii, int subdivisions);
[[nodiscard]] Solid box(const Point& low, const Point& high);
// A prism between two heights; each edge of the polygon must be visible from `centre`.
[[nodiscard]] Solid prism(const std::vector<glm::dvec2>& outline, const glm::dvec2& centre,
                          double low, double high);

// A smooth curve through points, `steps` pieces between neighbours (centripetal Catmull-Rom).
[[nodiscard]] Points smooth_path(const Points& through, int steps);

[[nodiscard]] Solid moved(Solid solid, const std::function<Point(const Point&)>& map);
[[nodiscard]] Solid turned_about_z(const Solid& solid, double angle_rad);
[[nodiscard]] Solid mirrored_y(const Solid& solid);  // y -> -y, outside stays outside
[[nodiscard]] Solid with_material(Solid solid, int material);
void append(Solid& to, const Solid& more);

// Splits faces along field = 0, so that the field has one sign in each face. Vertices within
// `slide` [mm] and 1/4 of an edge move onto the curve to avoid slivers. The surface stays closed.
void cut(Solid& solid, const Field& field, double slide = 0.4);
// Halves edges longer than `longest` [mm] whose middle is inside, until none is left.
void refine(Solid& solid, const Field& field, double longest);
void recolor(Solid& solid, const Field& field, int material);  // faces whose centre is inside
void paint(Solid& solid, const Field& field, int material);    // cuts, then recolours
// Paints a band between two parallel curves. The faces are cut along each curve separately, so that
// the band may be narrower than a face.
void paint_band(Solid& solid, const Field& field, double half_width, int material);

// Signed distance [mm] to a polygon grown by `radius`, which rounds its corners, in any two
// coordinates.
[[nodiscard]] double rounded_polygon(const std::vector<glm::dvec2>& corners, double radius,
                                     const glm::dvec2& p);

// Adds the solid in metres as one mesh per material, named after the part. Normals are smooth
// across edges bent by less than the crease angle. Coordinates are rounded to a micrometre and
// normals to 1e-5, so that the files are equal on every machine.
void add_part(Model& model, const std::string& name, const Solid& solid, double crease_deg);
int add_material(Model& model, const std::string& name, const glm::vec3& linear_color,
                 float metallic, float roughness, const glm::vec3& emissive = glm::vec3(0.0F));

}  // namespace penumbra::models
