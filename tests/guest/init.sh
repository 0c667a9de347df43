#!/bin/sh
# First process of the guest. Its root is the host's own, read-only through hostfs; what follows lays a layer of guest
# memory over it, so that tests may write, change interfaces and run services without the host noticing.
# From the kernel command line: GUEST_RUN, the host directory of this run (holds settings.sh and command.sh, takes the
# output), and GUEST_MODULES, the kernel's module tree.
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
. "$GUEST_RUN/settings.sh" # WORK_DIR, TIMEOUT_S, SYSTEMD, NEWER_SYSTEMD, WRITABLE

mount -t proc proc /proc
mount -t sysfs sysfs /sys
insmod "$GUEST_MODULES/kernel/fs/overlayfs/overlay.ko" || echo "guest: no overlay"

# --- the root: host below, guest memory above
mount -t tmpfs -o mode=755 tmpfs /mnt
mkdir /mnt/upper /mnt/work /mnt/root
mount -t overlay -o lowerdir=/,upperdir=/mnt/upper,workdir=/mnt/work overlay /mnt/root || echo "guest: no root"
NEW=/mnt/root
for place in proc sys dev run; do mkdir -p "$NEW/$place"; done
mount --move /proc "$NEW/proc"
mount --move /sys "$NEW/sys"
mount -t devtmpfs devtmpfs "$NEW/dev"
mkdir -p "$NEW/dev/pts" "$NEW/dev/shm"
mount -t devpts -o ptmxmode=666,mode=620,gid=5 devpts "$NEW/dev/pts"
ln -sf pts/ptmx "$NEW/dev/ptmx"
for link in fd:/proc/self/fd stdin:/proc/self/fd/0 stdout:/proc/self/fd/1 stderr:/proc/self/fd/2; do
  ln -sf "${link#*:}" "$NEW/dev/${link%%:*}"
done
mount -t tmpfs -o mode=1777 tmpfs "$NEW/dev/shm"
mount -t tmpfs -o mode=755 tmpfs "$NEW/run"
mkdir -p "$NEW/run/lock" "$NEW/run/guest/written"
# whatever is written to the root lies in the upper layer: tests look here for what a service left behind
mount --bind /mnt/upper "$NEW/run/guest/written"

# --- what reaches the host: this run's directory, and others only on demand
for place in "$GUEST_RUN" $WRITABLE; do
  mkdir -p "$NEW$place"
  mount -t hostfs -o "$place" none "$NEW$place"
done

# --- CAN
release=$(uname -r)
mkdir -p "$NEW/lib/modules/$release"
mount --bind "$GUEST_MODULES" "$NEW/lib/modules/$release"
chroot "$NEW" modprobe -a can can-raw vcan || echo "guest: no CAN modules"
ip link set lo up
ip link add vcan0 type vcan && ip link set vcan0 up || echo "guest: no vcan0"
hostname guest

if [ -n "$SYSTEMD" ]; then
  # another systemd than the host's, unpacked by newer_systemd.sh
  [ -z "$NEWER_SYSTEMD" ] || tar -C "$NEWER_SYSTEMD" -cf - . | tar -C "$NEW" --keep-directory-symlink -xf -
  . "$GUEST_RUN/systemd.sh"
  cd "$NEW"
  exec switch_root "$NEW" /lib/systemd/systemd --unit=guest.target
fi
exec chroot "$NEW" /bin/bash "$GUEST_RUN/command.sh"
