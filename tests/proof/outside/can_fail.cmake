# SPDX-License-Identifier: Apache-2.0
# Plants mistakes that a model must find: a check that cannot fail proves nothing.
# Usage: cmake -D MODEL=program -D PLANTS=mistake,... -P can_fail.cmake
string(REPLACE "," ";" PLANTS "${PLANTS}")
foreach(mistake IN LISTS PLANTS)
  execute_process(COMMAND ${MODEL} --plant ${mistake} --steps 6000
    RESULT_VARIABLE status OUTPUT_VARIABLE output ERROR_VARIABLE output)
  # Memory that two containers have may end the program before it can compare.
  if((status EQUAL 1 AND output MATCHES "DIFFERS in step ([^\n]*)") OR
      output MATCHES "(ERROR: AddressSanitizer: [^\n]*|runtime error: [^\n]*)")
    message(STATUS "${mistake}: found: ${CMAKE_MATCH_1}")
  elseif(NOT status MATCHES "^[0-9]+$")
    message(STATUS "${mistake}: found: ${status}")
  else()
    message(SEND_ERROR "${mistake}: not found, exit status is ${status}\n${output}")
  endif()
endforeach()
