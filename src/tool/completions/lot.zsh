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
    'top:A screen that stays: rates, bandwidth, memory, laggards of topics and processes'
    'who:Which process holds which message since when, and which reader is behind'
    'echo:Prints the messages of a topic as they come, as YAML or JSON'
    'pub:Publishes messages on a topic, which YAML describes'
    'hz:How often messages come on a topic, and how evenly'
    'bw:How many bytes come on a topic, and how large its messages are'
    'delay:How long the messages of a topic have been under way'
    'record:Records topics into MCAP files, which ROS 2 and Foxglove read'
    'info:What recordings hold, also damaged ones'
    'play:Publishes what was recorded'
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
        top)
          _arguments $common \
            '--once[one screen as text, as where there is no terminal]' \
            '--interval[how often the screen is renewed]:milliseconds: '
          ;;
        who)
          _arguments $common \
            '--all[queued, loaned and spare messages too, and each publisher by itself]'
          ;;
        echo)
          _arguments $common \
            '--field[prints this part alone, such as labels\[2\].name]:path: ' \
            '--full[shortens nothing]' \
            '--elements[so many of a list are printed]:number: ' \
            '--characters[so many of a text are printed]:number: ' \
            '--envelope[prints where each message comes from as well]' \
            '--history[begins with so many messages of each publisher that are there already]:number: ' \
            '--count[ends after so many]:number: ' \
            '--timeout[ends when it has printed no message for so long]:seconds: '
          ;;
        pub)
          _arguments $common \
            '--rate[again and again, so many a second]:hertz: ' \
            '--count[ends after so many]:number: ' \
            '--like[has the type, where no process uses the topic yet]:topic: ' \
            '--wait[waits so long for a subscriber, and for the topic]:seconds: ' \
            '--latch[stays until Ctrl-C, for subscribers that come later]'
          ;;
        hz)
          _arguments $common '1:topic: ' \
            '--interval[how often it writes a line]:milliseconds: ' \
            '--window[the time that a line is about]:seconds: ' \
            '--count[ends after so many messages]:messages: ' \
            '--duration[ends after so long]:seconds: ' \
            '--all[each publisher by itself, too]'
          ;;
        bw)
          _arguments $common '1:topic: ' \
            '--interval[how often it writes a line]:milliseconds: ' \
            '--window[the time that a line is about]:seconds: ' \
            '--count[ends after so many messages]:messages: ' \
            '--duration[ends after so long]:seconds: '
          ;;
        delay)
          _arguments $common '1:topic: ' \
            '--interval[how often it writes a line]:milliseconds: ' \
            '--window[the time that a line is about]:seconds: ' \
            '--count[ends after so many messages]:messages: ' \
            '--duration[ends after so long]:seconds: ' \
            '--field[since a time in the message\: header.stamp]:path: '
          ;;
        record)
          _arguments $common \
            '--all[all topics]' \
            '--except[leaves these out\: names or patterns]:topic: ' \
            '(-o --output)'{-o,--output}'[the file; default\: a name with the time]:file:_files' \
            '--compression[none, lz4 or zstd]:name: ' \
            '--no-crc[leaves checksums out]' \
            '--split-size[begins a new file after so much]:mebibytes: ' \
            '--split-time[begins a new file after so long]:seconds: ' \
            '--duration[ends after so long]:seconds: ' \
            '--max-rate[at most so many messages a second of each topic]:hertz: ' \
            '--quota[messages that wait to be written take at most so much of the segment]:mebibytes: ' \
            '--last[keeps only the last seconds, and writes them when a trigger comes]:seconds: ' \
            '--after[and writes so long behind that, too]:seconds: ' \
            '--memory[what is kept takes at most so much memory]:mebibytes: ' \
            '--trigger[each message of it is a trigger]:topic: '
          ;;
        info)
          _arguments $common '*:file:_files' \
            '--recover[writes the index of a file whose recorder was killed]' \
            '--quick[reads only the index\: damage elsewhere is not found]'
          ;;
        play)
          _arguments $common '*:file:_files' \
            '--topic[only these\: names or patterns]:topic: ' \
            '--except[leaves these out\: names or patterns]:topic: ' \
            '--remap[publishes a topic under another name\: /a\:=/b]:names: ' \
            '--rate[so many times as fast]:factor: ' \
            '--start[begins so long behind the first message]:seconds: ' \
            '--end[ends so long behind the first message]:seconds: ' \
            '--wait[waits so long for a subscriber]:seconds: ' \
            '--loop[again and again, until Ctrl-C]' \
            '--paused[begins with a pause\: the space bar goes on]'
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
