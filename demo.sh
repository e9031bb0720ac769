#!/usr/bin/env bash
# Installs what is missing, builds, and flies the synthetic flight. Arguments go to `corvid demo`.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/scripts/setup.sh"

install_packages "${packages_build[@]}"
build release -DCORVID_TESTS=OFF -DCORVID_BENCH=OFF
out=(--out "$root/out/demo")
for argument in "$@"; do
  [[ $argument == --out || $argument == --out=* || $argument == --help || $argument == -h ]] && out=()
done
step "demo: flying the synthetic flight"
"$root/build/release/corvid" demo "${out[@]}" "$@"
step "done"
