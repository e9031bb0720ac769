#!/bin/sh
# run.sh SOURCE_DIR WORK_DIR SAMPLE_PROGRAM: packets go both ways between ours and node-mavlink.
# Exit code 77 (skipped, with the reason) where npm or its registry cannot be reached.
set -eu
source_dir=$1 work_dir=$2 sample_program=$3
. "$source_dir/../npm_packages.sh"
npm_packages "$source_dir" "$work_dir"
"$sample_program" write ours.bin ours.json
node check_packets.mjs read ours.bin ours.json
node check_packets.mjs write theirs.bin theirs-v1.bin
for theirs in theirs.bin theirs-v1.bin; do
  "$sample_program" reencode "$theirs" back.bin
  if ! cmp theirs.bin back.bin; then
    echo "$theirs: not the same after reading and writing it again"
    exit 1
  fi
done
# The check must be able to fail: one wrong value, one wrong byte.
sed 's/"quality": 100/"quality": 99/' ours.json > wrong.json
if node check_packets.mjs read ours.bin wrong.json >/dev/null; then
  echo "a wrong value was not caught"
  exit 1
fi
{ head -c 40 ours.bin; printf '\252'; tail -c +42 ours.bin; } > wrong.bin
if node check_packets.mjs read wrong.bin ours.json >/dev/null; then
  echo "a wrong byte was not caught"
  exit 1
fi
