# SPDX-License-Identifier: Apache-2.0
# Run by cpack on the files of the packages: Debian has manual pages and changelogs compressed.
file(GLOB_RECURSE files ${CPACK_TEMPORARY_INSTALL_DIRECTORY}/*)
list(FILTER files INCLUDE REGEX "/share/(man/.*[.][1-9]|doc/[^/]+/changelog([.]Debian)?)$")
if(NOT files)
  message(FATAL_ERROR "${CPACK_TEMPORARY_INSTALL_DIRECTORY} has no changelog")
endif()
execute_process(COMMAND gzip -9nf ${files} COMMAND_ERROR_IS_FATAL ANY)
