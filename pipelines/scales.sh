# How large the steps of pipelines/paper.sh and pipelines/Snakefile are, by scale: tiny, small, full.
# Sourced by the one, read by the other: only NAME="value" lines within a case.
case ${1:?tiny, small or full} in
tiny)
    TRAIN_OBJECTS="10"
    TEST_OBJECTS="3"
    VIEWS="6"
    TEST_VIEWS="1"
    LABELS="2000"
    MODELS="pointsdf voxelcnn"
    SDF_LENGTH="--steps 3 --batch-size 4 --queries 32 --held-out 0.2 --threads 1"
    EVAL_SIZE="--resolution 32 --samples 1000"
    GRASPS="20"
    COLLECT="--no-pictures"
    GS_LENGTH="--epochs 2 --validation 0.5"
    TRIALS="--yaws 1 --cameras high --pictures 0"
    TRIAL_WEIGHTS="bundled"
    ;;
small)
    TRAIN_OBJECTS="1000"
    TEST_OBJECTS="40"
    VIEWS="40"
    TEST_VIEWS="5"
    LABELS="16000"
    MODELS="pointsdf-ray pointsdf voxelcnn"
    SDF_LENGTH="--minutes 90"
    EVAL_SIZE="--resolution 128"
    GRASPS="9111"
    COLLECT=""
    GS_LENGTH=""
    TRIALS="--yaws 3 --cameras high,low"
    TRIAL_WEIGHTS="trained"
    ;;
full)
    TRAIN_OBJECTS="4400"
    TEST_OBJECTS="80"
    VIEWS="200"
    TEST_VIEWS="10"
    LABELS="50000"
    MODELS="pointsdf-ray pointsdf voxelcnn"
    SDF_LENGTH="--steps 400000"
    EVAL_SIZE="--resolution 128"
    GRASPS="100000"
    COLLECT=""
    GS_LENGTH=""
    TRIALS="--yaws 3 --cameras high,low"
    TRIAL_WEIGHTS="trained"
    ;;
*)
    echo "no scale $1: tiny, small, full" >&2
    return 2
    ;;
esac
