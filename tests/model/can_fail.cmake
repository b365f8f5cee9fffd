# Plants mistakes that the model must find: a model that cannot fail proves nothing.
# Usage: cmake -D MODEL=path/to/lot_model -P can_fail.cmake
foreach(mistake IN ITEMS
    publish-release-only
    second-look-relaxed
    life-bump-relaxed)
  execute_process(
    COMMAND ${MODEL} --random 20000 --plant ${mistake}
      forwarder_chain threads_of_one_process evict_against_borrow
    RESULT_VARIABLE status
    OUTPUT_VARIABLE output)
  if(NOT status EQUAL 1)  # 0: not found; 2: the step is no longer there
    message(SEND_ERROR "${mistake}: expected a failure, exit status is ${status}\n${output}")
  else()
    message(STATUS "${mistake}: found")
  endif()
endforeach()
