#!/bin/sh
# Unpacks the systemd of Debian 12's backports (254; the release has 252) into a directory for the guest. The host is
# not changed, and neither are its lists of packages. Then the unit is tested as a `Type=notify-reload`:
#   tests/guest/newer_systemd.sh DIR && HIGHSIDE_GUEST_SYSTEMD=DIR pytest tests/guest -k systemd_suite
set -eu
[ $# = 1 ] || { echo "usage: $0 DIR" >&2; exit 2; }
mkdir -p "$1"
dir=$(cd "$1" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir -p "$work/lists/partial" "$work/cache/archives/partial" "$work/debs"
echo "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] http://deb.debian.org/debian bookworm-backports main" \
  > "$work/sources"
options="-q -o Dir::Etc::sourcelist=$work/sources -o Dir::Etc::sourceparts=/dev/null -o Dir::State::lists=$work/lists"
options="$options -o Dir::Cache=$work/cache -o APT::Sandbox::User=root"
apt-get $options update
cd "$work/debs"
apt-get $options download systemd/bookworm-backports libsystemd0/bookworm-backports libsystemd-shared/bookworm-backports
for package in *.deb; do dpkg -x "$package" "$dir"; done
