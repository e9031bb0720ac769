#!/bin/sh
# run.sh SOURCE_DIR WORK_DIR SAMPLE_PROGRAM: writes sample meshes and has other readers check them.
# Exit code 77 (skipped, with the reason) where npm or its registry cannot be reached.
set -eu
source_dir=$1 work_dir=$2 sample_program=$3
if ! command -v npm >/dev/null 2>&1; then
  echo "SKIPPED: npm is absent (package npm)"
  exit 77
fi
mkdir -p "$work_dir/meshes"
cp "$source_dir/package.json" "$source_dir/package-lock.json" "$source_dir/check_meshes.mjs" "$work_dir/"
cd "$work_dir"
if ! cmp -s package-lock.json node_modules/.corvid-lock.json 2>/dev/null; then
  if ! npm ci --no-audit --no-fund --ignore-scripts; then
    echo "SKIPPED: npm ci failed; is the npm registry reachable?"
    exit 77
  fi
  cp package-lock.json node_modules/.corvid-lock.json
fi
rm -f meshes/*
"$sample_program" meshes
node check_meshes.mjs meshes
# The check must be able to fail: a file with a wrong count is caught.
mkdir -p broken
sed 's/"count":\([0-9]\)/"count":9/' meshes/plain.glb > broken/plain.glb
if node check_meshes.mjs broken >/dev/null; then
  echo "a broken file was not caught"
  exit 1
fi
