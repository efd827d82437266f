#include <algorithm>
#include <cmath>

#include "bindings.hpp"

namespace penumbra::python {
namespace {

constexpr Names<types::PixelFormat, 7> kPixelFormats = {{
    {"grey8", types::PixelFormat::grey8},
    {"rgb24", types::PixelFormat::rgb24},
    {"yuyv", types::PixelFormat::yuyv},
    {"nv12", types::PixelFormat::nv12},
    {"yuv420p", types::PixelFormat::yuv420p},
    {"yuv422p", types::PixelFormat::yuv422p},
    {"yuv444p", types::PixelFormat::yuv444p},
}};

// The axes of an image: rows, columns and the bytes of a pixel.
struct Axes {
  py::ssize_t bytes = 1;   // per pixel
  bool joined = false;     // columns and bytes are one axis
  const char* shape = "";  // in messages
};

Axes axes_of(types::PixelFormat format, const py::array& image) {
  switch (format) {
    case types::PixelFormat::rgb24:
      return {3, false, "(height, width, 3)"};
    case types::PixelFormat::yuyv:
      return {2, image.ndim() == 2, "(height, width, 2) or (height, 2 * width)"};
    default:
      return {1, image.ndim() == 2, "(height, width)"};
  }
}

types::PixelFormat format_of(const py::array& image, const std::string& format) {
  if (!format.empty()) return value_of(kPixelFormats, "format", format);
  const bool rgb = image.ndim() == 3 && image.shape(2) == 3;
  return rgb ? types::PixelFormat::rgb24 : types::PixelFormat::grey8;
}

bool is_rotation(const std::array<std::array<double, 3>, 3>& R) {
  constexpr double kTolerance = 1e-6;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      double product = 0.0;
      for (std::size_t j = 0; j < 3; ++j) product += R[i][j] * R[k][j];
      if (!(std::abs(product - (i == k ? 1.0 : 0.0)) <= kTolerance)) return false;
    }
  }
  const double determinant = R[0][0] * (R[1][1] * R[2][2] - R[1][2] * R[2][1]) -
                             R[0][1] * (R[1][0] * R[2][2] - R[1][2] * R[2][0]) +
                             R[0][2] * (R[1][0] * R[2][1] - R[1][1] * R[2][0]);
  return determinant > 0.0;
}

// Returns the unit quaternion (x, y, z, w). Computes the largest component from the diagonal,
// because the others are divided by it.
std::array<double, 4> quaternion_of(const std::array<std::array<double, 3>, 3>& R) {
  const std::array<double, 4> squares = {
      1.0 + R[0][0] - R[1][1] - R[2][2], 1.0 - R[0][0] + R[1][1] - R[2][2],
      1.0 - R[0][0] - R[1][1] + R[2][2], 1.0 + R[0][0] + R[1][1] + R[2][2]};  // 4 q_i^2
  const auto largest = static_cast<std::size_t>(
      std::distance(squares.begin(), std::max_element(squares.begin(), squares.end())));
  std::array<double, 4> q{};  // times 4 q_largest
  if (largest == 3) {
    q = {R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1], squares[3]};
  } else {
    const std::size_t i = largest;
    const std::size_t j = (i + 1) % 3;
    const std::size_t k = (i + 2) % 3;
    q[i] = squares[i];
    q[j] = R[j][i] + R[i][j];
    q[k] = R[k][i] + R[i][k];
    q[3] = R[k][j] - R[j][k];
  }
  double length = 0.0;
  for (const double value : q) length += value * value;
  for (double& value : q) value /= std::sqrt(length);
  return q;
}

}  // namespace

void throw_unknown_name(std::string_view argument, const std::string& name,
                        const std::vector<std::string_view>& choices) {
  std::string text = std::string(argument) + ": '" + name + "' is not known; give ";
  for (std::size_t i = 0; i < choices.size(); ++i) {
    if (i > 0) text += i + 1 == choices.size() ? " or " : ", ";
    text.append("'").append(choices[i]).append("'");
  }
  throw ArgumentError(text);
}

void check_fields(const py::tuple& state, std::size_t count) {
  if (state.size() == count) return;
  throw py::value_error("the pickled object has " + std::to_string(state.size()) +
                        " fields in place of " + std::to_string(count) +
                        "; pickle it again with this version of penumbra");
}

std::string describe(const py::object& value) {
  if (!py::isinstance<py::array>(value)) {
    return py::str(py::type::of(value).attr("__name__")).cast<std::string>();
  }
  return py::str("{} array of shape {}")
      .format(value.attr("dtype"), value.attr("shape"))
      .cast<std::string>();
}

types::ImageView image_view(const py::object& image, const std::string& format) {
  const auto what = [&] { return "image: is a " + describe(image); };
  if (!py::isinstance<py::array>(image)) {
    throw py::type_error(what() + "; give a numpy array of uint8, as np.asarray() makes it");
  }
  const auto array = py::reinterpret_borrow<py::array>(image);
  if (array.dtype().kind() != 'u' || array.itemsize() != 1) {
    throw py::type_error(what() + "; give uint8 values from 0 to 255, as .astype(np.uint8) makes");
  }
  const types::PixelFormat chosen = format_of(array, format);
  const Axes axes = axes_of(chosen, array);
  const bool fits = axes.joined ? array.ndim() == 2 && array.shape(1) % axes.bytes == 0
                                : array.ndim() == 3 && array.shape(2) == axes.bytes;
  if (!fits) {
    std::string text = what() + "; give " + axes.shape;
    text += format.empty() ? ", or (height, width, 3) for RGB" : " for the format '" + format + "'";
    throw ArgumentError(text);
  }
  const py::ssize_t height = array.shape(0);
  const py::ssize_t width = axes.joined ? array.shape(1) / axes.bytes : array.shape(1);
  if (width < 1 || height < 1) throw ArgumentError(what() + ", which has no pixels");
  // The strides of an axis of length 1 have no meaning.
  const bool in_row = axes.joined ? array.shape(1) == 1 || array.strides(1) == 1
                                  : (width == 1 || array.strides(1) == axes.bytes) &&
                                        (axes.bytes == 1 || array.strides(2) == 1);
  const py::ssize_t row = width * axes.bytes;
  const py::ssize_t stride = height == 1 ? row : array.strides(0);
  if (!in_row || stride < row) {
    throw ArgumentError(what() + " with strides " +
                        py::str(image.attr("strides")).cast<std::string>() +
                        "; the pixels of a row must be next to each other and the rows in order: "
                        "give np.ascontiguousarray(image)");
  }
  constexpr py::ssize_t kMaxSide_px = 1 << 30;  // fits into int; the library has its own limit
  return {static_cast<const std::uint8_t*>(array.data()),
          static_cast<int>(std::min(width, kMaxSide_px)),
          static_cast<int>(std::min(height, kMaxSide_px)), stride, chosen};
}

py::array array_of(const types::Image& image) {
  const types::ImageView view = image.view();
  std::vector<py::ssize_t> shape = {view.height, view.width};
  std::vector<py::ssize_t> strides = {view.stride, 1};
  if (view.format == types::PixelFormat::rgb24) {
    shape.push_back(3);
    strides = {view.stride, 3, 1};
  }
  const py::capsule owner(new types::Image(image),
                          [](void* data) { delete static_cast<types::Image*>(data); });
  py::array_t<std::uint8_t> array(std::move(shape), std::move(strides), view.data, owner);
  array.attr("setflags")(py::arg("write") = false);
  return array;
}

Doubles doubles(const py::object& value, std::string_view argument) {
  const auto array = py::array::ensure(value);
  // Not of objects or strings, which numpy would convert: None to NaN.
  if (!array || std::string_view("iuf").find(array.dtype().kind()) == std::string_view::npos) {
    PyErr_Clear();
    throw py::type_error(std::string(argument) + ": is a " + describe(value) +
                         "; give numbers, or an array of numbers");
  }
  return Doubles(array);
}

void throw_shape(const py::object& value, std::string_view argument, std::string_view shape) {
  const py::object array = py::array::ensure(value);
  throw ArgumentError(std::string(argument) + ": has shape " +
                      py::str(array.attr("shape")).cast<std::string>() + "; give " +
                      std::string(shape));
}

py::array_t<double> matrix_of(const double* values, std::size_t rows, std::size_t columns) {
  py::array_t<double> array({rows, columns});
  std::copy_n(values, rows * columns, array.mutable_data());
  return array;
}

std::array<double, 16> matrix_of(const types::Pose& pose) {
  const auto& [x, y, z, w] = pose.quaternion_xyzw;
  const auto& [tx, ty, tz] = pose.position;
  const double s = 2.0 / (x * x + y * y + z * z + w * w);
  return {1.0 - s * (y * y + z * z),
          s * (x * y - z * w),
          s * (x * z + y * w),
          tx,
          s * (x * y + z * w),
          1.0 - s * (x * x + z * z),
          s * (y * z - x * w),
          ty,
          s * (x * z - y * w),
          s * (y * z + x * w),
          1.0 - s * (x * x + y * y),
          tz,
          0.0,
          0.0,
          0.0,
          1.0};
}

py::array_t<double> array_of(const types::Pose& pose) {
  return matrix_of(matrix_of(pose).data(), 4, 4);
}

types::Pose pose_of(const py::object& value, std::string_view argument) {
  if (py::isinstance<types::Pose>(value)) return value.cast<types::Pose>();
  const Doubles matrix = doubles(value, argument);
  if (matrix.ndim() != 2 || matrix.shape(0) != 4 || matrix.shape(1) != 4) {
    throw_shape(value, argument, "a penumbra.Pose or a 4 x 4 matrix");
  }
  const auto at = [&](std::size_t row, std::size_t column) {
    return matrix.data()[4 * row + column];
  };
  std::array<std::array<double, 3>, 3> R{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t k = 0; k < 3; ++k) R[i][k] = at(i, k);
  }
  if (!(at(3, 0) == 0.0 && at(3, 1) == 0.0 && at(3, 2) == 0.0 && at(3, 3) == 1.0)) {
    throw ArgumentError(std::string(argument) +
                        ": its last row is not 0 0 0 1; give a rigid transform");
  }
  if (!is_rotation(R)) {
    throw ArgumentError(std::string(argument) +
                        ": its upper left 3 x 3 is no rotation matrix; give a rigid transform");
  }
  return {{at(0, 3), at(1, 3), at(2, 3)}, quaternion_of(R)};
}

std::int64_t nanoseconds(const py::object& value, std::string_view argument) {
  const auto integer = py::reinterpret_steal<py::object>(PyNumber_Index(value.ptr()));
  if (!integer) {
    PyErr_Clear();
    throw py::type_error(std::string(argument) + ": is a " + describe(value) +
                         "; give an integer number of nanoseconds");
  }
  int overflow = 0;
  const long long result = PyLong_AsLongLongAndOverflow(integer.ptr(), &overflow);
  if (overflow != 0) {
    throw ArgumentError(std::string(argument) + ": " + py::str(integer).cast<std::string>() +
                        " is out of range; give nanoseconds up to 2^61");
  }
  return result;
}

std::vector<std::string> strings(const py::object& value, std::string_view argument) {
  const auto fail = [&] {
    return py::type_error(std::string(argument) + ": is a " + describe(value) +
                          "; give a list of strings");
  };
  if (py::isinstance<py::str>(value) || !py::isinstance<py::iterable>(value)) throw fail();
  std::vector<std::string> result;
  for (const py::handle item : value) {
    if (!py::isinstance<py::str>(item)) throw fail();
    result.push_back(item.cast<std::string>());
  }
  return result;
}

}  // namespace penumbra::python
