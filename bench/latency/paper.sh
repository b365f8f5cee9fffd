#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs the experiments of the LOT paper, and draws its figures anew.
#
#     bench/latency/paper.sh [--quick | --full] [--ros] [--out DIR]     (default DIR: build/paper)
#
#   (none)    8 sizes, 500 messages: under 90 minutes
#   --quick   3 sizes, 20 messages: under 10 minutes, to see that all of it works
#   --full    14 sizes, 2000 messages, every transport, with and without a pool: days
#   --ros     with nodes of ROS, instead (default DIR: build/paper-ros): 8 sizes, 150 messages: an hour
#
# Cells that DIR has already are left out: a run that was broken off goes on where it stopped. Some
# cells need root (TCP and UDP between containers); without it the output says what was left out, as
# it does of transports that lot_ab was built without.
# LOT_AB names another program than build/release/bench/latency/lot_ab.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

out=
size=normal
ros=no
while [ $# -gt 0 ]; do
  case $1 in
    --quick | --full) size=${1#--} ;;
    --ros) ros=yes ;;
    --out)
      out=${2:?"--out needs a directory"}
      shift
      ;;
    *)
      sed -n '3,/^set /{/^#/s/^# \{0,1\}//p}' "${BASH_SOURCE[0]}"
      [ "$1" = --help ] || [ "$1" = -h ] && exit 0
      echo "paper.sh: unknown option '$1'" >&2
      exit 2
      ;;
  esac
  shift
done

if [ -z "$out" ]; then
  if [ $ros = yes ]; then out=build/paper-ros; else out=build/paper; fi
fi

lot_ab=${LOT_AB:-build/release/bench/latency/lot_ab}
if [ ! -x "$lot_ab" ]; then
  echo "paper.sh: there is no $lot_ab; scripts/test --stage release builds it" >&2
  exit 2
fi

# How long that is: messages / 30 Hz for each arm (floors are arms) of each cell, with 2 cores.
#   figures 3, 5, 6, 7 at 8 sizes, 500 messages: (6 + 2 + 5 + 2 + 4 + 5 + 1) x 8 + 6 (Nagle), 206 arms: 57 min
#   every transport at 3 sizes, 120 messages: 18 x 3 arms                                               4 min
#   small differences, 10,000 messages at 1 kHz: 9 arms                                                 2 min
#   peers that spin, and frames that are made anew, 100 messages: 9 x 3 + 2 x 6 arms                    3 min
#   load: 4 x 3 arms of 60 s, 6 of 20 s                                                                14 min
#   the vehicle: 2 x 7 arms of 20 s                                                                     5 min
# 84 minutes, and some more for starting nodes, for ping-pong and for throughput.
#
# How much memory: size x publishers x (depth + pool) for each arm of a cell, together 12 GiB with
# 16 MiB and a pool of 100. Where publishers or topics are many, the pool is 10, and 4 may wait.
sizes=256,2K,8K,32K,128K,1M,4M,16M
messages=500 block=25 others=120 many=10000 some=100 load_s=60 av_s=20 balls=20000 most=100000 pools=100
case $size in
  quick) sizes=256,1M,16M messages=20 block=5 others=20 many=200 some=20 load_s=2 av_s=2 balls=2000 most=20000 ;;
  full)
    sizes=256,512,1K,2K,4K,8K,32K,128K,512K,1M,2M,4M,8M,16M
    messages=2000 block=50 others=2000 many=20000 some=2000 av_s=60 pools="100 0"
    ;;
esac

here=$("$lot_ab" list | awk '$2 !~ /^\(/ { print $1 }')
if [ $ros = yes ] && ! grep -qx ros-lot <<<"$here"; then
  echo "paper.sh: this lot_ab was built without ROS: run scripts/setup ros, and build it again" >&2
  exit 2
fi
every=$(grep -v -e '^floor-' -e '^ros-' <<<"$here" | paste -sd,)
# Of NAME,... those that lot_ab has, and a line about the others.
those_here() {
  local name some=()
  for name in ${1//,/ }; do
    if grep -qx -e "$name" <<<"$here"; then
      some+=("$name")
    else
      echo "left out: $name, which this lot_ab was built without" >&2
    fi
  done
  (
    IFS=,
    echo "${some[*]}"
  )
}

failed=0
# TITLE NAME,... OPTION...: cells of these transports.
only() {
  local transports status=0
  echo "== $1"
  transports=$(those_here "$2")
  shift 2
  "$lot_ab" --out "$out" --resume --transports "$transports" "$@" || status=$?
  if [ $status -ge 2 ]; then exit $status; fi
  if [ $status -ne 0 ]; then failed=1; fi
}
# The same, but with --full of every other transport, too.
measure() {
  if [ "$size" = full ]; then only "$1" "$every,$2" "${@:3}"; else only "$@"; fi
}

if [ $ros = yes ]; then
  nodes=ros-lot,ros-lot-immediate,ros-lot-mutex,ros-tcp,ros-tzc,ros-intra
  [ "$size" = normal ] && messages=150
  few=(--messages "$messages" --block "$block" --pool 4)
  only "in ROS: one publisher, one subscriber" $nodes,ros-udp,ring,tcp "${few[@]}" --size 128,$sizes
  for place in container containers; do
    only "in ROS: placement, $place" ros-lot,ros-tcp "${few[@]}" --size $sizes --place $place --no-floors
  done
  only "in ROS: on cores of their own" ros-lot,ros-tcp "${few[@]}" --size $sizes --pin other-core --no-floors
  only "in ROS: the vehicle, with and without its cameras" ros-lot,ros-lot-immediate,ros-tcp \
    --pool 10 --depth 4 --graph av --messages $((400 * av_s)) --block 400
  only "in ROS: Nagle's algorithm" ros-tcp,ros-tcp-nodelay,ros-lot "${few[@]}" --size 512,1K --no-floors
  only "in ROS: spinning" $nodes,ring "${few[@]}" --size 128,16M --wait spin
  only "in ROS: frames that are not filled" ros-lot,ros-lot-immediate,ros-intra,ring \
    --messages $((messages * 8)) --block $((messages * 8 / 20)) --rate 100 --pool 4 --size 128,16M --fill no
  only "in ROS: what a message of 16 MiB costs" ros-lot,ros-lot-immediate,ros-tcp,ring,floor-pace,floor-ros \
    --messages $((messages * 4)) --block "$messages" --pool 4 --size 16M --fill no --no-floors
  only "in ROS: five publishers" ros-lot,ros-tcp,ros-tzc \
    "${few[@]}" --depth 4 --size $sizes --graph 5p1s --no-floors
  only "in ROS: five subscribers" ros-lot,ros-lot-immediate,ros-tcp,ros-tzc,floor-futex \
    "${few[@]}" --size $sizes --graph 1p5s --no-floors
  only "in ROS: five subscribers, one after the other" ros-tcp \
    "${few[@]}" --size $sizes --graph 1p5s --ordered --no-floors
  only "in ROS: load at 16 MiB" ros-lot,ros-lot-immediate,ros-tcp --size 16M --no-floors --pool 10 --depth 4 \
    --messages $((15 * load_s)) --block $((15 * load_s)) --graph 1p1s,1p5s,5p1s --profile
  "$lot_ab" plot "$out"
  exit $failed
fi

for prepared in $pools; do
  pool=(--pool "$prepared")
  few=(--pool $((prepared < 10 ? prepared : 10)) --depth 4)
  paced=(--messages "$messages" --block "$block" "${pool[@]}")
  ball=(--mode ping-pong --messages "$balls" --block $((balls / 20)) "${pool[@]}")
  load=(--size 16M --no-floors "${few[@]}")
  measure "spinning: ping-pong" ring,ring-borrow,mutex,tcp,uds,iceoryx,fastdds \
    "${ball[@]}" --wait spin --pin other-core --size 128,1M
  measure "parked: ping-pong on one core" ring,ring-borrow,mutex,lot2021,lot2021-direct,tcp,uds \
    "${ball[@]}" --wait park --pin same-core --size 128
  measure "parked: ping-pong across cores" ring,ring-borrow,mutex,lot2021,lot2021-direct,tcp,uds \
    "${ball[@]}" --wait park --pin other-core --size 128
  stream=(--mode throughput --size 128,64K --messages "$most" --block $((most / 10)))
  flood=("${stream[@]}" "${pool[@]}")
  measure "throughput, on cores of their own" ring,ring-borrow,mutex,lot2021,lot2021-direct,tcp,uds,iceoryx \
    "${flood[@]}" --wait adaptive --pin other-core
  [ "$size" = full ] || only "throughput, each message allocated" ring,lot2021,lot2021-direct \
    "${stream[@]}" --pool 0 --wait adaptive --pin other-core
  measure "throughput, parked on one core" ring,ring-borrow,mutex,lot2021,lot2021-direct,tcp,uds,iceoryx,intra \
    "${flood[@]}" --pin same-core
  measure "peers that spin" ring,ring-borrow,mutex,iceoryx,fastdds,fastdds-loan \
    --messages "$some" --block $((some / 5)) "${pool[@]}" --size 128,64K,1M --wait spin --pin other-core
  measure "small differences" ring,ring-borrow,mutex,lot2021,lot2021-direct,iceoryx \
    --messages "$many" --block $((many / 20)) --rate 1000 "${pool[@]}" --size 128
  measure "every transport beside every other, parked" "$every" \
    --messages "$others" --block $((others / 6 + 1)) "${pool[@]}" --size 128,64K,1M
  for filled in yes no; do
    [ "$size" = full ] || only "frames that are made anew, filled: $filled" ring,lot2021,lot2021-direct \
      --messages "$some" --block $((some / 5)) --pool 0 --size 16M --fill $filled
  done
  measure "five publishers beside the floor" ring,tcp \
    --messages "$some" --block $((some / 5)) "${few[@]}" --size 128,1M --graph 5p1s
  measure "the vehicle, with and without its cameras" ring,mutex,tcp,lot2021,lot2021-direct \
    "${few[@]}" --graph av --messages $((400 * av_s)) --block 400
  only "what a message of 16 MiB costs that is not filled" ring,mutex,tcp,lot2021,lot2021-direct,floor-pace \
    "${load[@]}" --messages $((10 * load_s)) --block $((10 * load_s / 4)) --fill no
  measure "figures 6 a, 3: one publisher, one subscriber, in separate containers" ring,tcp,udp,uds,tzc,floor-futex \
    "${paced[@]}" --size $sizes --place containers --no-floors
  measure "figure 3: in one container" ring,tcp "${paced[@]}" --size $sizes --place container --no-floors
  measure "figure 3: on the host" ring,mutex,tcp,floor-futex,floor-pace "${paced[@]}" --size $sizes --no-floors
  measure "a rival at 16 MiB" ring,uds,floor-futex \
    --messages "$others" --block $((others / 6 + 1)) "${pool[@]}" --size 16M --no-floors
  measure "figures 6 b, c: on cores of their own" ring,tcp "${paced[@]}" --size $sizes --pin other-core --no-floors
  measure "figure 6 d: Nagle's algorithm" tcp-nagle,tcp,ring "${paced[@]}" --size 512,1K --no-floors
  measure "figure 5: five publishers" ring,tcp,tzc,floor-futex \
    --messages "$messages" --block "$block" "${few[@]}" --size $sizes --graph 5p1s --place containers --no-floors
  measure "figure 7: five subscribers" ring,tcp,uds,tzc,floor-futex \
    "${paced[@]}" --size $sizes --graph 1p5s --place containers --no-floors
  measure "figure 7 b: five subscribers, one after the other" tcp \
    "${paced[@]}" --size $sizes --graph 1p5s --place containers --ordered --no-floors
  only "figure 8, table 1: load at 16 MiB" ring,mutex,tcp,lot2021 \
    "${load[@]}" --messages $((30 * load_s)) --block $((30 * load_s)) --graph 1p1s,1p5s,5p1s --profile
done

"$lot_ab" plot "$out"
exit $failed
