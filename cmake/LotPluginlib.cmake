# SPDX-License-Identifier: Apache-2.0
# lot_find_pluginlib(): LOT_PLUGINLIB_FOUND, LOT_PLUGINLIB_INCLUDES and LOT_CLASS_LOADER. Debian has
# pluginlib and class_loader of ROS 2, which pkg-config does not know.
macro(lot_find_pluginlib)
  find_library(LOT_CLASS_LOADER class_loader)
  set(LOT_PLUGINLIB_INCLUDES)
  foreach(header IN ITEMS pluginlib/class_list_macros.hpp class_loader/class_loader.hpp
      rcpputils/shared_library.hpp rcutils/shared_library.h)
    cmake_path(GET header PARENT_PATH room)
    find_path(LOT_INCLUDE_${room} ${header} PATH_SUFFIXES ${room})
    list(APPEND LOT_PLUGINLIB_INCLUDES ${LOT_INCLUDE_${room}})
  endforeach()
  set(LOT_PLUGINLIB_FOUND TRUE)
  if(NOT LOT_CLASS_LOADER OR "${LOT_PLUGINLIB_INCLUDES}" MATCHES "NOTFOUND")
    set(LOT_PLUGINLIB_FOUND FALSE)
  endif()
endmacro()
