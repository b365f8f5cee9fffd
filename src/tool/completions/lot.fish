# SPDX-License-Identifier: Apache-2.0
# What fish offers behind `lot`: verbs, options, names of segments.

# The names of the segments in LOT_DIR: each has a lock file.
function __lot_segments
    set -l directory /dev/shm
    if set -q LOT_DIR
        set directory $LOT_DIR
    end
    for lock in $directory/*.lock
        string replace -r '.*/(.*)\.lock$' '$1' -- $lock
    end
end

complete -c lot -f
complete -c lot -s h -l help -d 'says what there is, and ends'
complete -c lot -s s -l segment -x -a '(__lot_segments)' -d 'only this segment (LOT_SEGMENT)'
complete -c lot -s d -l dir -x -a '(__fish_complete_directories)' -d 'where segments lie (LOT_DIR)'
complete -c lot -l json -d 'writes a document for programs'

complete -c lot -n __fish_use_subcommand -l version -d 'says which version this is, and ends'
complete -c lot -n __fish_use_subcommand -l help-all -d 'the same for all verbs'
complete -c lot -n __fish_use_subcommand -a ls -d 'Segments, processes, topics, publishers and subscribers, memory'
complete -c lot -n __fish_use_subcommand -a top -d 'A screen that stays: rates, bandwidth, memory, laggards of topics and processes'
complete -c lot -n __fish_use_subcommand -a who -d 'Which process holds which message since when, and which reader is behind'
complete -c lot -n __fish_use_subcommand -a echo -d 'Prints the messages of a topic as they come, as YAML or JSON'
complete -c lot -n __fish_use_subcommand -a pub -d 'Publishes messages on a topic, which YAML describes'
complete -c lot -n __fish_use_subcommand -a hz -d 'How often messages come on a topic, and how evenly'
complete -c lot -n __fish_use_subcommand -a bw -d 'How many bytes come on a topic, and how large its messages are'
complete -c lot -n __fish_use_subcommand -a delay -d 'How long the messages of a topic have been under way'
complete -c lot -n __fish_use_subcommand -a record -d 'Records topics into MCAP files, which ROS 2 and Foxglove read'
complete -c lot -n __fish_use_subcommand -a info -d 'What recordings hold, also damaged ones'
complete -c lot -n __fish_use_subcommand -a play -d 'Publishes what was recorded'
complete -c lot -n __fish_use_subcommand -a clean -d 'Reaps the dead, removes segments without a process, gives unused memory back'
complete -c lot -n __fish_use_subcommand -a doctor -d 'Looks at the machine: what keeps LOT from working well, what to type'

complete -c lot -n '__fish_seen_subcommand_from ls' -l all -d 'each publisher, subscriber and process, also where many are alike'
complete -c lot -n '__fish_seen_subcommand_from ls' -l interval -x -d 'how long rates are measured at most'
complete -c lot -n '__fish_seen_subcommand_from top' -l once -d 'one screen as text, as where there is no terminal'
complete -c lot -n '__fish_seen_subcommand_from top' -l interval -x -d 'how often the screen is renewed'
complete -c lot -n '__fish_seen_subcommand_from who' -l all -d 'queued, loaned and spare messages too, and each publisher by itself'
complete -c lot -n '__fish_seen_subcommand_from echo' -l field -x -d 'prints this part alone, such as labels[2].name'
complete -c lot -n '__fish_seen_subcommand_from echo' -l full -d 'shortens nothing'
complete -c lot -n '__fish_seen_subcommand_from echo' -l elements -x -d 'so many of a list are printed'
complete -c lot -n '__fish_seen_subcommand_from echo' -l characters -x -d 'so many of a text are printed'
complete -c lot -n '__fish_seen_subcommand_from echo' -l envelope -d 'prints where each message comes from as well'
complete -c lot -n '__fish_seen_subcommand_from echo' -l history -x -d 'begins with so many messages of each publisher that are there already'
complete -c lot -n '__fish_seen_subcommand_from echo' -l count -x -d 'ends after so many'
complete -c lot -n '__fish_seen_subcommand_from echo' -l timeout -x -d 'ends when it has printed no message for so long'
complete -c lot -n '__fish_seen_subcommand_from pub' -l rate -x -d 'again and again, so many a second'
complete -c lot -n '__fish_seen_subcommand_from pub' -l count -x -d 'ends after so many'
complete -c lot -n '__fish_seen_subcommand_from pub' -l like -x -d 'has the type, where no process uses the topic yet'
complete -c lot -n '__fish_seen_subcommand_from pub' -l wait -x -d 'waits so long for a subscriber, and for the topic'
complete -c lot -n '__fish_seen_subcommand_from pub' -l latch -d 'stays until Ctrl-C, for subscribers that come later'
complete -c lot -n '__fish_seen_subcommand_from hz' -l interval -x -d 'how often it writes a line'
complete -c lot -n '__fish_seen_subcommand_from hz' -l window -x -d 'the time that a line is about'
complete -c lot -n '__fish_seen_subcommand_from hz' -l count -x -d 'ends after so many messages'
complete -c lot -n '__fish_seen_subcommand_from hz' -l duration -x -d 'ends after so long'
complete -c lot -n '__fish_seen_subcommand_from hz' -l all -d 'each publisher by itself, too'
complete -c lot -n '__fish_seen_subcommand_from bw' -l interval -x -d 'how often it writes a line'
complete -c lot -n '__fish_seen_subcommand_from bw' -l window -x -d 'the time that a line is about'
complete -c lot -n '__fish_seen_subcommand_from bw' -l count -x -d 'ends after so many messages'
complete -c lot -n '__fish_seen_subcommand_from bw' -l duration -x -d 'ends after so long'
complete -c lot -n '__fish_seen_subcommand_from delay' -l interval -x -d 'how often it writes a line'
complete -c lot -n '__fish_seen_subcommand_from delay' -l window -x -d 'the time that a line is about'
complete -c lot -n '__fish_seen_subcommand_from delay' -l count -x -d 'ends after so many messages'
complete -c lot -n '__fish_seen_subcommand_from delay' -l duration -x -d 'ends after so long'
complete -c lot -n '__fish_seen_subcommand_from delay' -l field -x -d 'since a time in the message: header.stamp'
complete -c lot -n '__fish_seen_subcommand_from record' -l all -d 'all topics'
complete -c lot -n '__fish_seen_subcommand_from record' -l except -x -d 'leaves these out: names or patterns'
complete -c lot -n '__fish_seen_subcommand_from record' -s o -l output -r -F -d 'the file; default: a name with the time'
complete -c lot -n '__fish_seen_subcommand_from record' -l compression -x -d 'none, lz4 or zstd'
complete -c lot -n '__fish_seen_subcommand_from record' -l no-crc -d 'leaves checksums out'
complete -c lot -n '__fish_seen_subcommand_from record' -l split-size -x -d 'begins a new file after so much'
complete -c lot -n '__fish_seen_subcommand_from record' -l split-time -x -d 'begins a new file after so long'
complete -c lot -n '__fish_seen_subcommand_from record' -l duration -x -d 'ends after so long'
complete -c lot -n '__fish_seen_subcommand_from record' -l max-rate -x -d 'at most so many messages a second of each topic'
complete -c lot -n '__fish_seen_subcommand_from record' -l quota -x -d 'messages that wait to be written take at most so much of the segment'
complete -c lot -n '__fish_seen_subcommand_from record' -l last -x -d 'keeps only the last seconds, and writes them when a trigger comes'
complete -c lot -n '__fish_seen_subcommand_from record' -l after -x -d 'and writes so long behind that, too'
complete -c lot -n '__fish_seen_subcommand_from record' -l memory -x -d 'what is kept takes at most so much memory'
complete -c lot -n '__fish_seen_subcommand_from record' -l trigger -x -d 'each message of it is a trigger'
complete -c lot -n '__fish_seen_subcommand_from info' -F
complete -c lot -n '__fish_seen_subcommand_from info' -l recover -d 'writes the index of a file whose recorder was killed'
complete -c lot -n '__fish_seen_subcommand_from info' -l quick -d 'reads only the index: damage elsewhere is not found'
complete -c lot -n '__fish_seen_subcommand_from play' -F
complete -c lot -n '__fish_seen_subcommand_from play' -l topic -x -d 'only these: names or patterns'
complete -c lot -n '__fish_seen_subcommand_from play' -l except -x -d 'leaves these out: names or patterns'
complete -c lot -n '__fish_seen_subcommand_from play' -l remap -x -d 'publishes a topic under another name: /a:=/b'
complete -c lot -n '__fish_seen_subcommand_from play' -l rate -x -d 'so many times as fast'
complete -c lot -n '__fish_seen_subcommand_from play' -l start -x -d 'begins so long behind the first message'
complete -c lot -n '__fish_seen_subcommand_from play' -l end -x -d 'ends so long behind the first message'
complete -c lot -n '__fish_seen_subcommand_from play' -l wait -x -d 'waits so long for a subscriber'
complete -c lot -n '__fish_seen_subcommand_from play' -l loop -d 'again and again, until Ctrl-C'
complete -c lot -n '__fish_seen_subcommand_from play' -l paused -d 'begins with a pause: the space bar goes on'
complete -c lot -n '__fish_seen_subcommand_from clean' -l dry-run -d 'only says what would be done'
complete -c lot -n '__fish_seen_subcommand_from clean' -l with-items -d 'also removes segments in whose queues items wait to be taken'
