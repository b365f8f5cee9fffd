# SPDX-License-Identifier: Apache-2.0
# What surrounds roscpp, where it is there, for what is built here. See scripts/setup ros.

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

# Targets lot_opencv and lot_pcl: for lot/ros/opencv.hpp and lot/ros/pcl.hpp. The packages' own
# descriptions name all libraries that there are; these are the ones that are needed.
find_path(LOT_CV_BRIDGE cv_bridge/cv_bridge.h)
find_package(OpenCV QUIET COMPONENTS core imgproc)
if(LOT_CV_BRIDGE AND OpenCV_FOUND)
  add_library(lot_opencv INTERFACE)
  target_include_directories(lot_opencv SYSTEM INTERFACE ${OpenCV_INCLUDE_DIRS})
  target_link_libraries(lot_opencv INTERFACE cv_bridge opencv_core opencv_imgproc)
endif()
find_path(LOT_PCL_CONVERSIONS pcl_conversions/pcl_conversions.h)
pkg_check_modules(LOT_PCL IMPORTED_TARGET GLOBAL pcl_common)
if(LOT_PCL_CONVERSIONS AND LOT_PCL_FOUND)
  add_library(lot_pcl INTERFACE)
  target_link_libraries(lot_pcl INTERFACE PkgConfig::LOT_PCL)
endif()
