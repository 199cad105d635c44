#!/bin/sh
# Trains in a run directory, or goes on with what is there: what a supervisor starts, again and again.
#
#   deploy/jobs/train-or-resume.sh RUN [OPTIONS OF octopus train]
#
# The first time it is `octopus train OPTIONS --run-dir RUN`, from then on `octopus resume RUN`. A finished run ends at
# once with status 0. SIGTERM ends in a checkpoint. The exit status is that of octopus: 2, 3 and 5 want a person,
# the others another try. Options that both commands take stand in OCTOPUS_ALWAYS, as in "--listen 127.0.0.1:8270".

set -eu
run=${1:?usage: train-or-resume.sh RUN [OPTIONS OF octopus train]}
shift
octopus=${OCTOPUS:-octopus}

# Words, not one argument.
# shellcheck disable=SC2086
set -- "$@" ${OCTOPUS_ALWAYS:-}
# The configuration is what a run begins with.
if [ -e "$run/config.toml" ]; then
    # shellcheck disable=SC2086
    exec "$octopus" resume "$run" ${OCTOPUS_ALWAYS:-}
fi
exec "$octopus" train "$@" --run-dir "$run"
