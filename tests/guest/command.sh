#!/bin/bash
# Runs in the finished guest: the command, its output and exit status into the run directory, then off.
. "$GUEST_RUN/settings.sh"
cut -d' ' -f1 /proc/uptime > "$GUEST_RUN/boot_s"
(
  . "$GUEST_RUN/environment.sh"
  export PATH="$PATH:/usr/sbin:/sbin"
  cd "$WORK_DIR" || exit 125
  exec timeout --kill-after=5 "$TIMEOUT_S" "${COMMAND[@]}"
) < /dev/null > "$GUEST_RUN/stdout" 2> "$GUEST_RUN/stderr"
status=$?
echo $status > "$GUEST_RUN/status"
sync
echo o > /proc/sysrq-trigger
sleep 60
