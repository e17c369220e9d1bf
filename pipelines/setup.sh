#!/usr/bin/env bash
# Everything between a fresh clone and a working `rgrasp`: system libraries, a virtual environment
# in .venv, the package with its pinned dependencies. Runs again only where something changed.
#   pipelines/setup.sh [user|developer]    developer (default): also what tests, lint and docs need
set -euo pipefail
cd "$(dirname "$0")/.."

case ${1:-developer} in
user) extras=sim,view,serve ;;
developer) extras=sim,view,serve,dev,docs ;;
*)
    echo "usage: pipelines/setup.sh [user|developer]" >&2
    exit 2
    ;;
esac
stamp=.venv/.set-up # the extras that are installed, and of which state of these files
state=$(cat pyproject.toml constraints.txt pipelines/setup.sh | sha256sum | cut -d' ' -f1)
installed=$(cat "$stamp" 2>/dev/null || true)
[ "$installed" = "$state $extras" ] && exit 0
[ "$installed" = "$state sim,view,serve,dev,docs" ] && exit 0

# --- System libraries: Open3D links against them and says only that it cannot be imported. -------
missing=()
# Read once: `ldconfig | grep -q` ends in a broken pipe, and so in "missing", where the list is long.
libraries=$(ldconfig -p 2>/dev/null || /sbin/ldconfig -p 2>/dev/null || true)
has_library() { grep -q "$1" <<<"$libraries"; }
has_library 'libusb-1\.0\.so\.0' || missing+=(libusb-1.0-0)
has_library 'libGL\.so\.1' || missing+=(libgl1)
has_library 'libgomp\.so\.1' || missing+=(libgomp1)
if [ "$(uname -s)" = Linux ] && [ ${#missing[@]} -gt 0 ]; then
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        echo "setup: installing ${missing[*]}" >&2
        apt-get update -qq >/dev/null && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "${missing[@]}" >/dev/null
    else
        echo "setup: system libraries are missing. Type this, then make again:" >&2
        echo "    sudo apt-get update && sudo apt-get install -y ${missing[*]}" >&2
        exit 1
    fi
fi

# --- Python: 3.11 first, because PyBullet's wheels end there. ------------
python=""
for candidate in ${PYTHON:-} python3.11 python3.12 python3.13 python3; do
    if "$candidate" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
        python=$candidate
        break
    fi
done
if [ -z "$python" ]; then
    echo "setup: no Python 3.11 or newer with venv was found. Type this, then make again:" >&2
    echo "    sudo apt-get update && sudo apt-get install -y python3.11 python3.11-venv" >&2
    exit 1
fi
case "$("$python" -c 'import sys; print(sys.version_info[1])')" in
    11) ;;
    *) echo "setup: $("$python" --version) has no PyBullet wheel; the simulator will be left out" >&2 ;;
esac

# A venv that was interrupted has no pip yet.
.venv/bin/python -m pip --version >/dev/null 2>&1 || "$python" -m venv --clear .venv
echo "setup: installing rgrasp and its dependencies into .venv (a few minutes the first time)" >&2
install() { .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt "$@"; }
# torch first and alone: with it in place no other package asks for another build of it.
install torch
install -e ".[$extras]"
# pip would compile one module after another. Where PYTHONDONTWRITEBYTECODE is set, as in many
# containers, modules that are not compiled now would be compiled again by every command.
packages=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
.venv/bin/python -m compileall -q -j 0 -x 'site-packages/.*/tests?/' "$packages" pointsdf_cli >/dev/null || true # templates fail
echo "$state $extras" >"$stamp"
