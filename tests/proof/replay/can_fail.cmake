# SPDX-License-Identifier: Apache-2.0
# Finds a seed with which a planted mistake shows itself, and shows that this seed repeats it: a
# second program run says the same, step by step.
# Usage: cmake -D REPLAY=program -P can_fail.cmake
set(most 40)
execute_process(COMMAND ${REPLAY} --letters --seed 1 --runs ${most} --stop
  RESULT_VARIABLE status OUTPUT_VARIABLE output ERROR_VARIABLE output)
if(output MATCHES "skipped: ([^\n]*)")
  message(STATUS "skipped: ${CMAKE_MATCH_1}")
  return()
endif()
if(NOT status EQUAL 1 OR NOT output MATCHES "VIOLATION of seed ([0-9]+) in step ([^\n]*)")
  message(FATAL_ERROR "${most} seeds do not find what is planted, exit status is ${status}\n${output}")
endif()
set(seed ${CMAKE_MATCH_1})
set(found ${CMAKE_MATCH_0})
string(REGEX MATCH "seed ${seed}: fingerprint [^\n]*" first "${output}")

execute_process(COMMAND ${REPLAY} --letters --seed ${seed}
  RESULT_VARIABLE status OUTPUT_VARIABLE again ERROR_VARIABLE again)
string(REGEX MATCH "seed ${seed}: fingerprint [^\n]*" second "${again}")
string(FIND "${again}" "${found}" at)
if(at EQUAL -1 OR NOT first STREQUAL second)
  message(FATAL_ERROR "seed ${seed} does not repeat its run:\n${first}\n${found}\n${again}")
endif()
message(STATUS "${found}\n${first}\nand the same once more")
