# Sourced by demo.sh and test.sh: installs the Debian packages that are missing, and builds.
# shellcheck shell=bash
# The folder of the tree; the caller may stand anywhere.
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"

# The one place where the packages are listed. docs/dependencies.md says what each is for.
packages_build=(
  cmake ninja-build g++ ccache pkg-config
  libopencv-dev libeigen3-dev libceres-dev
  ocl-icd-opencl-dev opencl-clhpp-headers pocl-opencl-icd
  libnanoflann-dev libdraco-dev libspdlog-dev libfmt-dev libexpected-dev
  nlohmann-json3-dev libcli11-dev libyaml-cpp-dev libexif-dev libgeographiclib-dev
  libcamera-dev libcamera-ipa libavformat-dev libavcodec-dev libavutil-dev
)
packages_test=(libgtest-dev libgmock-dev libbenchmark-dev libjpeg-dev draco clang-format)
# An npm from elsewhere will do, and does not go together with Debian's.
command -v npm >/dev/null || packages_test+=(nodejs npm)
# Tests that find these run more checks; without them they say that they were skipped.
packages_extra=(colmap)
# With these the camera tests (label vm) run in an emulated guest; without, they are skipped and say so.
packages_vm=(qemu-system-x86 busybox-static kmod udev make gcc-12 xz-utils libelf1)

started=$SECONDS
step() { printf '[%4ds] %s\n' "$((SECONDS - started))" "$*"; }
die() {
  printf 'error: %s\n' "$*" >&2
  exit 1
}

# apt-get as root, by sudo where needed, without questions; waits for another apt to finish.
apt() {
  local as_root=()
  if [[ $(id -u) -ne 0 ]]; then
    command -v sudo >/dev/null ||
      die "packages are missing and neither root nor sudo is at hand. As root: apt-get install ${missing[*]}"
    as_root=(sudo)
    [[ -t 0 ]] || as_root=(sudo -n)
  fi
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -q -o DPkg::Lock::Timeout=300 \
    -o Dpkg::Use-Pty=0 -o Acquire::Retries=3 "$@"
}

# install_packages NAME...: installs those that are not there.
install_packages() {
  if ! command -v dpkg-query >/dev/null || ! command -v apt-get >/dev/null; then
    step "not a Debian system: install by hand what docs/dependencies.md lists"
    return
  fi
  missing=()
  local package
  for package in "$@"; do
    [[ "$(dpkg-query -W -f '${Status}' "$package" 2>/dev/null)" == "install ok installed" ]] ||
      missing+=("$package")
  done
  if [[ ${#missing[@]} -eq 0 ]]; then
    step "packages: all $# are there"
    return
  fi
  step "packages: installing ${missing[*]}"
  local log
  log="$(mktemp)"
  if ! { apt update && apt install -y --no-install-recommends "${missing[@]}"; } >"$log" 2>&1; then
    tail -n 30 "$log" >&2
    rm -f "$log"
    die "the packages could not be installed; the lines above are apt's last"
  fi
  rm -f "$log"
}

# build PRESET [CMAKE-ARGUMENT...]: configures and builds build/PRESET. The number of compile jobs
# is capped by memory in cmake/CorvidBuild.cmake.
build() {
  local preset=$1 log
  shift
  log="$root/build/$preset-configure.log"
  mkdir -p "$root/build"
  step "configure: preset $preset"
  if ! (cd "$root" && cmake --preset "$preset" "$@") >"$log" 2>&1; then
    tail -n 30 "$log" >&2
    die "configuring failed; all of it is in $log"
  fi
  step "build: preset $preset"
  (cd "$root" && cmake --build --preset "$preset" -- ${CORVID_NINJA_FLAGS:-}) ||
    die "the build failed; the lines above say where"
}
