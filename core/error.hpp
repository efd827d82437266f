// Errors caused by files, devices or shaders, as values.
// A message names the file, the field or line, the cause and the remedy: "camera.yaml: image_width:
// is -3; give the width in pixels". Only main() turns an Error into text on standard error and an
// exit code.
#pragma once

#include <fmt/format.h>

#include <string>
#include <string_view>
#include <tl/expected.hpp>
#include <utility>

namespace penumbra {

struct Error {
  std::string message;
};

// A value or an error. Functions that open or load return a Result, so that each constructed object
// is valid.
template <class T>
using Result = tl::expected<T, Error>;

// Replaces line breaks and other control characters by blanks, so that a message that quotes a
// damaged file stays on one line.
[[nodiscard]] inline std::string without_control_characters(std::string text) {
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = ' ';
  }
  return text;
}

// return fail("{}: {}: ...", file, field);
template <class... Args>
[[nodiscard]] tl::unexpected<Error> fail(fmt::format_string<Args...> text, Args&&... args) {
  return tl::unexpected<Error>(
      Error{without_control_characters(fmt::format(text, std::forward<Args>(args)...))});
}

// Prefixes the message of `cause` with the location: "scene.json: objects[2].model: <message>".
[[nodiscard]] inline tl::unexpected<Error> fail_in(std::string_view place, const Error& cause) {
  return fail("{}: {}", place, cause.message);
}
// Returns `result`; prefixes the message of its error with the location.
template <class T>
[[nodiscard]] Result<T> with_place(std::string_view place, Result<T> result) {
  if (!result) return fail_in(place, result.error());
  return result;
}

}  // namespace penumbra
