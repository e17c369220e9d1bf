#!/usr/bin/env bash
# The tests with the oldest dependencies that pyproject.toml allows, in an environment of their own.
#   pipelines/min_versions.sh [VENV] [pytest arguments]     (torch alone is some gigabytes)
# With CONSTRAINTS=/dev/null: with the newest there are. Exit code 3: they cannot be installed.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=${1:-.venv-min}
shift || true
constraints=${CONSTRAINTS:-constraints-min.txt}
[ -x "$venv/bin/python" ] || python3.11 -m venv "$venv" || exit 3
"$venv/bin/pip" install --quiet -c "$constraints" torch || exit 3
"$venv/bin/pip" install --quiet -c "$constraints" -e '.[sim,serve]' pytest pytest-xdist hypothesis || exit 3
OMP_NUM_THREADS=1 "$venv/bin/python" -m pytest -n auto --dist worksteal "$@"
