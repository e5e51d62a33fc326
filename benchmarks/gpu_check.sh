#!/usr/bin/env bash
# Check the GPU backends on a machine with one NVIDIA card, nvcc, and PyTorch for CUDA: in ten minutes, without a network.
#   benchmarks/gpu_check.sh wheels DIR    with a network: download what such a machine lacks (x86-64, Python 3.12, 23 MB)
#   benchmarks/gpu_check.sh [DIR]         in the top folder of a checkout: check; the page is $OUT/page.txt
#   DRY=1 benchmarks/gpu_check.sh         the same on a CPU, with substitutes for gsplat's kernels; times mean nothing
set -euo pipefail
PYTHON=${PYTHON:-python3} OUT=${OUT:-$PWD/gpu_check} DRY=${DRY:-0}
if [ "$DRY" = 1 ]; then marks="not gpu" flag=--dry; else marks=gpu flag=--no-dry; fi
step() { printf '== %s (%ss)\n' "$1" "$SECONDS"; }
left() { echo $((DRY ? 3600 : SECONDS < 560 ? 570 - SECONDS : 10)); }

if [ "${1-}" = wheels ]; then
  exec "$PYTHON" -m pip download -q --no-deps --only-binary=:all: --python-version 3.12 -c constraints.txt -d "$2" \
    --platform={manylinux_2_{5,17,24,27,28},manylinux2014,manylinux1}_x86_64 \
    gsplat gymnasium Farama-Notifications trimesh mapbox_earcut stable-baselines3 tyro docstring_parser typeguard
fi
mkdir -p "$OUT"
export PYTHONPATH=$PWD${1+:$OUT/site}${PYTHONPATH:+:$PYTHONPATH} OMP_WAIT_POLICY=PASSIVE MAX_JOBS=${MAX_JOBS:-16}
if [ -n "${1-}" ]; then
  step "wheels"
  "$PYTHON" -m pip install -q --no-index --no-deps --upgrade --target "$OUT/site" "$1"/*.whl
fi
for room in envs policies evaluation; do  # links, which a copy of the tree may lack
  [ -d "activestructure_gym/$room" ] || ln -sfn "../$room" "activestructure_gym/$room"
done

step "gsplat compiles (about 1.5 minutes on 16 cores) or loads; the CPU kernels compile in the background"
"$PYTHON" -c "from activestructure_gym.compiling.ahead import listed_kernels as all; [one.compile() for one in all()]" &
kernels=$!
((DRY)) || timeout 300 "$PYTHON" -c "from gsplat.cuda._backend import _C; print(_C)" >"$OUT/build.txt" 2>&1 ||
  step "FAILED: $OUT/build.txt"
wait "$kernels" || step "FAILED: the CPU kernels"

step "agreement with the float64 reference"
timeout "$(left)" "$PYTHON" -m pytest -o addopts= -p no:cacheprovider --import-mode=importlib -q -m "$marks" \
  tests/splatting/test_gsplat.py tests/splatting/test_rasterizers.py >"$OUT/tests.txt" 2>&1 || step "FAILED: $OUT/tests.txt"
tail -n 1 "$OUT/tests.txt"

step "times, and an episode at the paper's sizes"
timeout "$(left)" "$PYTHON" -m benchmarks.gpu_check --out "$OUT" --seconds $(($(left) / 2)) "$flag"
step "done: $OUT/page.txt"
