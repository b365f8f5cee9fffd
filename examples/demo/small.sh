#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The demo where shared memory has 64 MB, as in a container: it chooses smaller frames, says so, and ends well.
#
#     small.sh LOT_DEMO
set -euo pipefail

place=$(mktemp -d)
trap 'rm -f "$place.said"; rmdir "$place"' EXIT
namespace=(unshare --mount)
if [ "$(id -u)" -ne 0 ]; then namespace+=(--user --map-root-user); fi

if ! "${namespace[@]}" mount -t tmpfs -o size=64m tmpfs "$place"; then
  echo "skipped: can not mount a tmpfs"
  exit 0
fi
export LOT_DIR=$place
# shellcheck disable=SC2016  # the inner shell expands it
"${namespace[@]}" bash -c 'mount -t tmpfs -o size=64m tmpfs "$LOT_DIR" && "$0" --frames 30 --depth 32' "$1" | tee "$place.said"
grep -qE "has 67 MB free: frames of [0-9]+ KiB" "$place.said"
