# Read by init.sh before it hands over to systemd: units of the guest's own in /run, and the host's out of the way.
units=$NEW/run/systemd/system
mkdir -p "$units"
cat > "$units/guest.target" <<UNIT
[Unit]
Description=The command of this guest
Requires=basic.target
After=basic.target
Wants=guest-command.service dbus.socket
AllowIsolate=yes
UNIT
cat > "$units/guest-command.service" <<UNIT
[Unit]
After=basic.target dbus.socket
[Service]
Environment=GUEST_RUN=$GUEST_RUN
ExecStart=/bin/bash $GUEST_RUN/command.sh
StandardOutput=null
StandardError=journal
UNIT
# tmpfiles would empty /tmp, below which the run directory is mounted; the rest would touch the host's clock, disks
# and packages or wait for devices that are not here
for unit in systemd-tmpfiles-setup.service systemd-tmpfiles-clean.timer systemd-timesyncd.service \
  systemd-remount-fs.service systemd-random-seed.service systemd-update-utmp.service systemd-journal-flush.service \
  systemd-udevd.service systemd-udev-trigger.service systemd-pcrphase-sysinit.service networking.service \
  apt-daily.timer apt-daily-upgrade.timer dpkg-db-backup.timer e2scrub_all.timer fstrim.timer mosquitto.service; do
  ln -sf /dev/null "$units/$unit"
done
: > "$NEW/etc/fstab"
[ -s "$NEW/etc/machine-id" ] || echo 68696768736964652074657374206775 > "$NEW/etc/machine-id"
rm -rf "$NEW/var/log/journal"
# marks by which systemd would take itself to be in a container
rm -f "$NEW/.dockerenv" "$NEW/run/.containerenv"
unset container
