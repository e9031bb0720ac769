#!/usr/bin/env bash
# Installs what is missing, builds, checks the formatting and runs the tests.
#   ./test.sh                 every test of the release build
#   ./test.sh --quick         without the tests labelled slow
#   ./test.sh --label unit    only the tests with this label (unit, device, replay, slow, vm)
#   ./test.sh --sanitizers    also the address, undefined-behaviour and thread sanitizers' builds, without
#                             the flights over real image sets (real_sets_tests) and without guests (vm)
#   ./test.sh --extra         also installs colmap, with which more checks run
# The tests labelled vm need cameras: they run with emulated ones in a guest made from a Debian kernel, for which
# qemu is installed and 224 MB are fetched, once. Where that cannot be, they are skipped, with the reason.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/scripts/setup.sh"

sanitizers=0 extra=0 guest=1 select=()
while [[ $# -gt 0 ]]; do
  case $1 in
    --quick) select+=(-LE slow) ;;
    --label)
      [[ $# -gt 1 ]] || die "--label takes the name of a label"
      select+=(-L "^$2\$")
      [[ $2 == vm ]] || guest=0
      shift
      ;;
    --sanitizers) sanitizers=1 ;;
    --extra) extra=1 ;;
    -h | --help)
      sed -n '2,/^set /{s/^# \{0,1\}//;/^set /d;p}' "${BASH_SOURCE[0]}"
      exit 0
      ;;
    *) die "unknown argument $1 (./test.sh --help lists them)" ;;
  esac
  shift
done

check_format() {
  step "format: clang-format"
  command -v clang-format >/dev/null || die "clang-format is not installed"
  local sources
  mapfile -t sources < <(find "$root" -path "$root/build" -prune -o -path "$root/out" -prune \
    -o -path "*/node_modules" -prune -o \( -name '*.h' -o -name '*.cpp' \) -print | sort)
  [[ ${#sources[@]} -gt 0 ]] || die "no sources found under $root"
  clang-format --dry-run --Werror "${sources[@]}" || die "run clang-format -i on the files above"
}

# Makes the guest of the vm tests, or writes down why there is none.
prepare_guest() {
  local folder="$root/build/vm"
  step "guest for the tests with cameras"
  mkdir -p "$folder"
  rm -f "$folder/unavailable"
  if ! (install_packages "${packages_vm[@]}" && "$root/tests/vm/prepare.sh") >"$folder/setup.log" 2>&1; then
    tail -n 1 "$folder/setup.log" >"$folder/unavailable"
    step "the vm tests will be skipped: $(<"$folder/unavailable")"
  fi
}

# guest_line LOG: what a run's vm tests came to.
guest_line() {
  [[ $guest -eq 1 ]] || return 0
  if [[ -s "$root/build/vm/unavailable" ]]; then
    echo "vm: skipped: $(<"$root/build/vm/unavailable")"
    return 0
  fi
  awk '/ Test +#[0-9]+: vm\..*(Passed|Failed|Timeout|Skipped|Not Run)/ {
      guests++
      if (!/Passed/) bad++
      for (i = NF; i > 1; i--) if ($i == "sec") { seconds += $(i - 1); break }
    }
    END { if (guests) printf "vm: %d guests, %.0f s, %d not passed\n", guests, seconds, bad }' "$1"
}

# run_tests PRESET [ARGUMENT...]: the tests of one build; the runner's closing lines are kept for the end.
summary=()
failed=0
run_tests() {
  local preset=$1 log status=0
  shift
  log="$root/build/$preset-tests.log"
  step "tests: preset $preset"
  ctest --test-dir "$root/build/$preset" --parallel "$(nproc)" --output-on-failure \
    --no-tests=error "${select[@]}" "$@" 2>&1 | tee "$log" || status=$?
  [[ $status -eq 0 ]] || failed=1
  summary+=("== $preset ==" "$(sed -n '/^[0-9]*% tests passed/,$p' "$log")" "$(guest_line "$log")")
}

install_packages "${packages_build[@]}" "${packages_test[@]}"
[[ $extra -eq 0 ]] || install_packages "${packages_extra[@]}"
[[ $guest -eq 0 ]] || prepare_guest
check_format
build release -DCORVID_TESTS=ON -DCORVID_BENCH=ON
# Results must not hang on the user's settings; the tests keep their kernel cache in the build tree.
export LC_ALL=C.UTF-8 XDG_CACHE_HOME="$root/build/test-cache"
unset CORVID_DEVICE CORVID_KERNEL_DIR CORVID_TUNING
run_tests release
if [[ $sanitizers -eq 1 ]]; then
  suppressions="$root/cmake/sanitizers"
  export ASAN_OPTIONS="detect_leaks=1:strict_string_checks=1:detect_stack_use_after_return=1"
  export LSAN_OPTIONS="suppressions=$suppressions/leaks.txt:print_suppressions=0"
  export UBSAN_OPTIONS="print_stacktrace=1:suppressions=$suppressions/undefined.txt"
  export TSAN_OPTIONS="halt_on_error=1:second_deadlock_stack=1:suppressions=$suppressions/threads.txt"
  for preset in asan-ubsan tsan; do
    build "$preset"
    # Minutes each without a sanitizer, and several times that with one; the engine's tests fly the
    # same code over made-up scenes. Guests are slow already.
    run_tests "$preset" -E '^(real_sets|vm)\.'
  done
fi
step "closing lines of the test runs"
printf '%s\n' "${summary[@]}"
exit "$failed"
