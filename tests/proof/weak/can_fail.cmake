# SPDX-License-Identifier: Apache-2.0
# Mistakes that the explorer must find, and mistakes in the explorer that its own tests must find.
# Usage: cmake -D WEAK=path/to/lot_weak -P can_fail.cmake
foreach(mistake IN ITEMS
    rmw-is-a-fence
    newest-only
    stores-in-a-row
    no-coherence
    no-seq-cst
    seq-cst-in-turn
    no-release-sequence
    rmw-not-atomic
    no-release-fence)
  execute_process(COMMAND ${WEAK} --litmus --stop --mistake ${mistake} RESULT_VARIABLE status OUTPUT_QUIET)
  if(NOT status EQUAL 1)
    message(SEND_ERROR "${mistake}: no litmus test finds it, exit status is ${status}")
  else()
    message(STATUS "${mistake}: found")
  endif()
endforeach()

# A mistake, and the scenario that must find it. The first five are not to be found by Relacy, which
# takes a read-modify-write for a fence, and does the steps of a thread in their order.
foreach(mistake IN ITEMS
    "no-barrier lock_is_biased"
    "no-barrier spares_are_taken"
    "clearing-acq-rel hears_of_a_ring"
    "no-order-of-news hears_two_rings"
    "own-bit-not-told weak_lock_beside_the_next"
    "publish-release-only overwrite_borrow"
    "second-look-relaxed overwrite_borrow"
    "no-wake sleepers"
    "no-fence-behind-a-copy overwrite_borrow_in_slots"
    "no-fence-before-a-message overwrite_borrow_in_slots")
  separate_arguments(words UNIX_COMMAND "${mistake}")
  execute_process(COMMAND ${WEAK} --stop --random 20000 --plant ${words}
    RESULT_VARIABLE status OUTPUT_VARIABLE output)
  if(NOT status EQUAL 1)  # 0: not found; 2: the step is no longer there
    message(SEND_ERROR "${mistake}: expected a failure, exit status is ${status}\n${output}")
  else()
    message(STATUS "${mistake}: found")
  endif()
endforeach()
