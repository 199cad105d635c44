#!/bin/bash
# One training on one machine of a cluster with Slurm, or on several. It goes on by itself after a time limit, a
# preemption or a crash of a machine, until the run has done its budget.
#
#   sbatch deploy/jobs/slurm/train.sh RUN [OPTIONS OF octopus train]
#   sbatch --nodes=4 deploy/jobs/slurm/train.sh RUN [OPTIONS OF octopus train]
#
# On several machines say how many shards there are, one for each worker: --envs 64 --set env.n_shards=8.
#
# RUN must be where every machine of the partition sees it. Submit it from the root of the repository, or say where that
# is in SPACEOCTOPUS. A sweep is an array: deploy/sweeps/slurm-array.sh.
#
# The first machine trains, the others help with their workers (`octopus join`) on port PORT, 7447 unless it is set.
# With CERTIFICATES, a directory of `octopus certificates` that has all machines of the partition, links are encrypted
# and machines are known by name. Without, they are plain: then nobody else may reach the network of the machines.

#SBATCH --job-name=spaceoctopus
#SBATCH --ntasks-per-node=1
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

others=$((${SLURM_JOB_NUM_NODES:-1} - 1))
helpers=
if [ "$others" -gt 0 ]; then
    place=${SLURMD_NODENAME:?is for a job of Slurm}:${PORT:-7447}
    if [ -n "${CERTIFICATES:-}" ]; then
        endpoint=quic/$place
        secured=(--certificates "$CERTIFICATES")
    else
        endpoint=tcp/$place
        secured=(--insecure)
    fi
    export OCTOPUS_ALWAYS="--listen-workers $endpoint ${secured[*]}"
    # The first machine of the job is the one that runs this file. The others wait until the run is there, and end
    # with it. The training needs none of them.
    srun --nodes="$others" --relative=1 --ntasks="$others" \
        "$OCTOPUS" join "$endpoint" "${secured[@]}" --wait 10m &
    helpers=$!
fi

"$root/deploy/jobs/until-done.sh" "$@" &
pid=$!
trap 'kill -TERM "$pid"' TERM HUP
status=0
wait "$pid" || status=$?
# A signal ends the first wait, not the training.
while kill -0 "$pid" 2>/dev/null; do
    status=0
    wait "$pid" || status=$?
done
if [ -n "$helpers" ]; then
    # Where the run goes on later, they would wait for it; that is another job's.
    kill -TERM "$helpers" 2>/dev/null || true
    wait "$helpers" || true
fi
if [ "$status" = 143 ]; then
    job=${SLURM_JOB_ID:?is for a job of Slurm}
    # Before its time is over it still runs. Once somebody has cancelled it (`scancel`), it is completing.
    case $(scontrol --oneliner show job "$job") in
        *JobState=RUNNING*) ;;
        *) exit "$status" ;;
    esac
    # Whatever is left to do is done when the job is started again; a finished run then ends at once.
    exec scontrol requeue "$job"
fi
exit "$status"
