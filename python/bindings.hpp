// Shared by the files of the Python module: conversions between numpy arrays and the types of the
// library, and checks of arguments. The module uses only the public headers.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <penumbra/error.hpp>
#include <penumbra/types.hpp>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

namespace penumbra::python {

namespace py = pybind11;

// An array of a wrong shape, or a name that is none of the choices; penumbra.ArgumentError in
// Python. Wrong types are py::type_error.
class ArgumentError : public std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

// Each adds its classes and functions to the module. The order matters for default arguments and
// signatures: types first.
void bind_types(py::module_& module);
void bind_tracking(py::module_& module);
void bind_shadow(py::module_& module);
void bind_calibration(py::module_& module);
void bind_evaluation(py::module_& module);

// Values of an enumeration and their names in Python, which are those of the program's options.
template <class Enum, std::size_t N>
using Names = std::array<std::pair<std::string_view, Enum>, N>;

[[noreturn]] void throw_unknown_name(std::string_view argument, const std::string& name,
                                     const std::vector<std::string_view>& choices);

template <class Enum, std::size_t N>
[[nodiscard]] Enum value_of(const Names<Enum, N>& names, std::string_view argument,
                            const std::string& name) {
  std::vector<std::string_view> choices;
  for (const auto& [choice, value] : names) {
    if (choice == name) return value;
    choices.push_back(choice);
  }
  throw_unknown_name(argument, name, choices);
}
template <class Enum, std::size_t N>
[[nodiscard]] std::string name_of(const Names<Enum, N>& names, Enum value) {
  for (const auto& [name, candidate] : names) {
    if (candidate == value) return std::string(name);
  }
  return {};
}

// Throws if a pickled object does not have this number of fields.
void check_fields(const py::tuple& state, std::size_t count);

// "float32 array of shape (480, 640)", "list".
[[nodiscard]] std::string describe(const py::object& value);

// Returns the pixels of a numpy array without a copy. An empty `format` is grey8 or rgb24 by the
// shape. Throws if the array is not of uint8 or its pixels are not next to each other in a row.
[[nodiscard]] types::ImageView image_view(const py::object& image, const std::string& format);

// Returns the image as a read-only array that shares its pixels.
[[nodiscard]] py::array array_of(const types::Image& image);

// Returns the value as a contiguous array of doubles (a copy only if it is none yet).
using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;
[[nodiscard]] Doubles doubles(const py::object& value, std::string_view argument);
// `shape`: as "N x 3" in messages.
[[noreturn]] void throw_shape(const py::object& value, std::string_view argument,
                              std::string_view shape);

// N numbers.
template <std::size_t N>
[[nodiscard]] std::array<double, N> numbers(const py::object& value, std::string_view argument) {
  const Doubles given = doubles(value, argument);
  if (given.ndim() != 1 || given.shape(0) != static_cast<py::ssize_t>(N)) {
    throw_shape(value, argument, std::to_string(N) + " numbers");
  }
  std::array<double, N> result{};
  for (std::size_t i = 0; i < N; ++i) result[i] = given.data()[i];
  return result;
}

// An array of rows of N numbers.
template <std::size_t N>
[[nodiscard]] std::vector<std::array<double, N>> rows(const py::object& value,
                                                      std::string_view argument) {
  const Doubles given = doubles(value, argument);
  if (given.size() == 0) return {};
  if (given.ndim() != 2 || given.shape(1) != static_cast<py::ssize_t>(N)) {
    throw_shape(value, argument, "N x " + std::to_string(N));
  }
  std::vector<std::array<double, N>> result(static_cast<std::size_t>(given.shape(0)));
  for (std::size_t i = 0; i < result.size(); ++i) {
    for (std::size_t k = 0; k < N; ++k) result[i][k] = given.data()[i * N + k];
  }
  return result;
}

// New array of the values.
template <std::size_t N>
[[nodiscard]] py::array_t<double> array_of(const std::array<double, N>& values) {
  return py::array_t<double>(static_cast<py::ssize_t>(N), values.data());
}
// New array of shape rows x columns, row by row.
[[nodiscard]] py::array_t<double> matrix_of(const double* values, std::size_t rows,
                                            std::size_t columns);
template <std::size_t N>
[[nodiscard]] py::array_t<double> array_of(const std::vector<std::array<double, N>>& values) {
  return matrix_of(values.empty() ? nullptr : values.front().data(), values.size(), N);
}
// Read-only array of the values of `owner`, which it keeps alive. They must not change.
template <std::size_t N>
[[nodiscard]] py::array shared_array(const std::vector<std::array<double, N>>& values,
                                     const py::object& owner) {
  py::array_t<double> array({values.size(), N}, values.empty() ? nullptr : values.front().data(),
                            owner);
  array.attr("setflags")(py::arg("write") = false);
  return array;
}

// The 4 x 4 matrix of a pose. The translation has the same bits.
[[nodiscard]] std::array<double, 16> matrix_of(const types::Pose& pose);
[[nodiscard]] py::array_t<double> array_of(const types::Pose& pose);
// Returns a pose from a Pose or a 4 x 4 matrix.
[[nodiscard]] types::Pose pose_of(const py::object& value, std::string_view argument);

// Nanoseconds from a Python or numpy integer. Throws for floats, so that seconds are not taken for
// nanoseconds.
[[nodiscard]] std::int64_t nanoseconds(const py::object& value, std::string_view argument);

// A sequence of strings. Throws for a single string, which Python would split into letters.
[[nodiscard]] std::vector<std::string> strings(const py::object& value, std::string_view argument);

// Marks an object as in use by one call. Other threads run while a call computes, and these
// objects are not thread-safe.
class Busy {
 public:
  // `object`: in the message if another call uses the object.
  Busy(std::atomic<bool>& flag, const char* object) : flag_(flag) {
    if (flag_.exchange(true)) {
      throw Exception(std::string(object) +
                      ": is in use by another thread; give each thread its own object");
    }
  }
  Busy(const Busy&) = delete;
  Busy& operator=(const Busy&) = delete;
  ~Busy() { flag_ = false; }

 private:
  std::atomic<bool>& flag_;
};

// Set by the module when the interpreter begins to end.
inline std::atomic<bool> interpreter_ends = false;

// Releases the global interpreter lock. While the interpreter ends, Python would end a daemon
// thread that takes the lock again by unwinding its stack, which can abort the process. Such a
// thread waits for the end of the process instead.
class Unlocked {
 public:
  Unlocked() : state_(PyEval_SaveThread()) {}
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;
  ~Unlocked() noexcept(false) {
    while (interpreter_ends) std::this_thread::sleep_for(std::chrono::hours(1));
    PyEval_RestoreThread(state_);
  }

 private:
  PyThreadState* state_;
};

// Runs a function of the library without the global interpreter lock.
template <class Function>
decltype(auto) unlocked(Function&& function) {
  const Unlocked release;
  return std::forward<Function>(function)();
}

}  // namespace penumbra::python
