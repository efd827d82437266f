# Flags of every target: language, warnings, sanitizers.

# The modules are linked into programs and into the shared library, so they are compiled once, for both. Only what
# include/penumbra marks with PENUMBRA_API is visible outside the library.
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_CXX_VISIBILITY_PRESET hidden)
set(CMAKE_VISIBILITY_INLINES_HIDDEN ON)

add_library(penumbra_options INTERFACE)
target_compile_features(penumbra_options INTERFACE cxx_std_20)
target_include_directories(penumbra_options INTERFACE ${PROJECT_SOURCE_DIR})
target_compile_options(penumbra_options INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wnon-virtual-dtor -Woverloaded-virtual
  # No fused multiply-add: every machine computes the same poses and images.
  -ffp-contract=off
  # The linker drops unused functions from the library (library/CMakeLists.txt).
  -ffunction-sections -fdata-sections
  # Keeps paths of the build machine out of the program.
  -fmacro-prefix-map=${PROJECT_SOURCE_DIR}/=)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # g++ collects garbage from 400 MB on instead of 128 MB: a tenth less time for 4 % more memory (0.95 GB at most).
  target_compile_options(penumbra_options INTERFACE --param=ggc-min-heapsize=400000)
endif()
if(CMAKE_BUILD_TYPE STREQUAL "Debug")
  target_compile_definitions(penumbra_options INTERFACE EIGEN_INITIALIZE_MATRICES_BY_NAN)
endif()
if(PENUMBRA_SANITIZE)
  # With a sanitizer, g++ warns falsely of uninitialized values and overflows in the standard library.
  set(CMAKE_COMPILE_WARNING_AS_ERROR OFF)
  target_compile_options(penumbra_options INTERFACE
    -fsanitize=${PENUMBRA_SANITIZE} -fno-sanitize-recover=all -fno-omit-frame-pointer -O1 -g1)
  target_link_options(penumbra_options INTERFACE -fsanitize=${PENUMBRA_SANITIZE})
endif()

# penumbra_module(NAME LIBS...): builds a static library from the .cpp files in this folder and below, without those of
# PENUMBRA_OTHER_SOURCES, which belong to another library.
function(penumbra_module name)
  file(GLOB_RECURSE sources CONFIGURE_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/*.cpp)
  list(FILTER sources EXCLUDE REGEX "/main\\.cpp$|/commands/")
  list(REMOVE_ITEM sources ${PENUMBRA_OTHER_SOURCES} "")
  add_library(penumbra_${name} STATIC ${sources})
  target_link_libraries(penumbra_${name} PUBLIC penumbra_options ${ARGN})
endfunction()

# penumbra_headers(TARGET HEADERS...): precompiles common headers. Targets with the same compile options share them with
# target_precompile_headers(TARGET REUSE_FROM OTHER). Each file must still include what it uses: the debug preset builds
# without precompiled headers.
function(penumbra_headers target)
  list(TRANSFORM ARGN REPLACE "^([a-z_]+_headers\\.hpp)$" "${PROJECT_SOURCE_DIR}/cmake/\\1")
  target_precompile_headers(${target} PRIVATE ${ARGN})
endfunction()

# penumbra_batches(TARGET SIZE): compiles SIZE source files as one, which saves time in shared headers and templates. SIZE is
# small enough to compile a changed file in seconds. The debug preset compiles each file alone.
function(penumbra_batches target size)
  if(NOT CMAKE_DISABLE_PRECOMPILE_HEADERS)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE ${size})
    target_compile_options(${target} PRIVATE -Wno-subobject-linkage)  # takes each file of a batch for a header
  endif()
endfunction()
