// The extension module penumbra._penumbra; the package penumbra passes its names on.
#include <penumbra/version.hpp>

#include "bindings.hpp"

namespace penumbra::python {
namespace {

// Exceptions live as long as the interpreter.
PyObject* error_type = nullptr;
PyObject* argument_error_type = nullptr;

PyObject* make_exception(py::module_& module, const char* name, const char* text,
                         const py::object& bases) {
  PyObject* type = PyErr_NewExceptionWithDoc((std::string("penumbra.") + name).c_str(), text,
                                             bases.ptr(), nullptr);
  if (type == nullptr) throw py::error_already_set();
  module.add_object(name, type);
  return type;
}

// Messages may hold the bytes of a file's name that are no UTF-8.
void raise(PyObject* type, const char* message) {
  const auto text = py::reinterpret_steal<py::object>(PyUnicode_DecodeUTF8(
      message, static_cast<Py_ssize_t>(std::char_traits<char>::length(message)),
      "backslashreplace"));
  if (text) PyErr_SetObject(type, text.ptr());
}

// Throws if the loaded library is not the version that the module was compiled for.
void check_library() {
  const std::string version = library_version();
  const std::string expected =
      std::to_string(PENUMBRA_VERSION_MAJOR) + "." + std::to_string(PENUMBRA_VERSION_MINOR) + ".";
  if (!version.starts_with(expected)) {
    throw py::import_error("penumbra: the module is for libpenumbra " + expected +
                           "x, but version " + version +
                           " is loaded; install both from one version");
  }
}

void bind_errors(py::module_& module) {
  error_type = make_exception(
      module, "Error",
      "A call that failed. The message is one line: the file or argument, the cause and the "
      "remedy.\n\nThe object on which the call was made is as before, unless the method says "
      "otherwise.",
      py::reinterpret_borrow<py::object>(PyExc_RuntimeError));
  argument_error_type = make_exception(
      module, "ArgumentError",
      "An array of the wrong shape, or a string that is none of the choices. A value of the wrong "
      "type, such as an image of floats, is a TypeError.",
      py::make_tuple(py::handle(error_type), py::handle(PyExc_ValueError)));
  py::register_local_exception_translator([](std::exception_ptr pointer) {
    try {
      if (pointer) std::rethrow_exception(pointer);
    } catch (const ArgumentError& error) {
      raise(argument_error_type, error.what());
    } catch (const Exception& error) {
      raise(error_type, error.what());
    }
  });
}

}  // namespace
}  // namespace penumbra::python

PYBIND11_MODULE(_penumbra, module) {
  using namespace penumbra::python;
  check_library();
  // Texts and messages show penumbra.Tracker, the name in the package.
  const py::object name = module.attr("__name__");
  module.attr("__name__") = "penumbra";
  module.attr("__version__") = penumbra::library_version();
  bind_errors(module);
  bind_types(module);
  bind_tracking(module);
  bind_shadow(module);
  bind_calibration(module);
  bind_evaluation(module);
  module.attr("__name__") = name;
  py::module_::import("atexit").attr("register")(py::cpp_function([] { interpreter_ends = true; }));
}
