#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Two gateways with certificates of one authority, and two more without: one has none, one has another authority's.
# A planner's messages come to the first operator alone. All of it runs on the loopback interface of this machine.
#
#     examples/secure_gateway/secure_gateway.sh [BUILD] [SECONDS]        (default: build/release 5)
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
build=${1:-$here/../../build/release}
seconds=${2:-5}
prefix=${LOT_SEGMENT:-secure}_$$
domain=7
export LOT_SIZE=64M

place=$(mktemp -d)
mkdir "$place/ours" "$place/theirs"
started=()
boxes=(planner operator none other)
end() {
  kill -9 "${started[@]}" 2>/dev/null || true
  wait 2>/dev/null || true
  rm -rf "$place"
  for box in "${boxes[@]}"; do rm -f "/dev/shm/${prefix}_$box" "/dev/shm/${prefix}_$box.lock"; done
}
trap end EXIT

"$here/certificates.sh" "$place/ours" $domain 'rt/control' planner operator
"$here/certificates.sh" "$place/theirs" $domain 'rt/control' other

# For a domain on one machine that meets no other: without multicast, with a tag.
alone="<CycloneDDS><Domain Id=\"any\"><General><Interfaces><NetworkInterface address=\"127.0.0.1\"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><Tag>$prefix</Tag><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>9</MaxAutoParticipantIndex><Peers><Peer Address=\"127.0.0.1\"/></Peers></Discovery></Domain></CycloneDDS>"

start_gateway() {  # BOX SETTINGS WORDS...
  local box=$1 settings=$2
  shift 2
  CYCLONEDDS_URI="$alone${settings:+,file://$settings}" LOT_SEGMENT=${prefix}_$box \
    "$build/src/gateway/lot_gateway" --domain $domain "$@" >"$place/gateway_$box" 2>"$place/log_$box" &
  started+=($!)
}
start_program() {  # BOX ROLE
  LOT_SEGMENT=${prefix}_$1 "$build/examples/fleet" "$2" >"$place/$1" &
  started+=($!)
}

trap '' USR1  # for a gateway that has begun, and does not know that signal yet
start_gateway planner "$place/ours/planner.xml" --out /control
start_gateway operator "$place/ours/operator.xml" --in /control
start_gateway none "" --in /control
start_gateway other "$place/theirs/other.xml" --in /control
for box in operator none other; do start_program $box operator; done
start_program planner planner

came() { awk '$1 == "in" && $NF == "/control" { came = $2 } END { print came + 0 }' "$place/gateway_$1"; }
for _ in $(seq 300); do  # until the two have met
  sleep 0.1
  grep -q 'lot_gateway: in /control' "$place/log_operator" || continue  # it does not take signals yet
  kill -USR1 "${started[1]}"
  sleep 0.1
  [ "$(came operator)" -eq 0 ] || break
done
sleep "$seconds"

for program in "${started[@]:4}" "${started[@]:0:4}"; do kill "$program" && wait "$program"; done
for box in "${boxes[@]}"; do
  echo "== $box"
  cat "$place/$box"
  tail -n 2 "$place/gateway_$box"
done

[ "$(came operator)" -gt 0 ] || { echo "nothing came to the operator"; cat "$place"/log_*; exit 1; }
for box in none other; do
  [ "$(came $box)" -eq 0 ] || { echo "$box has got messages"; exit 1; }
done
