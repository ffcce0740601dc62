#!/bin/bash
# Frames of one run on many machines of a Slurm cluster: `sbatch examples/slurm_array.sh`.
#
# Every task of the array runs the same command but for its --frame-range, into one folder that all
# machines see. The task that finishes the last frame writes preview, video and record. A task that
# is killed or runs out of time loses at most the frame that it was drawing: submit the same script
# again, with all tasks or with any of them, until `"complete": true` stands in
# wet/provenance.json. With --resume a task also draws what an earlier one left undone.

#SBATCH --job-name=rainsim
#SBATCH --array=0-7            # eight tasks, each with an eighth of the frames
#SBATCH --cpus-per-task=8      # threads of each task
#SBATCH --mem=4G
#SBATCH --time=01:00:00
#SBATCH --requeue

set -eu

FRAMES=240
TASKS=${SLURM_ARRAY_TASK_COUNT:-1}
TASK=$((${SLURM_ARRAY_TASK_ID:-0} - ${SLURM_ARRAY_TASK_MIN:-0}))
FIRST=$((FRAMES * TASK / TASKS))
END=$((FRAMES * (TASK + 1) / TASKS))  # not included

# Machine code is compiled once for each kind of processor: keep it where all tasks see it.
export NUMBA_CACHE_DIR=${NUMBA_CACHE_DIR:-$HOME/.cache/rainsim-kernels}

rainsim run --scene garden/ --preset moderate --orbit --frames "$FRAMES" \
    --frame-range "$FIRST:$END" --threads "${SLURM_CPUS_PER_TASK:-1}" --resume --out wet
