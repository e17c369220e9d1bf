#!/usr/bin/env bash
# The paper as commands: from meshes to Table I (reconstruction), Figure 3 (grasp success) and the
# trials of section V-C. Killed and started again, it carries on where it stopped.
#   SCALE=tiny|small|full pipelines/paper.sh [WORK]       (WORK defaults to paper-SCALE/)
# tiny: minutes on two cores, to see that every step runs (its numbers mean nothing, and its trials
# take the bundled networks: three steps of training find no plan);
# small: a night on two cores; full: the paper's numbers of views and grasps, for many cores or
# pipelines/Snakefile. JOBS processes (all cores). TEST_MESHES: a folder of other objects to
# test on, such as one made by `rgrasp objects fetch ycb`; by default objects of another seed.
set -euo pipefail
scale=${SCALE:-tiny}
work=$(realpath -m "${1:-paper-$scale}")
TEST_MESHES=${TEST_MESHES:+$(realpath -m "$TEST_MESHES")}
if [ -n "$TEST_MESHES" ] && [ ! -e "$TEST_MESHES" ]; then
    echo "TEST_MESHES=$TEST_MESHES: no such folder" >&2
    exit 2
fi
cd "$(dirname "$0")/.."
jobs=${JOBS:-0}
# shellcheck source=pipelines/scales.sh
source pipelines/scales.sh "$scale"

mkdir -p "$work/done"
# Steps that are done are not looked at again, so they must be of this paper.
asked="SCALE=$scale TEST_MESHES=$TEST_MESHES"
if [ ! -s "$work/done/.asked" ]; then
    echo "$asked" >"$work/done/.asked.new"
    mv "$work/done/.asked.new" "$work/done/.asked"
elif [ "$(cat "$work/done/.asked")" != "$asked" ]; then
    echo "$work: was begun with $(cat "$work/done/.asked"), and now it is $asked; choose another WORK" >&2
    exit 2
fi

# A step that ended well leaves a mark; what has a mark is not begun again. Within a step, the
# commands know by themselves which of their files are finished.
step() {
    local name=$1
    shift
    [ -e "$work/done/$name" ] && return 0
    echo "== $name: $*" >&2
    "$@"
    touch "$work/done/$name"
}

# Training carries on from the state that it left.
resumed() {
    local out=$1
    shift
    if [ -f "$out/train_state.pt" ]; then "$@" --out "$out" --resume; else "$@" --out "$out" --force; fi
}

# --- Meshes ----------------------------------------------------------------------------------
step meshes-train rgrasp objects make --out "$work/meshes/train" --count "$TRAIN_OBJECTS" --seed 0 --jobs "$jobs"
if [ -n "${TEST_MESHES:-}" ]; then
    test_meshes=$TEST_MESHES
else
    test_meshes=$work/meshes/test
    step meshes-test rgrasp objects make --out "$test_meshes" --count "$TEST_OBJECTS" --seed 1000 --jobs "$jobs"
fi

# --- Views and labels (the paper: 200 views a mesh) -----------------------------------------------
step render-train rgrasp render --meshes "$work/meshes/train" --out "$work/views/train" --views "$VIEWS" --seed 0 --jobs "$jobs" --skip-bad
step render-test rgrasp render --meshes "$test_meshes" --out "$work/views/test" --views "$TEST_VIEWS" --seed 100 --jobs "$jobs" --skip-bad
step label rgrasp label-sdf --views "$work/views/train" --meshes "$work/meshes/train" --out "$work/labels/train" --points "$LABELS" --jobs "$jobs" --skip-bad

# --- Reconstruction: Table I -----------------------------------------------------------------
evaluated=()
for model in $MODELS; do
    step "train-sdf-$model" resumed "$work/sdf/$model" rgrasp train-sdf --model "$model" \
        --views "$work/views/train" --labels "$work/labels/train" --pack "$work/sdf/pack" $SDF_LENGTH
    evaluated+=(--checkpoint "$work/sdf/$model")
done
beside=() # The published rows belong beside YCB, not beside generated objects.
[ -z "$TEST_MESHES" ] || beside=(--beside ycb)
step table1 rgrasp eval-sdf "${evaluated[@]}" --views "$work/views/test" --meshes "$test_meshes" \
    --out "$work/table1.json" --count "$TEST_VIEWS" $EVAL_SIZE "${beside[@]}" --jobs "$jobs" --force --skip-bad

# --- Grasps: Figure 3 ------------------------------------------------------------------------
step collect rgrasp collect-grasps --meshes "$work/meshes/train" --out "$work/grasps" --count "$GRASPS" --seed 0 --jobs "$jobs" $COLLECT
variants=(--checkpoint "$work/gs/geometry-fixed")
# Ours reads distances of the first of the reconstructions at the grasp itself.
step train-gs-geometry-fixed resumed "$work/gs/geometry-fixed" rgrasp train-gs \
    --grasps "$work/grasps" --sdf "$work/sdf/${MODELS%% *}" $GS_LENGTH
for encoder in pointsdf voxelcnn; do
    for mode in fixed scratch; do
        step "train-gs-$encoder-$mode" resumed "$work/gs/$encoder-$mode" rgrasp train-gs \
            --grasps "$work/grasps" --encoder "$encoder" --mode "$mode" --sdf "$work/sdf/$encoder" $GS_LENGTH
        variants+=(--checkpoint "$work/gs/$encoder-$mode")
    done
done
step figure3 rgrasp eval-gs "${variants[@]}" --grasps "$work/grasps" --out "$work/figure3.json" --force

# --- Trials: section V-C -----------------------------------------------------------------------
networks=()
[ "$TRIAL_WEIGHTS" = bundled ] || networks=(--checkpoint "$work/sdf/${MODELS%% *}" --grasp-checkpoint "$work/gs/geometry-fixed")
step trials rgrasp trial --meshes "$test_meshes" --out "$work/trials" --seed 0 --jobs "$jobs" "${networks[@]}" $TRIALS
step report rgrasp report "$work/grasps" --out "$work/report.html" --force
echo "Table I: $work/table1.json · Figure 3: $work/figure3.json · trials: $work/trials"
