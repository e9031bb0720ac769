#!/usr/bin/env bash
# Runs a command in a guest that has this machine's own root (read-only, changes stay in its memory) and drivers
# of cameras that this machine does not have. It is emulated: 3 times slower in integers, 20 to 80 in floats.
#   tests/vm/boot.sh [-t SECONDS] [-u] [-M "MODULE OPTION=VALUE..."]... -- COMMAND [ARGUMENT]...
#     -t  time limit [s]; 300 if not given
#     -u  udev runs before the modules are loaded (libcamera lists only what it has seen)
#     -M  a kernel module, loaded in the order given
# Exit status: the command's own; 77 nothing was prepared (skipped); 124 time limit; 125 the guest died;
# 126 a module or udev could not be started.
set -uo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
vm="$(cd "$here/../.." && pwd)/build/vm"

usage() {
  sed -n '2,/^set /{s/^# \{0,1\}//;/^set /d;p}' "${BASH_SOURCE[0]}" >&2
  exit 2
}

limit_s=300 udev=0 modules=()
while getopts t:uM: option; do
  case $option in
    t) limit_s=$OPTARG ;;
    u) udev=1 ;;
    M) modules+=("$OPTARG") ;;
    *) usage ;;
  esac
done
shift $((OPTIND - 1))
[[ $# -gt 0 ]] || usage
if [[ -s "$vm/unavailable" || ! -f "$vm/current/complete" ]]; then
  reason="run tests/vm/prepare.sh, as ./test.sh does"
  [[ ! -s "$vm/unavailable" ]] || reason="$(cat "$vm/unavailable")"
  echo "skipped: no guest: $reason"
  exit 77
fi

exchange="$(mktemp -d "$vm/run.XXXXXX")"
trap 'rm -rf "$exchange"' EXIT

# write_guest_script COMMAND...: what the guest's init executes.
write_guest_script() {
  local module
  cat <<'GUEST'
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/tmp LC_ALL=C.UTF-8 CORVID_VM=1 GTEST_COLOR=no
finish() {
  echo "$1" >/run/vm/status.part
  mv /run/vm/status.part /run/vm/status
  /bin/busybox poweroff -f
  sleep 60
}
mkdir -p /dev/shm /dev/pts
mount -t tmpfs tmpfs /dev/shm
mount -t devpts devpts /dev/pts
for link in fd: stdin:/0 stdout:/1 stderr:/2; do ln -sfn "/proc/self/fd${link#*:}" "/dev/${link%%:*}"; done
/bin/busybox ip link set lo up
GUEST
  printf 'export CORVID_VM_MODULES=%q\n' "$vm/current/modules"
  [[ $udev -eq 0 ]] || echo '/lib/systemd/systemd-udevd --daemon --resolve-names=never || finish 126'
  # shellcheck disable=SC2016  # the guest's shell expands it
  for module in "${modules[@]}"; do printf 'modprobe -d "$CORVID_VM_MODULES" %s || finish 126\n' "$module"; done
  [[ $udev -eq 0 ]] || echo 'udevadm settle --timeout=60'
  printf 'cd %q || finish 126\n' "$PWD"
  printf '%q ' "$@"
  printf '\nfinish $?\n'
}
write_guest_script "$@" >"$exchange/guest.sh"

# Always emulated: a /dev/kvm that opens need not work (nested without hardware support, it hangs).
shared=security_model=none,multidevs=remap
timeout -k 5 "$limit_s" qemu-system-x86_64 -M q35 -accel tcg,thread=multi,tb-size=512 -cpu max -smp 2 -m 1024 \
  -nodefaults -no-user-config -display none -no-reboot -nic none \
  -kernel "$vm/current/vmlinux" -initrd "$vm/current/initramfs.gz" \
  -append "console=ttyS0 quiet panic=-1 mitigations=off nokaslr audit=0 random.trust_cpu=on" \
  -fsdev "local,id=root,path=/,readonly=on,$shared" -device virtio-9p-pci,fsdev=root,mount_tag=host_root \
  -fsdev "local,id=exchange,path=$exchange,$shared" \
  -device virtio-9p-pci,fsdev=exchange,mount_tag=host_exchange \
  -serial stdio </dev/null | tr -d '\r'
status=${PIPESTATUS[0]}
if [[ -f "$exchange/status" ]]; then exit "$(cat "$exchange/status")"; fi
if [[ $status -eq 124 || $status -eq 137 ]]; then
  echo "the guest was stopped after its limit of $limit_s s" >&2
  exit 124
fi
echo "the guest died without an answer (qemu's status: $status)" >&2
exit 125
