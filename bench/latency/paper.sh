#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs the experiments of the LOT paper, and draws its figures anew.
#
#     bench/latency/paper.sh [--quick | --full] [--out DIR]     (default DIR: build/paper)
#
#   (none)    8 sizes, 500 messages: under 90 minutes
#   --quick   3 sizes, 40 messages: under 10 minutes, to see that all of it works
#   --full    14 sizes, 2000 messages, every transport, with and without a pool: a day
#
# Cells that DIR has already are left out: a run that was broken off goes on where it stopped. Some
# cells need root (TCP and UDP between containers); without it the output says what was left out.
# LOT_AB names another program than build/release/bench/latency/lot_ab.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

out=build/paper
size=normal
while [ $# -gt 0 ]; do
  case $1 in
    --quick | --full) size=${1#--} ;;
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

lot_ab=${LOT_AB:-build/release/bench/latency/lot_ab}
if [ ! -x "$lot_ab" ]; then
  echo "paper.sh: there is no $lot_ab; scripts/test --stage release builds it" >&2
  exit 2
fi

sizes=256,2K,8K,32K,128K,1M,4M,16M
messages=500 block=25 load_s=60 av_s=30
case $size in
  quick) sizes=256,1M,16M messages=40 block=10 load_s=4 av_s=4 ;;
  full)
    sizes=256,512,1K,2K,4K,8K,32K,128K,512K,1M,2M,4M,8M,16M
    messages=2000 block=50 av_s=60
    ;;
esac

# What the paper compares, or with --full whatever there is: others NAME,... -> the option for lot_ab.
these() { if [ "$size" = full ]; then echo "--block=$block"; else echo "--transports=$1"; fi; }
failed=0
measure() {
  echo "== $1"
  shift
  local status=0
  "$lot_ab" --out "$out" --resume "$@" || status=$?
  if [ $status -ge 2 ]; then exit $status; fi
  if [ $status -ne 0 ]; then failed=1; fi
}

paced=(--messages $messages --block $block --pool 100)
measure "figures 6 a, 3: one publisher, one subscriber, in separate containers" \
  "${paced[@]}" --size $sizes --place containers "$(these ring,tcp,udp,uds,tzc,floor-futex)" --no-floors
measure "figure 3: in one container" \
  "${paced[@]}" --size $sizes --place container "$(these ring,tcp)" --no-floors
measure "figure 3: on the host; and the stack of the paper" \
  "${paced[@]}" --size $sizes "$(these ring,mutex,tcp,lot2021)"
measure "figures 6 b, c: on cores of their own" \
  "${paced[@]}" --size $sizes --pin other-core "$(these ring,tcp)" --no-floors
measure "figure 6 d: Nagle's algorithm" \
  "${paced[@]}" --size 512,1K "$(these tcp-nagle,tcp,ring)" --no-floors
measure "figure 5: five publishers" \
  "${paced[@]}" --size $sizes --graph 5p1s --place containers "$(these ring,tcp,tzc)" --no-floors
measure "figure 7: five subscribers" \
  "${paced[@]}" --size $sizes --graph 1p5s --place containers "$(these ring,tcp,uds,tzc,floor-futex)" --no-floors
measure "figure 7 b: five subscribers, one after the other" \
  "${paced[@]}" --size $sizes --graph 1p5s --place containers --ordered "$(these tcp,ring)" --no-floors
measure "figure 8, table 1: load at 16 MiB" \
  --size 16M --graph 1p1s,1p5s,5p1s --messages $((30 * load_s)) --block $((30 * load_s)) --pool 100 --profile \
  --transports ring,mutex,tcp,lot2021 --no-floors
measure "the vehicle, with and without its cameras" \
  --graph av,av-quiet --messages $((400 * av_s)) --block $((400 * av_s / 4)) --pool 100 "$(these ring,mutex,tcp,lot2021)"
measure "spinning: ping-pong" \
  --mode ping-pong --wait spin --pin other-core --size 128,1M --messages 20000 --block 1000 \
  "$(these ring,ring-borrow,mutex,tcp,uds,iceoryx,fastdds)"
measure "parked: ping-pong on one core" \
  --mode ping-pong --wait park --pin same-core --size 128 --messages 20000 --block 1000 --pool 100 \
  "$(these ring,ring-borrow,mutex,lot2021,tcp,uds)"
measure "throughput" \
  --mode throughput --wait adaptive --size 128,64K --messages 100000 --block 10000 --pool 100 \
  "$(these ring,ring-borrow,mutex,lot2021,tcp,uds,iceoryx)"

"$lot_ab" plot "$out"
exit $failed
