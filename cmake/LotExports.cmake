# SPDX-License-Identifier: Apache-2.0
# lot_exports(LIBRARY NODE): a shared library exports what the headers under include/ declare, and hides
# the rest. What it exports bears the version NODE_0.1, so that two versions, or lot::lot and lot::ros, in
# one process do not take each other's functions. Its own calls stay inside of it, and the loader never
# unloads it, since its threads run while the process is in a segment.
function(lot_exports library node)
  set(LOT_EXPORTS ${node}_${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
  set(exports ${CMAKE_CURRENT_BINARY_DIR}/exports.map)
  configure_file(${PROJECT_SOURCE_DIR}/cmake/exports.map.in ${exports} @ONLY)
  target_link_options(${library} PRIVATE
    LINKER:--version-script=${exports} LINKER:-Bsymbolic-functions LINKER:-z,nodelete)
  set_property(TARGET ${library} APPEND PROPERTY LINK_DEPENDS ${exports})
  set_target_properties(${library} PROPERTIES
    VERSION ${PROJECT_VERSION}
    SOVERSION ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
endfunction()
