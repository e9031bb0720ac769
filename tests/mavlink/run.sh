#!/bin/sh
# run.sh SOURCE_DIR WORK_DIR SAMPLE_PROGRAM: packets go both ways between ours and node-mavlink.
# Exit code 77 (skipped, with the reason) where npm or its registry cannot be reached.
set -eu
source_dir=$1 work_dir=$2 sample_program=$3
if ! command -v npm >/dev/null 2>&1; then
  echo "SKIPPED: npm is absent (package npm)"
  exit 77
fi
mkdir -p "$work_dir"
cp "$source_dir/package.json" "$source_dir/package-lock.json" "$source_dir/check_packets.mjs" "$work_dir/"
cd "$work_dir"
if ! cmp -s package-lock.json node_modules/.corvid-lock.json 2>/dev/null; then
  if ! npm ci --no-audit --no-fund --ignore-scripts; then
    echo "SKIPPED: npm ci failed; is the npm registry reachable?"
    exit 77
  fi
  cp package-lock.json node_modules/.corvid-lock.json
fi
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
