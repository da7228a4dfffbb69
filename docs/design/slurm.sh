#!/bin/sh
# Features and matches as arrays of Slurm, then the model:
#     sh slurm.sh PHOTOS WORKSPACE [SHARDS] [OPTIONS OF SBATCH...]
# Photos, workspace and program are on a folder that all nodes share. Slurm starts a task again
# whose node is lost. When one has failed, the jobs behind it never begin: cancel them, and give
# this script again as a whole. Shards that have tiles and stages that are complete do nothing then.
set -eu
photos=$1 workspace=$2 shards=${3:-16}
shift 2
[ $# -eq 0 ] || shift
before=""
threads='--threads ${SLURM_CPUS_PER_TASK:-1}'
shard="--shard \$SLURM_ARRAY_TASK_ID/$shards"

# Submits a command that begins when the job before it has ended well.
submit() {
    command=$1
    shift
    before=$(sbatch --parsable --requeue ${before:+--dependency=afterok:$before} "$@" \
        --wrap "$command $threads")
    echo "$before: $command"
}

submit "tiepoint features '$photos' -o '$workspace' $shard" "--array=1-$shards" "$@"
submit "tiepoint features '$photos' -o '$workspace'" "$@"
submit "tiepoint match '$workspace' $shard" "--array=1-$shards" "$@"
submit "tiepoint match '$workspace'" "$@"
submit "tiepoint map '$workspace'" "$@"
