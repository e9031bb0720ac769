#!/usr/bin/env bash
# Proves that demo.sh and test.sh work on a bare Debian 12: makes a minimal root with debootstrap,
# copies the committed tree into it (nothing else), and runs the scripts there.
#   scripts/prove-bare.sh [--root FOLDER] [--again] [--suite bookworm] [--mirror URL] [COMMAND...]
# COMMAND is run by bash inside the clone; default: ./demo.sh && ./test.sh
# --again goes on in a root that an earlier run made, with today's tree: quicker, and no proof.
# Needs root and debootstrap. The folder is kept; remove it yourself when you are done.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

bare=/var/tmp/corvid-bare suite=bookworm mirror=http://deb.debian.org/debian again=0 command=()
while [[ $# -gt 0 ]]; do
  case $1 in
    --root) bare=$2; shift 2 ;;
    --again) again=1; shift ;;
    --suite) suite=$2; shift 2 ;;
    --mirror) mirror=$2; shift 2 ;;
    -h | --help) sed -n '2,7s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 0 ;;
    *) command=("$@"); break ;;
  esac
done
[[ ${#command[@]} -gt 0 ]] || command=("./demo.sh && ./test.sh")
[[ $(id -u) -eq 0 ]] || die "needs root: chroot and mount"
if [[ $again -eq 0 ]]; then
  command -v debootstrap >/dev/null || die "needs debootstrap: apt-get install debootstrap"
  [[ ! -e $bare ]] || die "$bare exists; name another folder with --root, or remove it"
  step "debootstrap: $suite into $bare"
  mkdir -p "$bare"
  debootstrap --variant=minbase "$suite" "$bare" "$mirror" >"$bare.log" 2>&1 ||
    die "debootstrap failed; see $bare.log"
  # This machine's way to the package mirror: sources and apt settings, no package and no file else.
  cp -r /etc/apt/apt.conf.d/. "$bare/etc/apt/apt.conf.d/"
  if [[ -e /etc/apt/sources.list.d/debian.sources ]]; then
    rm -f "$bare/etc/apt/sources.list"
    cp /etc/apt/sources.list.d/debian.sources "$bare/etc/apt/sources.list.d/"
  fi
  cp /etc/resolv.conf "$bare/etc/resolv.conf"
fi
[[ -e $bare/etc/debian_version ]] || die "$bare is no Debian root"

cleanup() { umount -l "$bare/proc" "$bare/sys" "$bare/dev/shm" 2>/dev/null || true; }
trap cleanup EXIT
mount -t proc proc "$bare/proc"
mount -t sysfs -o ro sysfs "$bare/sys"  # PoCL reads the processor's topology there
mkdir -p "$bare/dev/shm"
mount -t tmpfs tmpfs "$bare/dev/shm"

step "packages in the bare root: $(chroot "$bare" dpkg-query -W | wc -l)"
mkdir -p "$bare/srv/corvid"
find "$bare/srv/corvid" -mindepth 1 -maxdepth 1 ! -name build -exec rm -rf {} +
git -C "$root" archive HEAD | tar -x -C "$bare/srv/corvid"
step "tree: $(git -C "$root" rev-parse --short HEAD), $(find "$bare/srv/corvid" -type f | wc -l) files"

status=0
env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin TERM=dumb \
  chroot "$bare" bash -c "cd /srv/corvid && ${command[*]}" || status=$?
step "exit status in the bare root: $status"
exit "$status"
