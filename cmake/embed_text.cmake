# cmake -D OUTPUT=FILE.cpp -D INPUT=FILE -D HEADER=NAME.hpp -D FUNCTION=NAME -P embed_text.cmake
# Writes a text file into a source file, as the function's string: no path of the building machine gets into the program.
file(READ "${INPUT}" text)
file(CONFIGURE OUTPUT "${OUTPUT}" @ONLY CONTENT [=[
#include "@HEADER@"

namespace penumbra {

std::string_view @FUNCTION@() {
  return R"embedded(@text@)embedded";
}

}  // namespace penumbra
]=])
