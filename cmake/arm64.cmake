# CMake toolchain: cross-compiles for a 64-bit Raspberry Pi or other arm64 Debian. PENUMBRA_SYSROOT is a folder of Debian's
# arm64 packages, which scripts/build-arm64 creates.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES PENUMBRA_SYSROOT)
set(CMAKE_SYSROOT ${PENUMBRA_SYSROOT})
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++)
set(CMAKE_LIBRARY_ARCHITECTURE aarch64-linux-gnu)

# Searches libraries and headers in the sysroot, programs on the build machine.
set(CMAKE_FIND_ROOT_PATH ${PENUMBRA_SYSROOT})
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
set(ENV{PKG_CONFIG_DIR} "")
set(ENV{PKG_CONFIG_SYSROOT_DIR} ${PENUMBRA_SYSROOT})
set(ENV{PKG_CONFIG_LIBDIR} ${PENUMBRA_SYSROOT}/usr/lib/aarch64-linux-gnu/pkgconfig:${PENUMBRA_SYSROOT}/usr/share/pkgconfig)
