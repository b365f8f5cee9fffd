# SPDX-License-Identifier: Apache-2.0
# cmake --install: the library, its headers, the CMake package `lot` (components `record`: lot::record,
# and `ros`: lot::ros), lot.pc and lot-record.pc. All find their prefix from where they lie, so that the installed tree may be
# moved.
include(CMakePackageConfigHelpers)

set(lot_package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/lot)

install(TARGETS lot EXPORT lotTargets COMPONENT dev
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
  LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR})
# On top of the static library's inside, which a shared one hides.
set(lot_record_headers "")
if(TARGET lot_record AND LOT_FORM STREQUAL STATIC_LIBRARY)
  install(TARGETS lot_record EXPORT lotRecordTargets COMPONENT dev
    ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(EXPORT lotRecordTargets NAMESPACE lot:: DESTINATION ${lot_package_dir} COMPONENT dev)
else()
  set(lot_record_headers PATTERN recorder.hpp EXCLUDE PATTERN recording.hpp EXCLUDE)
endif()
if(TARGET lot_cli)  # the command, the schema of its documents, its pages, what shells offer
  install(TARGETS lot_cli DESTINATION ${CMAKE_INSTALL_BINDIR})
  install(FILES ${PROJECT_SOURCE_DIR}/src/tool/lot.schema.json
    DESTINATION ${CMAKE_INSTALL_DATADIR}/lot)
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/docs/man/ DESTINATION ${CMAKE_INSTALL_MANDIR}/man1
    FILES_MATCHING PATTERN "lot.1" PATTERN "lot-*.1")
  set(lot_completions ${PROJECT_SOURCE_DIR}/src/tool/completions)
  install(FILES ${lot_completions}/lot.bash RENAME lot
    DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions)
  install(FILES ${lot_completions}/lot.zsh RENAME _lot
    DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/site-functions)
  install(FILES ${lot_completions}/lot.fish
    DESTINATION ${CMAKE_INSTALL_DATADIR}/fish/vendor_completions.d)
endif()
if(TARGET lot_gateway)
  install(TARGETS lot_gateway DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT gateway)
  install(FILES ${PROJECT_SOURCE_DIR}/docs/man/lot_gateway.1 DESTINATION ${CMAKE_INSTALL_MANDIR}/man1
    COMPONENT gateway)
endif()
if(TARGET lot_python)  # where Debian's Python looks, below /usr
  set(LOT_PYTHON_DIR lib/python3/dist-packages CACHE STRING "Where the package for Python is installed")
  install(TARGETS lot_python LIBRARY DESTINATION ${LOT_PYTHON_DIR}/lot COMPONENT python)
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/src/python/lot DESTINATION ${LOT_PYTHON_DIR} COMPONENT python
    FILES_MATCHING PATTERN "*.py" PATTERN "*.pyi" PATTERN py.typed PATTERN __pycache__ EXCLUDE)
endif()
if(TARGET lot_ros)
  install(TARGETS lot_ros EXPORT lotRosTargets 
    LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT ros_library NAMELINK_COMPONENT ros)
  install(EXPORT lotRosTargets NAMESPACE lot:: DESTINATION ${lot_package_dir} COMPONENT ros)
  # The package `lot` of ROS. Programs lie where catkin looks for them; rosrun and roslaunch without
  # catkin find links to them, and so does the shell.
  set(lot_share ${CMAKE_INSTALL_DATADIR}/lot)
  install(FILES ${PROJECT_SOURCE_DIR}/package.xml DESTINATION ${lot_share} COMPONENT ros)
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/examples/ros/launch DESTINATION ${lot_share} COMPONENT ros)
  function(lot_link program directory)
    file(RELATIVE_PATH target /p/${directory} /p/lib/lot/${program})
    set(place "\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${directory}")
    install(CODE "file(MAKE_DIRECTORY \"${place}\")
      file(CREATE_LINK ${target} \"${place}/${program}\" SYMBOLIC)" COMPONENT ros)
  endfunction()
  file(RELATIVE_PATH lot_libraries /p/lib/lot /p/${CMAKE_INSTALL_LIBDIR})
  foreach(program IN ITEMS lot_relay ros_camera ros_edges ros_edges_lot)
    if(TARGET ${program})  # they find liblot_ros.so wherever the tree is moved
      set_target_properties(${program} PROPERTIES INSTALL_RPATH "\$ORIGIN/${lot_libraries}")
    endif()
  endforeach()
  if(TARGET lot_relay)
    install(TARGETS lot_relay DESTINATION lib/lot COMPONENT ros)
    lot_link(lot_relay ${lot_share})
    lot_link(lot_relay ${CMAKE_INSTALL_BINDIR})
  endif()
  foreach(program IN ITEMS ros_camera ros_edges ros_edges_lot)
    if(TARGET ${program})
      install(TARGETS ${program} DESTINATION lib/lot COMPONENT ros)
      lot_link(${program} ${lot_share})
    endif()
  endforeach()
endif()
set(lot_include_dir ${CMAKE_INSTALL_INCLUDEDIR}/lot)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/include/lot/ DESTINATION ${lot_include_dir} COMPONENT dev
  FILES_MATCHING PATTERN "*.hpp" PATTERN "*.h" PATTERN ros EXCLUDE PATTERN ros.hpp EXCLUDE ${lot_record_headers})
if(TARGET lot_ros)
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/include/lot/ros DESTINATION ${lot_include_dir} COMPONENT ros)
  install(FILES ${PROJECT_SOURCE_DIR}/include/lot/ros.hpp DESTINATION ${lot_include_dir} COMPONENT ros)
endif()
install(EXPORT lotTargets NAMESPACE lot:: DESTINATION ${lot_package_dir} COMPONENT dev)

configure_package_config_file(
  ${CMAKE_CURRENT_LIST_DIR}/lotConfig.cmake.in ${PROJECT_BINARY_DIR}/lotConfig.cmake
  INSTALL_DESTINATION ${lot_package_dir}
  NO_SET_AND_CHECK_MACRO)
# 0.x: a minor version may change the interface and the layout of the segment.
write_basic_package_version_file(${PROJECT_BINARY_DIR}/lotConfigVersion.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES
  ${PROJECT_BINARY_DIR}/lotConfig.cmake ${PROJECT_BINARY_DIR}/lotConfigVersion.cmake
  DESTINATION ${lot_package_dir} COMPONENT dev)

set(lot_pc_dir ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
file(RELATIVE_PATH lot_pc_prefix /p/${lot_pc_dir} /p)
string(REGEX REPLACE "/$" "" lot_pc_prefix "${lot_pc_prefix}")
set(lot_pc_libs "-pthread -lrt")  # what the library itself needs
set(lot_pc_private_libs "")
if(NOT LOT_FORM STREQUAL STATIC_LIBRARY)
  set(lot_pc_private_libs "${lot_pc_libs}")
  set(lot_pc_libs "")
endif()
configure_file(${CMAKE_CURRENT_LIST_DIR}/lot.pc.in ${PROJECT_BINARY_DIR}/lot.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/lot.pc DESTINATION ${lot_pc_dir} COMPONENT dev)
if(TARGET lot_record AND LOT_FORM STREQUAL STATIC_LIBRARY)
  configure_file(${CMAKE_CURRENT_LIST_DIR}/lot-record.pc.in ${PROJECT_BINARY_DIR}/lot-record.pc @ONLY)
  install(FILES ${PROJECT_BINARY_DIR}/lot-record.pc DESTINATION ${lot_pc_dir} COMPONENT dev)
endif()
