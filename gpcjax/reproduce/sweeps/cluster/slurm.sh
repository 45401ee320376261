#!/bin/sh
# One share of a sweep in each task of a SLURM array. From the folder in which runs/ is to be, on a shared disk:
#
#     sbatch --array=1-8 sweeps/cluster/slurm.sh sweeps/table5_4_i.toml --out runs/table
#     gpcjax merge runs/table                 when all of them have ended
#
# What stands behind the script goes to `gpcjax sweep`. A task that is requeued, or sent again with its number alone
# (sbatch --array=3 --export=ALL,SHARDS=8 ...), goes on where it was. SHARDS is the number of shares: that of the array's
# tasks where it is not given. GPCJAX is the command (gpcjax).
#
# B: below sends the signal to this script, which is gpcjax by then; without it SLURM tells steps of srun alone.
#SBATCH --job-name=gpcjax
#SBATCH --cpus-per-task=4
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --signal=B:TERM@60
#SBATCH --output=slurm-%A-%a.log

: "${SLURM_ARRAY_TASK_ID:?this is for the tasks of an array: sbatch --array=1-8 ...}"
exec ${GPCJAX:-gpcjax} sweep "$@" \
	--shard="$SLURM_ARRAY_TASK_ID/${SHARDS:-${SLURM_ARRAY_TASK_COUNT:?}}" \
	--jobs="${SLURM_CPUS_PER_TASK:-1}"
