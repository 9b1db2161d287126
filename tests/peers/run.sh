#!/usr/bin/env bash
# Foreign programs against the real program, over loopback. Needs cargo, Python 3 with venv, and once the package index.
# Everything that it makes lies under target/peers; arguments go to Python's unittest (a test's name, -f, -k PATTERN).
set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
here="$root/tests/peers"
target="${CARGO_TARGET_DIR:-$root/target}"
made="$target/peers"
mkdir -p "$made"

# A virtual environment for these very requirements; half an environment is never used.
wanted="$(sha256sum "$here/requirements.txt" | cut -c1-16)"
venv="$made/venv-$wanted"
if [[ ! -f "$venv/complete" ]]; then
    rm -rf "$venv"
    if ! python3 -m venv "$venv" || ! "$venv/bin/pip" install --quiet --disable-pip-version-check -r "$here/requirements.txt"; then
        rm -rf "$venv"
        printf 'peer tests: cannot install %s. They need Python 3 with the venv module, and the Python package index the first time.\n' \
            "tests/peers/requirements.txt" >&2
        exit 1
    fi
    touch "$venv/complete"
fi

# Our own messages as pymavlink understands them, from the definition that our code is generated from.
definition="$root/protocol/definitions/posebridge.xml"
if [[ ! "$made/posebridge_dialect.py" -nt "$definition" ]]; then
    "$venv/bin/python" - "$definition" "$made/posebridge_dialect" <<'PYTHON' >/dev/null
import sys
from pymavlink.generator import mavgen

options = mavgen.Opts(sys.argv[2], wire_protocol="2.0", language="Python3", validate=False)
mavgen.mavgen(options, [sys.argv[1]])
PYTHON
fi

(cd "$root" && cargo build --quiet --locked --package posebridge)

export POSEBRIDGE="$target/debug/posebridge"
export PYTHONPATH="$made:$here"
export PYTHONDONTWRITEBYTECODE=1
export MAVLINK20=1
cd "$here"
if [[ $# -eq 0 ]]; then
    exec "$venv/bin/python" -m unittest discover --start-directory "$here" --verbose
fi
exec "$venv/bin/python" -m unittest --verbose "$@"
