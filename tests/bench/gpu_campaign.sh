#!/usr/bin/env bash
# What a first GPU is asked, in parts of nine minutes at most, about 25 minutes in all: logits and gradients beside
# those of the CPU; ms and MiB of every slot, forward and backward, float32 and bfloat16; torch.compile; own operations
# beside plain ones; RayIoU; a drive; training.
#
#   bash tests/bench/gpu_campaign.sh out                          # writes out/campaign.json and out/campaign.md
#   PRESETS=smoke DEVICE=cpu REPEATS=1 PARTS="slots rayiou" bash tests/bench/gpu_campaign.sh out
#
# The same command goes on after an end: parts that are finished are not measured again. A part that fails or takes too
# long leaves its log in out/logs, and the others run; the exit code is then 1.
set -u
out=${1:?give the folder for the results}
python=${PYTHON:-.venv/bin/python}
failed=0
mkdir -p "$out/logs"
run() {
    local log="$out/logs/$1-$2.log"
    echo "$1, preset=$2"
    timeout 540 "$python" tests/bench/gpu_campaign.py "$1" "$out" --preset "$2" \
        --device "${DEVICE:-cuda}" --repeats "${REPEATS:-10}" >"$log" 2>&1 || { failed=1; echo "  failed: $log"; tail -n 3 "$log"; }
}
for preset in ${PRESETS:-small paper}; do
    for part in ${PARTS:-agreement slots operations rayiou streaming compiled}; do run "$part" "$preset"; done
done
if [ -z "${PARTS:-}" ]; then run training "${TRAIN:-small}"; fi
exit $failed
