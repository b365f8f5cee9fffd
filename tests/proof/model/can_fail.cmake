# SPDX-License-Identifier: Apache-2.0
# Plants mistakes that the model must find: a model that cannot fail proves nothing.
# Usage: cmake -D MODEL=path/to/lot_model -P can_fail.cmake
# LOT_TEST_ONE_IN=N: one of each N mistakes, others with each LOT_TEST_SEED.
# A mistake, or a mistake and the scenario that must find it by itself, perhaps by bounded search.
set(mistakes
    publish-release-only
    second-look-relaxed
    second-look-stale
    life-bump-relaxed
    life-bump-dropped
    adopt-without-bump
    wanted-not-said
    joiner-not-announced
    floor-not-told
    floor-relaxed
    marks-not-cleared
    no-wake
    no-ring-for-room
    no-look-at-hazards
    no-fence-behind-a-copy
    no-fence-before-a-message
    no-lock-for-joiners
    taken-without-a-look
    "evicted-and-left-there evicted_while_taken_two_slots"
    "evicted-and-left-there taker_killed_while_evicted"
    "no-look-at-hazards --bounded evicted_block_changes_hands"
    "no-look-at-the-answer selected_when_invited_twice"
    no-repair-after-a-death)
include(${CMAKE_CURRENT_LIST_DIR}/../../support/sample.cmake)
sample(mistakes)
foreach(mistake IN LISTS mistakes)
  separate_arguments(words UNIX_COMMAND "${mistake}")
  foreach(executions IN ITEMS 1000 20000)  # most are found soon
    execute_process(
      COMMAND ${MODEL} --stop --random ${executions} --plant ${words}
      RESULT_VARIABLE status
      OUTPUT_VARIABLE output)
    if(NOT status EQUAL 0)
      break()
    endif()
  endforeach()
  if(NOT status EQUAL 1)  # 0: not found; 2: the step is no longer there
    message(SEND_ERROR "${mistake}: expected a failure, exit status is ${status}\n${output}")
  else()
    message(STATUS "${mistake}: found")
  endif()
endforeach()
