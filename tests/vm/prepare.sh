#!/usr/bin/env bash
# Fetches a Debian kernel and makes of it what boot.sh starts, below build/vm; installs nothing. What is there
# and complete is kept: the folder is named by the kernel's version, its mark holds this script's checksum.
#   tests/vm/prepare.sh       224 MB are fetched, 70 MB stay; half a minute to two
# Needs the packages of packages_vm in scripts/setup.sh. Exit 1, with the reason in one line on standard error,
# where it cannot be done.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
vm="$(cd "$here/../.." && pwd)/build/vm"
export PATH="$PATH:/usr/sbin:/sbin"

ready() {
  rm -f "$vm/unavailable"
  exit 0
}
fail() {
  printf '%s\n' "$*" >&2
  exit 1
}

[[ "$(uname -m)" == x86_64 ]] || fail "this machine is not an x86-64 one"
command -v apt-cache >/dev/null || fail "not a Debian system"
for tool in qemu-system-x86_64 busybox modprobe depmod make gcc-12 xz dpkg-deb gzip; do
  command -v "$tool" >/dev/null || fail "$tool is not installed"
done

# The kernel that Debian offers now; if apt knows none, whatever was prepared before.
image="$(apt-cache show linux-image-amd64 2>/dev/null | sed -n 's/^Depends: \(linux-image-[^ ]*\).*/\1/p' | head -n 1)"
kernel="${image#linux-image-}"
mark="$(cat "${BASH_SOURCE[0]}" "$here/initramfs_init.sh" | sha256sum | cut -d ' ' -f 1)"
complete() { [[ -f "$1/complete" && "$(cat "$1/complete")" == "$mark" ]]; }
if [[ -z "$image" ]]; then
  complete "$vm/current" || fail "apt knows no package linux-image-amd64"
  ready
fi
folder="$vm/$kernel"
if complete "$folder"; then
  ln -sfn "$kernel" "$vm/current"
  ready
fi

rm -rf "$folder"
mkdir -p "$folder"
work="$(mktemp -d "$vm/work.XXXXXX")"
log="$vm/prepare.log"
trap 'rm -rf "$work"' EXIT

fetch() {
  local series="${kernel%%.0-*}"
  cd "$work" && apt-get -q -o Acquire::Retries=3 download "$image" "linux-headers-$kernel" \
    "linux-headers-${kernel%-amd64}-common" "linux-kbuild-$series" "linux-source-$series" v4l2loopback-dkms
}

unpack() {
  local series="${kernel%%.0-*}" package
  cd "$work"
  for package in linux-image-*.deb; do dpkg-deb -x "$package" image; done
  for package in linux-headers-*.deb linux-kbuild-*.deb; do dpkg-deb -x "$package" headers; done
  for package in linux-source-*.deb v4l2loopback-dkms_*.deb; do dpkg-deb -x "$package" source; done
  tar -xf "source/usr/src/linux-source-$series.tar.xz" --strip-components=4 \
    "linux-source-$series/drivers/media/test-drivers/vimc"
  mv source/usr/src/v4l2loopback-* v4l2loopback
  echo 'obj-m := v4l2loopback.o' >v4l2loopback/Kbuild
  # The headers' Makefile expects to be installed.
  sed -i "s,/usr/src/,$work/headers/usr/src/,g" "headers/usr/src/linux-headers-$kernel/Makefile"
}

# Debian's kernel has neither vimc nor v4l2loopback.
build_modules() {
  local headers="$work/headers/usr/src/linux-headers-$kernel" extra="$work/image/lib/modules/$kernel/extra"
  make -s -C "$headers" M="$work/vimc" CONFIG_VIDEO_VIMC=m modules
  make -s -C "$headers" M="$work/v4l2loopback" modules
  mkdir -p "$extra"
  cp "$work/vimc/vimc.ko" "$work/v4l2loopback/v4l2loopback.ko" "$extra"
  depmod -b "$work/image" "$kernel"
}

# insmod_order ROOT NAME...: the files to load, each after those that it needs.
insmod_order() {
  local root=$1 name
  shift
  for name in "$@"; do
    modprobe -d "$root" -S "$kernel" --show-depends "$name" | sed -n 's/^insmod \([^ ]*\).*/\1/p'
  done | awk '!seen[$0]++'
}

# Only the modules that a test needs are kept, out of half a gigabyte.
keep_modules() {
  local file
  insmod_order "$work/image" "${boot_modules[@]}" vivid vhci-hcd uvcvideo vimc v4l2loopback >"$work/kept"
  while read -r file; do
    install -D -m 644 "$file" "$folder/modules/${file#"$work/image/"}"
  done <"$work/kept"
  cp "$work/image/lib/modules/$kernel/"modules.{order,builtin,builtin.modinfo} "$folder/modules/lib/modules/$kernel/"
  depmod -b "$folder/modules" "$kernel"
}

# The kernel proper lies xz'd in the bzImage; unpacked here, each boot is 3 s shorter.
unpack_kernel() {
  local packed="$work/image/boot/vmlinuz-$kernel" at
  at="$(LC_ALL=C grep -aobP -m 1 '\xFD7zXZ\x00' "$packed" | head -n 1 | cut -d : -f 1)"
  tail -c "+$((at + 1))" "$packed" | xz -dc --single-stream >"$folder/vmlinux" 2>/dev/null || true
  [[ "$(head -c 4 "$folder/vmlinux" | tail -c 3)" == ELF ]]
}

boot_modules=(virtio_pci virtio_mmio 9pnet_virtio 9p overlay)
make_initramfs() {
  local root="$work/initramfs" file
  mkdir -p "$root"/{bin,dev,proc,sys,modules,lower,upper,newroot}
  cp "$(command -v busybox)" "$root/bin/busybox"
  insmod_order "$folder/modules" "${boot_modules[@]}" >"$work/boot"
  while read -r file; do
    cp "$file" "$root/modules/"
    basename "$file" >>"$root/modules/order"
  done <"$work/boot"
  install -m 755 "$here/initramfs_init.sh" "$root/init"
  (cd "$root" && find . -print0 | busybox cpio -0 -o -H newc | gzip -1) >"$folder/initramfs.gz"
}

# Each step by itself: a function called in a condition would not stop at its first failure.
for part in fetch unpack build_modules keep_modules unpack_kernel make_initramfs; do
  status=0
  (
    set -euo pipefail
    "$part"
  ) >"$log" 2>&1 & wait "$!" || status=$?
  if [[ $status -ne 0 ]]; then
    if complete "$vm/current"; then
      rm -rf "$folder"
      echo "$kernel cannot be had (step $part); $(readlink "$vm/current") is kept"
      ready
    fi
    tail -n 20 "$log" >&2
    fail "the guest could not be prepared (step $part of tests/vm/prepare.sh; all of it is in $log)"
  fi
done
echo "$mark" >"$folder/complete"
ln -sfn "$kernel" "$vm/current"
find "$vm" -mindepth 1 -maxdepth 1 -type d -name '*-amd64' ! -name "$kernel" -exec rm -rf {} +
ready
