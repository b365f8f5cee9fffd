#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Checks Debian packages: lintian finds no error, dpkg installs them with what they depend on, and projects
# of somebody else find what is in them.
#
#     packages.sh FOLDER         FOLDER has the packages
#     packages.sh --self-test FOLDER   plants mistakes, and sees that each is found
#
# LOT_TEST_ONE_IN=N: one of each N mistakes, others with each LOT_TEST_SEED.
#
# They are installed into a copy of this system that lies in memory (an overlay) and goes with the script.
# It takes root, or sudo without a password. Where no overlay can be mounted, as in a container without the
# right to, they are unpacked instead; with INSIST=1 in the environment that is a failure.
set -euo pipefail

self=$(realpath "${BASH_SOURCE[0]}")
no_overlay=77  # an exit status

judge() {  # FOLDER
  lintian --fail-on error --allow-root "$1"/*.deb
}

# What users do. PREFIX: where the packages' /usr is.
use() {  # PREFIX SCRATCH
  local prefix=$1 scratch=$2 flags
  export PKG_CONFIG_PATH=$prefix/lib/pkgconfig LOT_SEGMENT=${LOT_SEGMENT:-lot}_packages
  "$prefix/bin/lot" --version
  ("$prefix/bin/lot_relay" 2>&1 || true) | grep "^usage: lot_relay"
  for package in liblot-dev liblot-ros0.1 liblot-ros-dev lot-gateway lot-tools python3-lot; do
    gzip -t "$prefix/share/doc/$package/changelog.gz" "$prefix/share/doc/$package/changelog.Debian.gz"
    test -s "$prefix/share/doc/$package/copyright"
  done
  "$prefix/bin/lot_gateway" --version
  zgrep -q "^.Nm lot_gateway" "$prefix/share/man/man1/lot_gateway.1.gz"
  # Where each shell of Debian looks.
  test -s "$prefix/share/bash-completion/completions/lot"
  test -s "$prefix/share/zsh/vendor-completions/_lot"
  test -s "$prefix/share/fish/vendor_completions.d/lot.fish"
  # The transport of image_transport: its description leads to it, and it finds the library.
  local plugins=$prefix/share/lot_image_transport plugin
  plugin=$(sed -n 's/.*<library path="\([^"]*\)".*/\1/p' "$plugins/plugins.xml")
  ldd "$plugins/$plugin.so" | grep "liblot_ros.so.* => $prefix/"

  PYTHONPATH=$prefix/lib/python3/dist-packages PYTHONDONTWRITEBYTECODE=1 /usr/bin/python3 tests/proof/consumer/main.py

  flags=$(pkg-config --cflags --libs lot)
  # shellcheck disable=SC2086  # flags are words
  g++ -std=c++17 tests/proof/consumer/main.cpp $flags -o "$scratch/by_pkg_config"
  "$scratch/by_pkg_config"
  flags=$(pkg-config --cflags --libs lot-record)
  # shellcheck disable=SC2086  # flags are words
  g++ -std=c++20 tests/proof/consumer/record/main.cpp $flags -o "$scratch/record_by_pkg_config"
  "$scratch/record_by_pkg_config"
  local project
  for project in consumer consumer/record consumer/ros; do
    cmake -S "tests/proof/$project" -B "$scratch/$project.tree" -G Ninja -DCMAKE_BUILD_TYPE=Debug \
      -DCMAKE_CXX_FLAGS_DEBUG=-O0 -DCMAKE_PREFIX_PATH="$prefix"
    grep "^lot_DIR:PATH=$prefix/" "$scratch/$project.tree/CMakeCache.txt"
    cmake --build "$scratch/$project.tree"
    "$scratch/$project.tree/consumer"
  done
}

# In a mount namespace of its own: a copy of this system in memory, into which the packages go.
install_here() {  # FOLDER COPY
  local folder=$1 copy=$2 place
  mount -t tmpfs tmpfs "$copy" || exit $no_overlay
  mkdir "$copy/changes" "$copy/work" "$copy/root"
  mount -t overlay overlay -o "lowerdir=/,upperdir=$copy/changes,workdir=$copy/work" "$copy/root" ||
    exit $no_overlay
  for place in /proc /dev /sys "$PWD" "$folder"; do
    mkdir -p "$copy/root$place"
    mount --rbind "$place" "$copy/root$place"
  done
  chroot "$copy/root" dpkg --install "$folder"/*.deb
  chroot "$copy/root" env -C "$PWD" "$self" --use /usr "$(chroot "$copy/root" mktemp -d)"
}

install_and_use() {  # FOLDER
  local as_root=() status=0 scratch package
  if [ "$(id -u)" -ne 0 ]; then as_root=(sudo -n -E); fi
  scratch=$(mktemp -d)
  "${as_root[@]}" unshare --mount true || status=$no_overlay
  if [ $status -eq 0 ]; then
    "${as_root[@]}" unshare --mount "$self" --install "$1" "$scratch" || status=$?
  fi
  if [ $status -eq $no_overlay ]; then
    echo "no overlay can be mounted here: the packages are unpacked"
    status=0
    apt-get --simulate --no-install-recommends install "$1"/*.deb || status=$?
    for package in "$1"/*.deb; do dpkg-deb --extract "$package" "$scratch"; done
    mkdir "$scratch/work"
    if [ $status -eq 0 ]; then "$self" --use "$scratch/usr" "$scratch/work" || status=$?; fi
    if [ "${INSIST:-0}" -eq 1 ]; then status=1; fi
  fi
  rm -rf "$scratch"
  return $status
}

# Rebuilds a package after a change of its files, and expects that the check complains.
plant() {  # FOLDER PACKAGE CHECK CHANGE
  local bad status=0
  bad=$(mktemp -d)
  cp "$1"/*.deb "$bad"
  dpkg-deb --raw-extract "$bad/$2"_*.deb "$bad/files"
  (cd "$bad/files" && eval "$4")
  dpkg-deb --root-owner-group --build "$bad/files" "$(echo "$bad/$2"_*.deb)" >/dev/null
  rm -rf "$bad/files"
  "$self" "--$3" "$bad" >"$bad/log" 2>&1 || status=$?  # a process of its own: here set -e does not hold
  if [ $status -eq 0 ]; then
    echo "not found: $4"
    cat "$bad/log"
  fi
  rm -rf "$bad"
  [ $status -ne 0 ]
}

mistakes=(  # PACKAGE CHECK CHANGE
  "liblot-dev judge gzip -d usr/share/doc/liblot-dev/changelog.gz"
  "lot-tools install_and_use sed -i 's/^Depends: /Depends: no-such-package, /' DEBIAN/control"
  "liblot-dev install_and_use sed -i s/-llot/-lelse/ usr/lib/pkgconfig/lot.pc"
  "liblot-dev install_and_use rm usr/lib/liblot_record.a"
  "liblot-dev install_and_use sed -i s/-llot_record/-lelse/ usr/lib/pkgconfig/lot-record.pc"
  "lot-gateway install_and_use rm usr/share/man/man1/lot_gateway.1.gz"
  "python3-lot install_and_use rm usr/lib/python3/dist-packages/lot/service.py"
  "liblot-ros-dev install_and_use rm usr/lib/lot/image_transport/*.so"
  "lot-tools install_and_use mv usr/share/zsh/vendor-completions usr/share/zsh/site-functions")

self_test() {  # FOLDER
  local seed=${LOT_TEST_SEED:-$EPOCHSECONDS} step=${LOT_TEST_ONE_IN:-1} k found=0 package check change
  step=$((step < ${#mistakes[@]} ? step : ${#mistakes[@]}))
  echo "seed: LOT_TEST_SEED=$seed"
  for ((k = seed % step; k < ${#mistakes[@]}; k += step)); do
    read -r package check change <<<"${mistakes[k]}"
    plant "$1" "$package" "$check" "$change"
    found=$((found + 1))
  done
  echo "packages self-test: $found mistakes found"
}

cd "$(dirname "${BASH_SOURCE[0]}")/../.."
case ${1:-} in
  --use) use "$2" "$3" ;;
  --install) install_here "$2" "$3" ;;
  --judge) judge "$2" ;;
  --install_and_use) install_and_use "$2" ;;
  --self-test) self_test "$(realpath "$2")" ;;
  *)
    folder=$(realpath "${1:?packages.sh: which folder?}")
    judge "$folder"
    install_and_use "$folder"
    ;;
esac
