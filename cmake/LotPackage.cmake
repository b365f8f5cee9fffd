# SPDX-License-Identifier: Apache-2.0
# Debian packages, by cpack (scripts/package), one for each component: liblot-dev (dev), lot-tools (tools),
# where the gateway is built, lot-gateway (gateway), where the package for Python is built, python3-lot (python), and, where lot::ros is built, liblot-ros0.1 (ros_library) and liblot-ros-dev (ros).
set(LOT_PACKAGE_MAINTAINER "The LOT team <lot@example.org>" CACHE STRING "Who makes the packages")

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME lot)
set(CPACK_PACKAGE_VENDOR "The LOT team")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "")  # each package has its own
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_PRE_BUILD_SCRIPTS
  ${PROJECT_SOURCE_DIR}/cmake/package/compress.cmake ${PROJECT_SOURCE_DIR}/cmake/package/zsh.cmake)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_DEBIAN_PACKAGE_MAINTAINER ${LOT_PACKAGE_MAINTAINER})
set(CPACK_COMPONENTS_ALL)
set(lot_version ${PROJECT_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE})
set(lot_about "LOT moves messages of many megabytes from one process to many on one
machine, by smart pointers into shared memory, without copies. Any process
may be killed at any moment, and the others go on. There is no daemon.
.
")

# lot_package(COMPONENT PACKAGE SECTION SUMMARY TEXT [FIELD VALUE]...)
# FIELD: of cpack's CPACK_DEBIAN_COMPONENT_PACKAGE_FIELD.
function(lot_package component package section summary text)
  string(TOUPPER CPACK_DEBIAN_${component} key)
  set(${key}_PACKAGE_NAME ${package} PARENT_SCOPE)
  set(${key}_PACKAGE_SECTION ${section} PARENT_SCOPE)
  set(${key}_DESCRIPTION "${summary}\n${lot_about}${text}" PARENT_SCOPE)
  while(ARGN)
    list(POP_FRONT ARGN field value)
    set(${key}_PACKAGE_${field} ${value} PARENT_SCOPE)
  endwhile()
  set(CPACK_COMPONENTS_ALL ${CPACK_COMPONENTS_ALL} ${component} PARENT_SCOPE)

  # What each package of Debian has; `cmake --install` alone leaves it out.
  set(files ${PROJECT_BINARY_DIR}/package/${package})
  string(TIMESTAMP date "%a, %d %b %Y %H:%M:%S +0000" UTC)
  configure_file(${PROJECT_SOURCE_DIR}/cmake/package/changelog.Debian.in ${files}/changelog.Debian @ONLY)
  configure_file(${PROJECT_SOURCE_DIR}/CHANGELOG.md ${files}/changelog COPYONLY)
  install(FILES ${files}/changelog ${files}/changelog.Debian ${PROJECT_SOURCE_DIR}/cmake/package/copyright
    DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package} COMPONENT ${component} EXCLUDE_FROM_ALL)
endfunction()

lot_package(dev liblot-dev libdevel "messages in shared memory, without copies - development files"
"This package has the headers, the static libraries, and their descriptions for
CMake and pkg-config. The one for recordings needs what is suggested."
  SUGGESTS "libboost-dev, libdeflate-dev, liblz4-dev, libzstd-dev, lot-tools")

if(TARGET lot_cli)
  lot_package(tools lot-tools utils "messages in shared memory, without copies - command line tool"
"This package has the command lot, which shows segments, topics, rates and
who holds which message, and removes what dead processes have left."
    SHLIBDEPS ON)
endif()

if(TARGET lot_gateway)
  lot_package(gateway lot-gateway net "messages in shared memory, without copies - gateway to DDS and ROS 2"
"This package has the program lot_gateway, which carries topics between hosts,
and to and from nodes of ROS 2."
    SHLIBDEPS ON
    SUGGESTS "lot-tools")
endif()

if(TARGET lot_python)
  execute_process(  # the extension is of this version alone: "3.11 3.12"
    COMMAND ${PYTHON_EXECUTABLE} -c "import sys; v = sys.version_info; print(f'3.{v.minor} 3.{v.minor + 1}')"
    OUTPUT_VARIABLE lot_python_versions OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
  string(REPLACE " " ";" lot_python_versions "${lot_python_versions}")
  list(GET lot_python_versions 0 lot_python_version)
  list(GET lot_python_versions 1 lot_python_next)
  lot_package(python python3-lot python "messages in shared memory, without copies - for Python 3"
"This package has the module lot: topics, queues, services and recordings,
whose messages numpy looks at without a copy."
    DEPENDS "python3 (>= ${lot_python_version}~), python3 (<< ${lot_python_next}), python3-numpy"
    SHLIBDEPS ON
    SUGGESTS "lot-tools")
endif()

if(TARGET lot_ros)
  set(CPACK_DEBIAN_PACKAGE_GENERATE_SHLIBS ON)
  set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS ${PROJECT_BINARY_DIR}/src/lot_ros)
  get_target_property(soversion lot_ros SOVERSION)
  lot_package(ros_library liblot-ros${soversion} libs "messages in shared memory, without copies - nodes of ROS 1"
"This package has the shared library that nodes with lot::ros are linked
with."
    SHLIBDEPS ON
    CONTROL_EXTRA ${PROJECT_SOURCE_DIR}/cmake/package/triggers)

  string(CONCAT depends "liblot-dev (= ${lot_version}), liblot-ros${soversion} (= ${lot_version}), "
    "pkg-config, libroscpp-dev, libstd-msgs-dev, libgeometry-msgs-dev, libsensor-msgs-dev")
  lot_package(ros liblot-ros-dev libdevel "messages in shared memory, without copies - development with ROS 1"
"This package has lot::ros, for nodes of stock roscpp on ordinary topics, the
program lot_relay, the transport lot of image_transport, and examples."
    DEPENDS "${depends}"
    RECOMMENDS "libmessage-filters-dev, lot-tools"
    SUGGESTS "libcv-bridge-dev, libpcl-conversions-dev"
    SHLIBDEPS ON)
endif()

include(CPack)
