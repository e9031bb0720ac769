# Sourced by tests that need npm packages: npm_packages SOURCE_DIR WORK_DIR copies what npm and the test read into
# WORK_DIR, goes there, and installs what the lockfile names, unless that was done before.
# Exit code 77 (skipped, with the reason) where npm or its registry cannot be reached.
# shellcheck shell=sh
npm_packages() {
  if ! command -v npm >/dev/null 2>&1; then
    echo "SKIPPED: npm is absent (package npm)"
    exit 77
  fi
  mkdir -p "$2"
  cp "$1"/package.json "$1"/package-lock.json "$1"/*.mjs "$2/"
  cd "$2"
  if ! cmp -s package-lock.json node_modules/.corvid-lock.json 2>/dev/null; then
    if ! npm ci --no-audit --no-fund --ignore-scripts; then
      echo "SKIPPED: npm ci failed; is the npm registry reachable?"
      exit 77
    fi
    cp package-lock.json node_modules/.corvid-lock.json
  fi
}
