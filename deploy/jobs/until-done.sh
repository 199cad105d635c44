#!/bin/sh
# As train-or-resume.sh, for supervisors that take status 0 for "done": who is asked to stop before the run has done its
# budget ends with status 143, after the checkpoint.
#
#   deploy/jobs/until-done.sh RUN [OPTIONS OF octopus train]

set -eu
asked=no
pid=
trap 'asked=yes; [ -z "$pid" ] || kill -TERM "$pid"' TERM HUP
# Ctrl-C goes to all who belong to the terminal: once more would be a second request.
trap 'asked=yes' INT
"$(dirname "$0")/train-or-resume.sh" "$@" &
pid=$!
# A signal that came before there was anybody to pass it on to.
[ "$asked" = no ] || kill -TERM "$pid"
status=0
wait "$pid" || status=$?
# A signal ends the first wait, not the training.
while kill -0 "$pid" 2>/dev/null; do
    status=0
    wait "$pid" || status=$?
done
# It may have been done at that moment: then the next start ends at once.
if [ "$asked" = yes ] && [ "$status" = 0 ]; then
    exit 143
fi
exit "$status"
