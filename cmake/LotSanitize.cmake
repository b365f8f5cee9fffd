# SPDX-License-Identifier: Apache-2.0
# Applies LOT_SANITIZE to every target that is defined after this file is included.
if(LOT_SANITIZE)
  if("thread" IN_LIST LOT_SANITIZE AND "address" IN_LIST LOT_SANITIZE)
    message(FATAL_ERROR "LOT_SANITIZE: thread and address cannot be combined")
  endif()
  list(JOIN LOT_SANITIZE "," lot_sanitizers)
  add_compile_options(-fsanitize=${lot_sanitizers} -fno-sanitize-recover=all
    -fno-omit-frame-pointer -g1)
  add_link_options(-fsanitize=${lot_sanitizers})
  if(CMAKE_CXX_COMPILER_ID STREQUAL "Clang")
    add_compile_options(-fsanitize-ignorelist=${CMAKE_CURRENT_LIST_DIR}/ubsan_ignore.txt)
  endif()
  unset(lot_sanitizers)
endif()
