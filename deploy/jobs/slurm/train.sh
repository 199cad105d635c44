#!/bin/bash
# One training on one machine of a cluster with Slurm. It goes on by itself after a time limit, a preemption or a crash of
# the machine, until the run has done its budget.
#
#   sbatch deploy/jobs/slurm/train.sh RUN [OPTIONS OF octopus train]
#
# RUN must be where every machine of the partition sees it. Submit it from the root of the repository, or say where that
# is in SPACEOCTOPUS. A sweep is an array: deploy/sweeps/slurm-array.sh.

#SBATCH --job-name=spaceoctopus
#SBATCH --cpus-per-task=2
#SBATCH --mem=4G
#SBATCH --time=01:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=spaceoctopus-%j.log
# Two minutes before the time is over, so that there is a checkpoint of the last iteration.
#SBATCH --signal=B:TERM@120

set -eu
: "${1:?usage: sbatch deploy/jobs/slurm/train.sh RUN [OPTIONS OF octopus train]}"
# Slurm runs a copy of this file, from the directory in which it was submitted.
root=${SPACEOCTOPUS:-$PWD}
export OCTOPUS=${OCTOPUS:-$root/target/release/octopus}

asked=no
"$root/deploy/jobs/train-or-resume.sh" "$@" &
pid=$!
trap 'asked=yes; kill -TERM "$pid"' TERM
status=0
wait "$pid" || status=$?
# A signal ends the first wait, not the training.
while kill -0 "$pid" 2>/dev/null; do
    status=0
    wait "$pid" || status=$?
done
if [ "$asked" = yes ] && [ "$status" = 0 ]; then
    # Whatever is left to do is done when the job is started again; a finished run then ends at once.
    exec scontrol requeue "${SLURM_JOB_ID:?is for a job of Slurm}"
fi
exit "$status"
