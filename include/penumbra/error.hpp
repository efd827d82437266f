// The exception of the library.
#pragma once

#include <penumbra/api.hpp>
#include <stdexcept>
#include <string>

namespace penumbra {

// Thrown by every function of the library that can fail, and the only type that these functions
// throw, apart from std::bad_alloc. what() is one line: the file or argument, the field, the cause
// and the remedy, as the program prints it. A call that throws changes nothing, unless its
// comment says otherwise: the object can be used further.
class PENUMBRA_API Exception : public std::runtime_error {
 public:
  explicit Exception(const std::string& message);
  Exception(const Exception&) noexcept;
  ~Exception() override;
};

}  // namespace penumbra
