# SPDX-License-Identifier: Apache-2.0
# Plants mistakes that a model must find: a check that cannot fail proves nothing.
# Usage: cmake -D MODEL=program -D PLANTS=mistake,... -P can_fail.cmake
#
# A mistake is made now and then, and some runs have no step that could tell: each has several runs.
string(REPLACE "," ";" PLANTS "${PLANTS}")
if("$ENV{LOT_TEST_SEED}" MATCHES "^[0-9]+$")
  string(REGEX MATCH "[0-9]?[0-9]?[0-9]?[0-9]?[0-9]?[0-9]?[0-9]?$" seed "$ENV{LOT_TEST_SEED}")
else()
  string(RANDOM LENGTH 7 ALPHABET 123456789 seed)
endif()
foreach(mistake IN LISTS PLANTS)
  foreach(run RANGE 1 10)
    math(EXPR its_seed "${seed} + ${run}")
    execute_process(COMMAND ${MODEL} --plant ${mistake} --seed ${its_seed} --steps 6000
      TIMEOUT 100 RESULT_VARIABLE status OUTPUT_VARIABLE output ERROR_VARIABLE output)
    if(NOT status EQUAL 0)
      break()
    endif()
  endforeach()
  # Memory that two containers have may end the program, or keep it busy until its own limit of time,
  # before it can compare.
  if((status EQUAL 1 AND output MATCHES "DIFFERS in step ([^\n]*)") OR
      output MATCHES "(ERROR: AddressSanitizer: [^\n]*|runtime error: [^\n]*)")
    message(STATUS "${mistake}: found by run ${run}: ${CMAKE_MATCH_1}")
  elseif(NOT status MATCHES "^[0-9]+$")
    message(STATUS "${mistake}: found by run ${run}: ${status}")
  else()
    message(SEND_ERROR "${mistake}: not found, exit status is ${status}\n${output}")
  endif()
endforeach()
