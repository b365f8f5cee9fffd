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
complete -c lot -n '__fish_seen_subcommand_from clean' -l dry-run -d 'only says what would be done'
complete -c lot -n '__fish_seen_subcommand_from clean' -l with-items -d 'also removes segments in whose queues items wait to be taken'
