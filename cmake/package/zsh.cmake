# SPDX-License-Identifier: Apache-2.0
# Run by cpack on the files of the packages: Debian's zsh looks for what packages bring in another folder
# than upstream's, which is for the administrator below /usr/local alone.
file(GLOB_RECURSE files ${CPACK_TEMPORARY_INSTALL_DIRECTORY}/*)
list(FILTER files INCLUDE REGEX "/share/zsh/site-functions/_[^/]+$")
foreach(file IN LISTS files)
  get_filename_component(name ${file} NAME)
  get_filename_component(folder ${file} DIRECTORY)
  get_filename_component(zsh ${folder} DIRECTORY)
  file(MAKE_DIRECTORY ${zsh}/vendor-completions)
  file(RENAME ${file} ${zsh}/vendor-completions/${name})
  file(REMOVE_RECURSE ${folder})
endforeach()
