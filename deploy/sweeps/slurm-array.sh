#!/bin/sh
# A sweep on a cluster with Slurm: one task of a job array a trial.
#
#   octopus sweep deploy/sweeps/initial-noise.toml --dry-run    # how many trials there are
#   sbatch --array=1-6 deploy/sweeps/slurm-array.sh deploy/sweeps/initial-noise.toml
#   octopus sweep deploy/sweeps/initial-noise.toml              # afterwards: table and page
#
# All tasks see one directory, sweeps/NAME below the working directory. A task that is stopped, also at its time limit, has a
# checkpoint; submit the array again, and it goes on. With [halving] submit it once for each rung and once for the end.

#SBATCH --cpus-per-task=2
#SBATCH --time=01:00:00
#SBATCH --output=sweep-%A-%a.log
# A minute before the time is over, so that the trial ends in order. The batch shell becomes octopus.
#SBATCH --signal=B:TERM@60

set -eu
exec octopus sweep "$1" --trial "${SLURM_ARRAY_TASK_ID:?is for a task of a job array}"
