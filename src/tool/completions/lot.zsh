#compdef lot
# SPDX-License-Identifier: Apache-2.0
# What zsh offers behind `lot`: verbs, options, names of segments.

# Offers the names of the segments in the directory: each has a lock file.
_lot_segments() {
  local directory=${opt_args[--dir]:-${opt_args[-d]:-${LOT_DIR:-/dev/shm}}}
  local -a names
  names=($directory/*.lock(N:t:r))
  compadd -a names
}

_lot() {
  local curcontext=$curcontext state line
  typeset -A opt_args
  local -a common verbs
  common=(
    '(- *)'{-h,--help}'[says what there is, and ends]'
    '(-s --segment)'{-s,--segment}'[only this segment (LOT_SEGMENT)]:segment:_lot_segments'
    '(-d --dir)'{-d,--dir}'[where segments lie (LOT_DIR)]:directory:_directories'
    '--json[writes a document for programs]'
  )
  verbs=(
    'ls:Segments, processes, topics, publishers and subscribers, memory'
    'who:Which process holds which message since when, and which reader is behind'
    'clean:Reaps the dead, removes segments without a process, gives unused memory back'
    'doctor:Looks at the machine: what keeps LOT from working well, what to type'
  )
  _arguments -C $common \
    '(- *)--version[says which version this is, and ends]' \
    '(- *)--help-all[the same for all verbs]' \
    '1:verb:->verb' \
    '*::argument:->argument'
  case $state in
    verb) _describe verb verbs ;;
    argument)
      case $words[1] in
        ls)
          _arguments $common \
            '--all[each publisher, subscriber and process, also where many are alike]' \
            '--interval[how long rates are measured at most]:milliseconds: '
          ;;
        who)
          _arguments $common \
            '--all[queued, loaned and spare messages too, and each publisher by itself]'
          ;;
        clean)
          _arguments $common \
            '--dry-run[only says what would be done]' \
            '--with-items[also removes segments in whose queues items wait to be taken]'
          ;;
        doctor)
          _arguments $common
          ;;
      esac
      ;;
  esac
}

_lot "$@"
