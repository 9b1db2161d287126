#!/usr/bin/env bash
# Foreign programs against the real program, over loopback. Needs cargo, gcc, Python 3 with venv, Node with npm, tshark or apt, and once
# the network: install.sh gets the rest. Everything that it makes lies under target/peers; arguments go to Python's unittest (a test's name,
# -f, -k PATTERN; --install-only stops before the tests). POSEBRIDGE names another program to test than the one that is built here.
# PEERS_LONG=1 watches for losses for a minute, else for ten seconds.
set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
here="$root/tests/peers"
target="${CARGO_TARGET_DIR:-$root/target}"
made="$target/peers"
mkdir -p "$made"

source "$here/install.sh"

install_venv venv "$here/requirements.txt" --no-deps
python="$venv/bin/python"
install_dialect
show_dialect_to_pymavlink "$venv"
install_c_library
install_venv examples "$root/examples/python/requirements.txt"
examples="$venv"
install_node_modules
install_tshark
if [[ "${1:-}" == --install-only ]]; then
    exit
fi

if [[ -z "${POSEBRIDGE:-}" ]]; then
    (cd "$root" && cargo build --quiet --locked --package posebridge --features fleet)
    export POSEBRIDGE="$target/debug/posebridge"
fi

export PEERS_DIALECT="$dialect" PEERS_EXAMPLES="$examples/bin" PEERS_NODE="$node" PEERS_TSHARK="$tshark" PEERS_C_LIBRARY="$c_library"
export PYTHONPATH="$dialect:$here"
export PYTHONDONTWRITEBYTECODE=1
export MAVLINK20=1
cd "$here"
if [[ $# -eq 0 ]]; then
    exec "$python" -m unittest discover --start-directory "$here" --verbose
fi
exec "$python" -m unittest --verbose "$@"
