# SPDX-License-Identifier: Apache-2.0
# Lets a target make mistakes that it must find: a check that cannot fail proves nothing.
# Usage: cmake -D REPLAY=program -D CORPUS=directory -D PLANTS=mistake,... -P can_fail.cmake
string(REPLACE "," ";" PLANTS "${PLANTS}")
set(ENV{LOT_FUZZ_PATIENCE} 10)
foreach(mistake IN LISTS PLANTS)
  set(ENV{LOT_FUZZ_PLANT} ${mistake})
  execute_process(COMMAND ${REPLAY} ${CORPUS}
    RESULT_VARIABLE status OUTPUT_VARIABLE output ERROR_VARIABLE output)
  # What is found ends the target by a signal, or by AddressSanitizer. Any other exit status means
  # something else.
  if(status MATCHES "^[0-9]+$" AND NOT output MATCHES "ERROR: AddressSanitizer")
    message(SEND_ERROR "${mistake}: not found, exit status is ${status}\n${output}")
  else()
    message(STATUS "${mistake}: found (${status})")
  endif()
endforeach()
