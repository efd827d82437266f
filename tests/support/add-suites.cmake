# Adds each suite of a test program as a test, when ctest starts. Needs: program, label, excluded (filter of tests that others run),
# properties.
if(NOT EXISTS "${program}")
  cmake_path(GET program FILENAME name)
  add_test("${label}.${name}_NOT_BUILT" "${program}")  # fails
  set_tests_properties("${label}.${name}_NOT_BUILT" PROPERTIES LABELS ${label})
  return()
endif()
execute_process(COMMAND "${program}" --gtest_list_tests "--gtest_filter=-${excluded}" OUTPUT_VARIABLE listed COMMAND_ERROR_IS_FATAL ANY)
string(REGEX MATCHALL "\n[A-Za-z0-9_/]+\\." suites "\n${listed}")
if(NOT suites)
  message(FATAL_ERROR "${program} lists no suites")
endif()
foreach(suite IN LISTS suites)
  string(REGEX REPLACE "[\n.]" "" suite "${suite}")
  add_test("${label}.${suite}" "${program}" "--gtest_filter=${suite}.*-${excluded}")
  set_tests_properties("${label}.${suite}" PROPERTIES ${properties})
endforeach()
