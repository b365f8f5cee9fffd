# lot_warnings: what every target of this project is compiled with. Never exported to users.
option(LOT_WERROR "Treat warnings as errors" ${PROJECT_IS_TOP_LEVEL})

add_library(lot_warnings INTERFACE)
target_compile_options(lot_warnings INTERFACE
  -Wall -Wextra -Wpedantic -Wconversion -Wshadow
  $<$<BOOL:${LOT_WERROR}>:-Werror>)
