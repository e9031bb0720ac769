#!/bin/busybox sh
# shellcheck shell=dash
# The guest's first program: takes the host's root, read-only, under a layer in memory, and hands over to the
# script that boot.sh wrote.
export PATH=/bin
/bin/busybox --install -s /bin
mount -t devtmpfs dev /dev
mount -t proc proc /proc
mount -t sysfs sys /sys
stop() {
  echo "initramfs: $1"
  poweroff -f
}
while read -r module; do insmod "/modules/$module" || stop "$module cannot be loaded"; done </modules/order
options=trans=virtio,version=9p2000.L,msize=512000
mount -t 9p -o "ro,$options,cache=loose" host_root /lower || stop "the host's root cannot be mounted"
mount -t tmpfs -o size=75% tmpfs /upper
mkdir /upper/changes /upper/work
mount -t overlay -o lowerdir=/lower,upperdir=/upper/changes,workdir=/upper/work overlay /newroot ||
  stop "no overlay over the host's root"
for folder in dev proc sys; do
  mkdir -p "/newroot/$folder"
  mount --move "/$folder" "/newroot/$folder"
done
mount -t tmpfs tmpfs /newroot/run
mkdir -p /newroot/run/vm
mount -t 9p -o "rw,$options,cache=none" host_exchange /newroot/run/vm || stop "no exchange folder"
exec switch_root /newroot /bin/bash /run/vm/guest.sh
