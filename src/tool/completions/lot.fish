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
complete -c lot -n __fish_use_subcommand -a who -d 'Which process holds which message since when, and which reader is behind'
complete -c lot -n __fish_use_subcommand -a clean -d 'Reaps the dead, removes segments without a process, gives unused memory back'
complete -c lot -n __fish_use_subcommand -a doctor -d 'Looks at the machine: what keeps LOT from working well, what to type'

complete -c lot -n '__fish_seen_subcommand_from ls' -l all -d 'each publisher, subscriber and process, also where many are alike'
complete -c lot -n '__fish_seen_subcommand_from ls' -l interval -x -d 'how long rates are measured at most'
complete -c lot -n '__fish_seen_subcommand_from who' -l all -d 'queued, loaned and spare messages too, and each publisher by itself'
complete -c lot -n '__fish_seen_subcommand_from clean' -l dry-run -d 'only says what would be done'
complete -c lot -n '__fish_seen_subcommand_from clean' -l with-items -d 'also removes segments in whose queues items wait to be taken'
