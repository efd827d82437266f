// Macros that return the error of a Result to the caller.
#pragma once

#include <utility>

#include "core/error.hpp"

#define PENUMBRA_CONCATENATE_(a, b) a##b
#define PENUMBRA_CONCATENATE(a, b) PENUMBRA_CONCATENATE_(a, b)

// PENUMBRA_TRY(auto camera, load_camera(path));
// Declares or assigns `camera` with the value of the expression, a Result, or returns its error.
#define PENUMBRA_TRY(declaration, ...) \
  PENUMBRA_TRY_AS_(PENUMBRA_CONCATENATE(tried_, __LINE__), declaration, __VA_ARGS__)
#define PENUMBRA_TRY_AS_(tried, declaration, ...)              \
  auto tried = __VA_ARGS__;                                    \
  if (!tried) return tl::unexpected(std::move(tried).error()); \
  declaration = *std::move(tried)

// PENUMBRA_TRY_VOID(file.close());
// Returns the error of the expression, a Result whose value is not used.
#define PENUMBRA_TRY_VOID(...)                                                             \
  do {                                                                                     \
    if (auto tried = __VA_ARGS__; !tried) return tl::unexpected(std::move(tried).error()); \
  } while (false)
