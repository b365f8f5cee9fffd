# SPDX-License-Identifier: Apache-2.0

# Leaves one of each LOT_TEST_ONE_IN elements in a list, others with each LOT_TEST_SEED, which is
# printed. All stay where LOT_TEST_ONE_IN is not set.
function(sample list)
  if(NOT DEFINED ENV{LOT_TEST_ONE_IN})
    return()
  endif()
  set(seed $ENV{LOT_TEST_SEED})
  if(NOT seed)
    string(TIMESTAMP seed %s)
  endif()
  message(STATUS "seed: LOT_TEST_SEED=${seed}")
  math(EXPR next "${seed} % $ENV{LOT_TEST_ONE_IN}")
  set(chosen)
  foreach(element IN LISTS ${list})
    if(next EQUAL 0)
      list(APPEND chosen ${element})
      set(next $ENV{LOT_TEST_ONE_IN})
    endif()
    math(EXPR next "${next} - 1")
  endforeach()
  set(${list} ${chosen} PARENT_SCOPE)
endfunction()
