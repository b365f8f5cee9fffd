# SPDX-License-Identifier: Apache-2.0
# What bash offers behind `lot`: verbs, options, names of segments.

# Prints the names of the segments in a directory: each has a lock file.
_lot_segments() {
  local lock name
  for lock in "$1"/*.lock; do
    name=${lock##*/}
    name=${name%.lock}
    if [[ -f $1/$name ]]; then printf '%s\n' "$name"; fi
  done
}

_lot() {
  local current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD - 1]}
  local directory=${LOT_DIR:-/dev/shm} verb= words= i
  # Options that a value follows.
  local valued='--interval --characters --count --duration --elements --field --history --like --rate'
  valued+=' --timeout --wait --window --after --compression --end --except --last --max-rate --memory'
  valued+=' -o --output --quota --remap --split-size --split-time --start --topic --trigger'
  # The line is split at "=" as well.
  if [[ $current == = ]]; then
    current=
  elif [[ $before == = ]]; then
    before=${COMP_WORDS[COMP_CWORD - 2]}
  fi
  for ((i = 1; i < COMP_CWORD; ++i)); do
    case ${COMP_WORDS[i]} in
      -d | --dir)
        if [[ ${COMP_WORDS[++i]} == = ]]; then ((++i)); fi
        if ((i < COMP_CWORD)); then directory=${COMP_WORDS[i]}; fi
        ;;
      -s | --segment)
        if [[ ${COMP_WORDS[++i]} == = ]]; then ((++i)); fi
        ;;
      -*)
        if [[ " $valued " == *" ${COMP_WORDS[i]} "* && ${COMP_WORDS[++i]} == = ]]; then ((++i)); fi
        ;;
      *) if [[ -z $verb ]]; then verb=${COMP_WORDS[i]}; fi ;;
    esac
  done
  COMPREPLY=()
  case $before in
    -s | --segment)
      local name
      while IFS= read -r name; do
        if [[ $name == "$current"* ]]; then COMPREPLY+=("$(printf '%q' "$name")"); fi
      done < <(_lot_segments "$directory")
      return
      ;;
    -d | --dir)
      compopt -o filenames 2>/dev/null
      mapfile -t COMPREPLY < <(compgen -d -- "$current")
      return
      ;;
  esac
  if [[ $before == -o || $before == --output || ($current != -* && ($verb == info || $verb == play)) ]]; then
    compopt -o filenames 2>/dev/null
    if [[ $before == -o || $before == --output || " $valued " != *" $before "* ]]; then
      mapfile -t COMPREPLY < <(compgen -f -- "$current")
    fi
    return
  fi
  if [[ " $valued " == *" $before "* ]]; then return; fi
  case $verb in
    '') words='ls top who echo pub hz bw delay record info play clean doctor --version --help-all' ;;
    ls) words='--all --interval' ;;
    top) words='--once --interval' ;;
    who) words='--all' ;;
    echo) words='--field --full --elements --characters --envelope --history --count --timeout' ;;
    pub) words='--rate --count --like --wait --latch' ;;
    hz) words='--interval --window --count --duration --all' ;;
    bw) words='--interval --window --count --duration' ;;
    delay) words='--interval --window --count --duration --field' ;;
    record)
      words='--all --except -o --output --compression --no-crc --split-size --split-time'
      words+=' --duration --max-rate --quota --last --after --memory --trigger'
      ;;
    info) words='--recover --quick' ;;
    play) words='--topic --except --remap --rate --start --end --wait --loop --paused' ;;
    clean) words='--dry-run --with-items' ;;
    doctor) ;;
    *) return ;;
  esac
  words+=' -h --help -s --segment -d --dir --json'
  # A word that does not begin with a dash can only be a verb.
  if [[ $current != -* && -n $verb ]]; then return; fi
  if [[ $current != -* ]]; then words=${words%% --*}; fi
  mapfile -t COMPREPLY < <(compgen -W "$words" -- "$current")
}

complete -F _lot lot
