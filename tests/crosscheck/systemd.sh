#!/bin/sh
# A systemd of its own, in namespaces of its own, with the units of deploy/jobs/systemd: for tests/it/jobs.rs.
#
#   unshare --pid --fork --kill-child --mount --cgroup --ipc --mount-proc systemd.sh PROGRAMS REPOSITORY OPTIONS
#
# Nothing of it reaches the machine: whatever a systemd writes to at its start is covered by empty file systems, and no
# unit of the machine is started.
set -eu
programs=$1 repository=$2 options=$3
mount --make-rprivate /
mount -t tmpfs tmpfs /run
mkdir -p /run/programs /run/lock
mount --bind "$programs" /run/programs
cp -r "$repository/deploy/jobs" /run/jobs
for directory in /tmp /var /opt /etc/systemd/system /dev/shm /lib/systemd/system/*.target.wants; do
    mount -t tmpfs tmpfs "$directory"
done
mkdir -p /opt/spaceoctopus/deploy /opt/spaceoctopus/target/release /var/lib /var/tmp /var/log
mv /run/jobs /opt/spaceoctopus/deploy/
mount --move /run/programs /opt/spaceoctopus/target/release
cp /opt/spaceoctopus/deploy/jobs/systemd/*.service /etc/systemd/system/
mkdir "/etc/systemd/system/spaceoctopus-train@.service.d"
printf '[Service]\nEnvironmentFile=\nEnvironment="OPTIONS=%s"\n' "$options" >"/etc/systemd/system/spaceoctopus-train@.service.d/options.conf"
export container=other
exec /lib/systemd/systemd --system --unit=basic.target --log-target=console --log-level=warning
