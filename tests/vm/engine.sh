#!/usr/bin/env bash
# Boots a guest for tests of the whole engine. Before, on the host: a synthetic flight is rendered, and flown
# once so that the OpenCL kernels lie in a cache (build/vm/opencl, kept): in the guest either would take minutes.
#   tests/vm/engine.sh CORVID GUEST_VECTORS [boot.sh's options] -- COMMAND [ARGUMENT]...
#     CORVID         the program
#     GUEST_VECTORS  the library of guest_vectors.cpp
# The command finds the flight in $CORVID_FLIGHT. Exit status: boot.sh's; 1 if the host's part fails.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
vm="$(cd "$here/../.." && pwd)/build/vm"
corvid=$1 guest_vectors=$2
shift 2
options=()
while [[ $# -gt 0 && $1 != -- ]]; do
  options+=("$1")
  shift
done
shift

# Nothing to prepare for a guest that there is not: boot.sh says so.
if [[ -s "$vm/unavailable" || ! -f "$vm/current/complete" ]]; then exec "$here/boot.sh" -- "$@"; fi

work="$(mktemp -d "$vm/flight.XXXXXX")"
trap 'rm -rf "$work"' EXIT
# PoCL builds for the processor that it runs on: for the least one, host and guest agree.
cache=(POCL_KERNELLIB_NAME=sse2 "POCL_CACHE_DIR=$vm/opencl" "XDG_CACHE_HOME=$work/cache")
mkdir -p "$vm/opencl"
"$corvid" --quiet record synthetic:duration=15,rate=2,width=160,height=120 --out "$work/flight"
"$corvid" --quiet record synthetic:duration=3,rate=2,width=320,height=240 --out "$work/usb"
for flight in flight usb; do
  # The second flight is too short for a pose; it is there for the size of the USB camera's pictures.
  env "${cache[@]}" LD_PRELOAD="$guest_vectors" "$corvid" --quiet replay "$work/$flight" --no-mapping \
    --set frontend.max_tracks=120 --out "$work/run" >"$work/log" 2>&1 || [[ $? -eq 6 ]] || {
    cat "$work/log" >&2
    exit 1
  }
done
rm -rf "$work/cache"

"$here/boot.sh" "${options[@]}" -- env "${cache[@]}" "CORVID_FLIGHT=$work/flight" "$@"
