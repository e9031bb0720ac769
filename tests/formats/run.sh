#!/bin/sh
# run.sh SOURCE_DIR WORK_DIR SAMPLE_PROGRAM: writes sample meshes and has other readers check them.
# Exit code 77 (skipped, with the reason) where npm or its registry cannot be reached.
set -eu
source_dir=$1 work_dir=$2 sample_program=$3
. "$source_dir/../npm_packages.sh"
npm_packages "$source_dir" "$work_dir"
mkdir -p meshes
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
