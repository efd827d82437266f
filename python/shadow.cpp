// Model, Kernels, make_kernels() and shadow_layers().
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <limits>
#include <penumbra/shadow.hpp>

#include "bindings.hpp"

namespace penumbra::python {
namespace {

using shadow::Kernels;
using shadow::KernelSource;
using shadow::Layer;
using shadow::LightConstants;
using shadow::Model;
using shadow::Shadow;

constexpr Names<shadow::UpAxis, 2> kUpAxes = {{
    {"y", shadow::UpAxis::y},
    {"z", shadow::UpAxis::z},
}};

constexpr Names<KernelSource, 4> kKernelSources = {{
    {"auto", KernelSource::automatic},
    {"smooth", KernelSource::smooth},
    {"per-axis", KernelSource::per_axis},
    {"cocl", KernelSource::centroid},
}};

constexpr Names<shadow::Technique, 4> kTechniques = {{
    {"layered", shadow::Technique::layered},
    {"field", shadow::Technique::field},
    {"simple", shadow::Technique::simple},
    {"hard", shadow::Technique::hard},
}};

constexpr Names<shadow::LightMode, 2> kLightModes = {{
    {"proportional", shadow::LightMode::proportional},
    {"fixed", shadow::LightMode::fixed},
}};

std::vector<std::array<std::uint32_t, 3>> triangles_of(const py::object& value) {
  const auto given = py::array::ensure(value);
  if (!given || (given.size() > 0 && given.dtype().kind() != 'i' && given.dtype().kind() != 'u')) {
    PyErr_Clear();
    throw py::type_error("triangles: is a " + describe(given ? py::object(given) : value) +
                         "; give integers, three indices of vertices in each row");
  }
  if (given.size() == 0) return {};
  if (given.ndim() != 2 || given.shape(1) != 3) throw_shape(given, "triangles", "N x 3");
  const auto indices = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>(given);
  std::vector<std::array<std::uint32_t, 3>> triangles(static_cast<std::size_t>(given.shape(0)));
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::int64_t index = indices.data()[3 * i + k];
      // The library checks the index against the number of vertices.
      if (index < 0 || index > std::numeric_limits<std::uint32_t>::max()) {
        throw ArgumentError("triangles[" + std::to_string(i) + "]: " + std::to_string(index) +
                            " is no index of a vertex");
      }
      triangles[i][k] = static_cast<std::uint32_t>(index);
    }
  }
  return triangles;
}

Shadow shadow_layers(const Model& model, const py::object& T_world_object, double scale,
                     const py::object& plane_normal, const py::object& plane_point,
                     const std::string& technique, const std::optional<LightConstants>& light,
                     const py::object& kernels, const std::string& light_mode,
                     const py::object& groups, const py::object& hard_light) {
  shadow::Options options;
  options.technique = value_of(kTechniques, "technique", technique);
  if (!T_world_object.is_none()) {
    options.T_world_object = pose_of(T_world_object, "T_world_object");
  }
  options.scale = scale;
  options.plane = {numbers<3>(plane_normal, "plane_normal"),
                   numbers<3>(plane_point, "plane_point")};
  if (light) options.light = *light;
  if (py::isinstance<Kernels>(kernels)) {
    options.kernels = kernels.cast<const Kernels&>();
  } else if (py::isinstance<py::str>(kernels)) {
    options.kernel_source = value_of(kKernelSources, "kernels", kernels.cast<std::string>());
  } else {
    throw py::type_error("kernels: is a " + describe(kernels) +
                         "; give the name of a source, or penumbra.Kernels");
  }
  options.light_mode = value_of(kLightModes, "light_mode", light_mode);
  options.groups = strings(groups, "groups");
  options.hard_light = numbers<4>(hard_light, "hard_light");
  return unlocked([&] { return shadow::cast(model, options); });
}

void bind_models(py::module_& module) {
  py::class_<Model>(module, "Model", R"(A model that casts shadows. Immutable; threads may share it.

Object frame: z up, metres. A glTF file is turned when it is read, (x, y, z) -> (x, -z, y).)")
      .def(py::init([](const py::object& positions, const py::object& triangles,
                       const std::string& name) {
             shadow::Mesh mesh = {rows<3>(positions, "positions"), triangles_of(triangles)};
             return unlocked([&] { return Model(mesh, name); });
           }),
           py::arg("positions"), py::arg("triangles"), py::arg("name") = "mesh",
           R"(positions: vertices in the object frame [m], shape (N, 3).
triangles: indices of vertices, shape (M, 3). Triangles may overlap and have either orientation.
name: of the model in messages.

Raises Error without triangles, for an index out of range, or a coordinate that is not finite or
above 1e6 m.)")
      .def_static(
          "load",
          [](const std::filesystem::path& file, const std::optional<std::string>& up,
             double unit_m) {
            shadow::ModelOptions options;
            if (up) options.up = value_of(kUpAxes, "up", *up);
            options.unit_m = unit_m;
            return unlocked([&] { return Model::load(file, options); });
          },
          py::arg("file"), py::kw_only(), py::arg("up") = py::none(), py::arg("unit_m") = 1.0,
          R"(Reads a .glb, .gltf or .obj file.

up: axis of the file that points up, 'y' or 'z'; None: y of glTF, z of OBJ.
unit_m: length of the file's unit [m]. Raises Error.)")
      .def_property_readonly("vertex_count", &Model::vertex_count, "Number of vertices.")
      .def_property_readonly("triangle_count", &Model::triangle_count, "Number of triangles.")
      .def_property_readonly("warnings", &Model::warnings,
                             "About content of the file that is ignored.")
      .def("__repr__", [](const Model& model) {
        return py::str("<penumbra.Model of {} triangles>").format(model.triangle_count());
      });

  py::class_<Kernels>(module, "Kernels", R"(Shadow kernels of a model; make_kernels() makes them.

For each vertex, the point from which the layers grow and to which the umbra shrinks. They depend on
the model and on the direction that points up from the plane. Immutable; threads may share it.)")
      .def_static("load", &Kernels::load, py::arg("file"), py::call_guard<Unlocked>(),
                  "Reads a kernel file (JSON). Raises Error.")
      .def("save", &Kernels::save, py::arg("file"), py::call_guard<Unlocked>(),
           "Writes a kernel file (JSON). Raises Error.")
      .def_property_readonly(
          "up", [](const Kernels& kernels) { return array_of(kernels.up()); },
          "Direction that points up from the plane, a unit vector in the object frame, shape (3,).")
      .def_property_readonly(
          "points", [](const Kernels& kernels) { return array_of(kernels.points()); },
          "Kernels in the object frame [m], shape (N, 3), in the order of the file.")
      .def("__repr__", [](const Kernels& kernels) {
        return py::str("<penumbra.Kernels of {} vertices>").format(kernels.points().size());
      });
}

void bind_results(py::module_& module) {
  py::class_<shadow::Polygon>(module, "Polygon", "A polygon of a layer, in the plane [m].")
      .def_property_readonly(
          "outer",
          [](const py::object& self) {
            return shared_array(self.cast<const shadow::Polygon&>().outer, self);
          },
          "Corners (u, v), counter-clockwise, shape (N, 2). The first is not repeated. Read-only.")
      .def_property_readonly(
          "holes",
          [](const py::object& self) {
            py::list holes;
            for (const auto& hole : self.cast<const shadow::Polygon&>().holes) {
              holes.append(shared_array(hole, self));
            }
            return holes;
          },
          "Corners of each hole, clockwise. Read-only.");

  py::class_<Layer>(module, "Layer", R"(A layer of a shadow, in coordinates (u, v) of the plane [m].

v = n x u for the normal n, and u is the projection of the x axis, or of y if n is near the x axis.)")
      .def_readonly("name", &Layer::name, "'umbra', 'middle', 'penumbra', 'shadow' or 'object'.")
      .def_readonly("area_m2", &Layer::area_m2, "Area [m^2].")
      .def_property_readonly(
          "polygons",
          [](const py::object& self) {
            py::list polygons;
            for (const shadow::Polygon& polygon : self.cast<const Layer&>().polygons) {
              polygons.append(
                  py::cast(&polygon, py::return_value_policy::reference_internal, self));
            }
            return polygons;
          },
          "Disjoint Polygons.")
      .def("__repr__", [](const Layer& layer) {
        return py::str("<penumbra.Layer '{}' of {:.6g} m^2>").format(layer.name, layer.area_m2);
      });

  py::class_<Shadow>(module, "Shadow", "The shadow of a model on a plane.")
      .def_property_readonly(
          "layers",
          [](const py::object& self) {
            py::dict layers;
            for (const Layer& layer : self.cast<const Shadow&>().layers) {
              layers[py::str(layer.name)] =
                  py::cast(&layer, py::return_value_policy::reference_internal, self);
            }
            return layers;
          },
          "Layers by name: 'umbra', 'middle' and 'penumbra'; of the techniques 'simple' and 'hard' "
          "only 'shadow'.")
      .def_readonly("object", &Shadow::object, "Layer: the model seen from straight above.")
      .def_readonly("kernel_source", &Shadow::kernel_source,
                    "Where the kernels come from, as `penumbra shadow` writes it.")
      .def_readonly("twisted_faces", &Shadow::twisted_faces,
                    "Number of faces that fold over in a layer.")
      .def_readonly("warnings", &Shadow::warnings, "Warnings, one line each.")
      .def("__repr__", [](const Shadow& shadow) {
        return py::str("<penumbra.Shadow of {} layers>").format(shadow.layers.size());
      });
}

void bind_light(py::module_& module) {
  py::class_<LightConstants>(module, "LightConstants", R"(The constants of layers. Immutable.

The height H of the light over the plane, and the ratio a of the radii of light and object. The umbra
vanishes at the height H / a.)")
      .def(py::init([](double height_m, std::optional<double> ratio,
                       std::optional<double> umbra_height_m) {
             return LightConstants{height_m, ratio, umbra_height_m};
           }),
           py::arg("height_m") = 0.9, py::arg("ratio") = py::none(),
           py::arg("umbra_height_m") = py::none(),
           R"(height_m: H [m]; may be infinite, and then needs umbra_height_m.
ratio: a; 3 if neither is given.
umbra_height_m: H / a [m], instead of the ratio.)")
      .def_readonly("height_m", &LightConstants::height_m, "Height H of the light [m].")
      .def_readonly("ratio", &LightConstants::ratio, "Ratio a, or None.")
      .def_readonly("umbra_height_m", &LightConstants::umbra_height_m,
                    "Height H / a at which the umbra vanishes [m], or None.")
      .def("__repr__", [](const LightConstants& light) {
        return py::str("LightConstants(height_m={}, ratio={}, umbra_height_m={})")
            .format(light.height_m, light.ratio, light.umbra_height_m);
      });
  module.def("light_for_workspace", &shadow::light_for_workspace, py::arg("max_height_m"),
             py::arg("magnification"), R"(LightConstants for objects up to a height over the plane.

max_height_m: where the umbra vanishes and the middle layer is magnified by `magnification` [m].
magnification: above 1. Raises Error.)");
}

}  // namespace

void bind_shadow(py::module_& module) {
  bind_models(module);
  bind_results(module);
  bind_light(module);
  module.def(
      "make_kernels",
      [](const Model& model, const py::object& up, const std::string& source,
         const py::object& groups) {
        const shadow::Vector3 direction = numbers<3>(up, "up");
        const KernelSource chosen = value_of(kKernelSources, "source", source);
        const std::vector<std::string> names = strings(groups, "groups");
        return unlocked([&] { return Kernels::make(model, direction, chosen, names); });
      },
      py::arg("model"), py::arg("up") = py::make_tuple(0.0, 0.0, 1.0), py::arg("source") = "auto",
      py::arg("groups") = py::tuple(), R"(Computes the shadow kernels of a model.

up: direction away from the plane, in the object frame, of any length.
source: 'auto' (centre of the largest disc near the vertex), 'smooth' (mean of the discs), 'per-axis'
    (composed of three kernel sets), or 'cocl' (one kernel for the whole object).
groups: names of nodes, with wildcards, whose parts share one light; 'all' joins everything.

Raises Error. Thread-safe; other Python threads run meanwhile.)");
  module.def("shadow_layers", &shadow_layers, py::arg("model"), py::kw_only(),
             py::arg("T_world_object") = py::none(), py::arg("scale") = 1.0,
             py::arg("plane_normal") = py::make_tuple(0.0, 0.0, 1.0),
             py::arg("plane_point") = py::make_tuple(0.0, 0.0, 0.0),
             py::arg("technique") = "layered", py::arg("light") = py::none(),
             py::arg("kernels") = "auto", py::arg("light_mode") = "proportional",
             py::arg("groups") = py::tuple(),
             py::arg("hard_light") = py::make_tuple(0.0, 0.0, 1.0, 0.0),
             R"(Computes the shadow of a model on a plane, with the numbers of `penumbra shadow`.

T_world_object: a Pose or a 4 x 4 matrix; None: the model stands at the world's origin.
scale: of the model, above 0.
plane_normal, plane_point: towards the light, of any length, and a point of the plane [m]; in the
    world frame.
technique: 'layered' (umbra, middle layer and penumbra), 'field' (these without kernels), 'simple'
    (orthogonal projection) or 'hard' (projection from a light).
light: LightConstants; None: H = 0.9 m, a = 3.
kernels: a source, as for make_kernels(), or Kernels.
light_mode: 'proportional' (the size of the light follows the thickness of each part) or 'fixed'.
groups: as for make_kernels().
hard_light: of 'hard', in the world frame: a position (x, y, z, 1) [m] or a direction towards the
    light (x, y, z, 0).

Returns a Shadow. Raises Error for a value that is not finite or out of range, and for kernels of a
model with another number of vertices. Thread-safe; other Python threads run meanwhile.)");
}

}  // namespace penumbra::python
