#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A robot in three boxes on one machine: network namespaces for cameras, planner and operator, with a bridge between
# them, a segment in each, and lot_gateway beside it. Kills parts of it, starts them again, and prints what came. Root.
#
#     examples/fleet/fleet.sh [BUILD] [SECONDS]        (default: build/release 10)
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
build=${1:-$here/../../build/release}
seconds=${2:-10}
fleet=$build/examples/fleet
gateway=$build/src/gateway/lot_gateway
boxes=(cameras planner operator)
prefix=${LOT_SEGMENT:-fleet}_$$
declare -A network program link

if [ "$(id -u)" -ne 0 ]; then
  echo "skipped: containers with networks of their own need root"
  exit 0
fi

place=$(mktemp -d)
end() {
  kill -9 "${program[@]}" "${link[@]}" "${network[@]}" 2>/dev/null || true
  wait 2>/dev/null || true
  rm -rf "$place"
  for box in "${boxes[@]}"; do rm -f "/dev/shm/${prefix}_$box" "/dev/shm/${prefix}_$box.lock"; done
}
trap end EXIT

within() {  # BOX COMMAND...: in its network, with its segment
  local box=$1
  shift
  LOT_SEGMENT=${prefix}_$box LOT_SIZE=128M exec nsenter "--net=/proc/${network[$box]}/ns/net" "$@"
}

# ---- three boxes, and a bridge in the planner's ----

for box in "${boxes[@]}"; do
  unshare --net sleep infinity &
  network[$box]=$!
done
own=$(readlink /proc/self/ns/net)
for box in "${boxes[@]}"; do
  until there=$(readlink "/proc/${network[$box]}/ns/net") && [ "$there" != "$own" ]; do
    if ! kill -0 "${network[$box]}" 2>/dev/null; then
      echo "skipped: no network between containers here"
      exit 0
    fi
    sleep 0.01
  done
done
(within planner ip link add hub type bridge)
(within planner ip link set hub up)
number=0
for box in "${boxes[@]}"; do
  number=$((number + 1))
  ip link add lot0 netns "${network[$box]}" type veth peer name "to_$box" netns "${network[planner]}"
  (within planner ip link set "to_$box" master hub up)
  (within "$box" ip address add "10.78.0.$number/24" dev lot0)
  (within "$box" ip link set lot0 up)
  (within "$box" ip link set lo up)
done

for box in "${boxes[@]}"; do  # programs pass over an interface that is not ready when they start
  until (within "$box" ip link show lot0) | grep -q 'state UP'; do sleep 0.01; done
done

# ---- what runs in them ----

cat >"$place/planner.yaml" <<'SETTINGS'
in: [/camera/*]
out:
  - /control
  - {topics: /map, durability: transient_local, depth: 1}
SETTINGS
start_program() { within "$1" "$fleet" "$1" >"$place/$1" & program[$1]=$!; }
start_gateway() {
  case $1 in
    cameras) within "$1" "$gateway" --interface lot0 --out '/camera/*' >"$place/gateway_$1" 2>&1 & ;;
    planner) within "$1" "$gateway" --interface lot0 --config "$place/planner.yaml" >"$place/gateway_$1" 2>&1 & ;;
    operator) within "$1" "$gateway" --interface lot0 --in /control --in /map >"$place/gateway_$1" 2>&1 & ;;
  esac
  link[$1]=$!
}
kill_one() { kill -9 "$1" && { wait "$1" 2>/dev/null || true; }; }
run_for() { sleep "$(awk "BEGIN { print $seconds * $1 }")"; }

for box in "${boxes[@]}"; do start_gateway "$box"; done
for box in "${boxes[@]}"; do start_program "$box"; done
run_for 0.5
echo "kill -9: the gateway of the cameras, the cameras, the gateway of the planner"
for victim in "${link[cameras]}" "${program[cameras]}" "${link[planner]}"; do kill_one "$victim"; done
run_for 0.1
start_gateway cameras
start_gateway planner
start_program cameras
run_for 0.4

for box in cameras planner operator; do kill "${program[$box]}" && wait "${program[$box]}"; done
sleep 0.3
for box in cameras planner operator; do kill "${link[$box]}" && wait "${link[$box]}"; done
for box in "${boxes[@]}"; do
  echo "== $box"
  cat "$place/$box"
  grep -E '^(out|in)  *[0-9]|carried' "$place/gateway_$box"
done
