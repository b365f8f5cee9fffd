# SPDX-License-Identifier: Apache-2.0
# Plants mistakes that the chaos must find: a check that cannot fail proves nothing.
# Usage: cmake -D CHAOS=path/to/lot_chaos -P can_fail.cmake
# LOT_TEST_ONE_IN=N: one of each N mistakes, others with each LOT_TEST_SEED.
set(mistakes
    tear=torn smear=torn refer=torn weak=torn trust=torn
    skip=lost miss=lost overlook=lost more=lost ghost=lost overrun=lost deaf=lost
    drop=lost spill=lost forget=lost blind=lost
    twice=twice take-twice=twice share=twice recount=twice
    leak=leaked leak-at-end=leaked hoard=leaked greed=leaked
    cling=leaked keep=leaked spoil=leaked
    file=files
    wedge=wedged doze=wedged stay=wedged
    crash=crashed)
include(${CMAKE_CURRENT_LIST_DIR}/../../support/sample.cmake)
sample(mistakes)
foreach(planted IN LISTS mistakes)
  string(REPLACE "=" ";" planted ${planted})
  list(GET planted 0 mistake)
  list(GET planted 1 finding)
  set(size --or-without --kills 800 --checkpoint 40)
  # Few readers sleep that long; and few see a publisher that comes later, where little is running.
  # Few observers live that long beside another type.
  if(mistake MATCHES "^(doze|deaf|blind)$")
    set(size --or-without --kills 4000 --checkpoint 400)
  endif()
  # What it is found as is chance, since one mistake has many consequences (a number used twice
  # leaves less history to a late joiner, which finds a loss). On a machine that is busy, little
  # runs between two kills, and a mistake may have no consequence at all (a publisher that does not
  # wait for its readers, where all are faster). So a few seeds are tried until it was found as what
  # it is.
  foreach(seed RANGE 4 8)
    execute_process(
      COMMAND ${CHAOS} ${size} --patience 6 --seed ${seed} --plant ${mistake}
      RESULT_VARIABLE status
      OUTPUT_VARIABLE output
      ERROR_VARIABLE output)
    if(NOT status MATCHES "^[01]$" OR output MATCHES "\n${finding}: ")
      break()
    endif()
    message(STATUS "${mistake}: not found as ${finding}, seed ${seed}\n${output}")
  endforeach()
  if(output MATCHES "\nskipped: ([^\n]*)")
    message(STATUS "skipped: ${CMAKE_MATCH_1}")
  endif()
  # A line that begins with the finding; and the exit status.
  if(NOT status EQUAL 1 OR NOT output MATCHES "\n${finding}: ")
    message(SEND_ERROR "${mistake}: expected '${finding}', exit status is ${status}\n${output}")
  else()
    message(STATUS "${mistake}: found")
  endif()
endforeach()
