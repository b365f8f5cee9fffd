# Writes OUT, which says what revision SOURCE is at, if it says something else (revision.hpp).
execute_process(
  COMMAND git -C ${SOURCE} describe --always --dirty
  OUTPUT_VARIABLE revision OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
if(NOT revision)
  set(revision unknown)
endif()
file(CONFIGURE OUTPUT ${OUT} @ONLY CONTENT [[
#include "revision.hpp"

const char* ab::revision() { return "@revision@"; }
]])
