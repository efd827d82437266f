# Installs the program with its data, documents, man pages and completions.
install(TARGETS penumbra RUNTIME)
install(DIRECTORY scenes DESTINATION ${CMAKE_INSTALL_DATADIR}/penumbra)
install(DIRECTORY recordings DESTINATION ${CMAKE_INSTALL_DATADIR}/penumbra COMPONENT recordings)
install(FILES packages.txt README.md BENCHMARKS.md CHANGELOG.md CITATION.cff SECURITY.md LICENSE DESTINATION ${CMAKE_INSTALL_DOCDIR})
install(DIRECTORY docs DESTINATION ${CMAKE_INSTALL_DOCDIR})
install(DIRECTORY packaging/man/ DESTINATION ${CMAKE_INSTALL_MANDIR}/man1)
install(FILES packaging/penumbra.desktop DESTINATION ${CMAKE_INSTALL_DATADIR}/applications)
install(FILES packaging/org.penumbra.Penumbra.metainfo.xml DESTINATION ${CMAKE_INSTALL_DATADIR}/metainfo)
install(DIRECTORY packaging/kiosk DESTINATION ${CMAKE_INSTALL_DATADIR}/penumbra)
install(FILES packaging/penumbra.svg DESTINATION ${CMAKE_INSTALL_DATADIR}/icons/hicolor/scalable/apps)
install(FILES packaging/completions/penumbra.bash DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions RENAME penumbra)
install(FILES packaging/completions/_penumbra DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/site-functions)
install(FILES packaging/completions/penumbra.fish DESTINATION ${CMAKE_INSTALL_DATADIR}/fish/vendor_completions.d)

# The library: component `library` to run programs that use it, `development` to build them.
include(CMakePackageConfigHelpers)
set(package_folder ${CMAKE_INSTALL_LIBDIR}/cmake/penumbra)
install(TARGETS penumbra_library library_tracking library_shadow library_calibration library_evaluation EXPORT penumbra
  LIBRARY COMPONENT library NAMELINK_COMPONENT development)
install(EXPORT penumbra NAMESPACE penumbra:: FILE penumbra-targets.cmake DESTINATION ${package_folder} COMPONENT development)
configure_package_config_file(library/penumbra-config.cmake.in ${CMAKE_BINARY_DIR}/library/penumbra-config.cmake
  INSTALL_DESTINATION ${package_folder})
# While the major version is 0, another minor version may change the interface.
write_basic_package_version_file(${CMAKE_BINARY_DIR}/library/penumbra-config-version.cmake COMPATIBILITY SameMinorVersion)
# Paths relative to the file, so that an installation can be moved, unless they were given as absolute ones.
file(RELATIVE_PATH prefix_from_pkgconfig ${CMAKE_INSTALL_FULL_LIBDIR}/pkgconfig ${CMAKE_INSTALL_PREFIX})
foreach(name LIBDIR INCLUDEDIR)
  string(TOLOWER ${name} lower)
  set(pkgconfig_${lower} ${CMAKE_INSTALL_${name}})
  if(NOT IS_ABSOLUTE ${CMAKE_INSTALL_${name}})
    set(pkgconfig_${lower} "\${prefix}/${CMAKE_INSTALL_${name}}")
  endif()
endforeach()
configure_file(library/penumbra.pc.in ${CMAKE_BINARY_DIR}/library/penumbra.pc @ONLY)
install(DIRECTORY include/penumbra DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT development)
install(FILES ${CMAKE_BINARY_DIR}/library/penumbra-config.cmake ${CMAKE_BINARY_DIR}/library/penumbra-config-version.cmake
  DESTINATION ${package_folder} COMPONENT development)
install(FILES ${CMAKE_BINARY_DIR}/library/penumbra.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig COMPONENT development)
install(DIRECTORY examples DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT development)
