# SPDX-License-Identifier: Apache-2.0
# Plants mistakes that the tests must find: a test that cannot fail proves nothing.
# Usage: cmake -D TESTS=directory/of/the/executables -P can_fail.cmake
function(must_find test mistake case)
  execute_process(
    COMMAND ${CMAKE_COMMAND} -E env LOT_FAULTS_PLANT=${mistake}
      ${TESTS}/${test} --abort-after=1 --test-case=${case}
    TIMEOUT 30
    RESULT_VARIABLE status
    OUTPUT_VARIABLE output
    ERROR_VARIABLE output)
  if(output MATCHES "Status: FAILURE")
    message(STATUS "${test}: ${mistake}: found")
  elseif(output MATCHES "assertions: +0 " AND output MATCHES "skipped: ([^\n]*)")
    # The case needs what cannot be had here.
    message(STATUS "${test}: ${mistake}: skipped: ${CMAKE_MATCH_1}")
  else()
    message(SEND_ERROR "${test}: ${mistake}: expected a failure, it is ${status}\n${output}")
  endif()
endfunction()

must_find(faults_descriptors closed-unnoticed "dup2() over*")
must_find(faults_descriptors no-witness "closefrom() in any state*")
must_find(faults_fork inherited-lock "the child of a killed parent*")
must_find(faults_clocks deadline-in-real-time "a pull with a deadline*")
must_find(faults_time_namespace deadline-in-real-time "deadlines are measured*")
must_find(faults_stopped gate-not-entered "a process stopped inside*")
must_find(faults_files gate-of-a-removed-file "*removed: those inside go on*")
must_find(faults_files gate-of-a-removed-file "the directory renamed and a new one made*")
must_find(faults_leftovers rubbish-is-stale "a segment that is*")
