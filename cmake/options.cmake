# Flags that every target of ours has: the language, the warnings, the sanitizers.
add_library(penumbra_options INTERFACE)
target_compile_features(penumbra_options INTERFACE cxx_std_20)
target_include_directories(penumbra_options INTERFACE ${PROJECT_SOURCE_DIR})
target_compile_options(penumbra_options INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wnon-virtual-dtor -Woverloaded-virtual
  # Products and sums are rounded one by one on every machine: the same poses and pictures everywhere.
  -ffp-contract=off
  # No path of the building machine gets into the program.
  -fmacro-prefix-map=${PROJECT_SOURCE_DIR}/=)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # g++ first collects its garbage at 400 MB, not at 128: about a tenth less time, for 4 % more memory (0.95 GB for the largest file).
  target_compile_options(penumbra_options INTERFACE --param=ggc-min-heapsize=400000)
endif()
if(CMAKE_BUILD_TYPE STREQUAL "Debug")
  target_compile_definitions(penumbra_options INTERFACE EIGEN_INITIALIZE_MATRICES_BY_NAN)
endif()
if(PENUMBRA_SANITIZE)
  target_compile_options(penumbra_options INTERFACE
    -fsanitize=${PENUMBRA_SANITIZE} -fno-sanitize-recover=all -fno-omit-frame-pointer -O1 -g)
  target_link_options(penumbra_options INTERFACE -fsanitize=${PENUMBRA_SANITIZE})
endif()

# penumbra_module(NAME LIBS...): a static library of the .cpp files in this folder and below.
function(penumbra_module name)
  file(GLOB_RECURSE sources CONFIGURE_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/*.cpp)
  list(FILTER sources EXCLUDE REGEX "/main\\.cpp$|/commands/")
  add_library(penumbra_${name} STATIC ${sources})
  target_link_libraries(penumbra_${name} PUBLIC penumbra_options ${ARGN})
endfunction()

# penumbra_headers(TARGET HEADERS...): what nearly every file includes is read once. A target of the same compile options takes
# another's: target_precompile_headers(TARGET REUSE_FROM OTHER). Each file still includes what it uses: the debug preset builds
# without this.
function(penumbra_headers target)
  list(TRANSFORM ARGN REPLACE "^([a-z_]+_headers\\.hpp)$" "${PROJECT_SOURCE_DIR}/cmake/\\1")
  target_precompile_headers(${target} PRIVATE ${ARGN})
endfunction()

# penumbra_batches(TARGET SIZE): SIZE source files are compiled as one, as most of the time goes into the same headers and
# templates again and again. So few that a changed file is still compiled in seconds. The debug preset compiles each alone.
function(penumbra_batches target size)
  if(NOT CMAKE_DISABLE_PRECOMPILE_HEADERS)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE ${size})
    target_compile_options(${target} PRIVATE -Wno-subobject-linkage)  # takes each file of a batch for a header
  endif()
endfunction()
