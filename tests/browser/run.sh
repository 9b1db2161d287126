#!/usr/bin/env bash
# A browser on the page of the real program, over loopback. Needs cargo, Node 20 or newer with npm, Chromium, Firefox, HAProxy and openssl or apt, and once the
# network: install.sh gets the rest. Everything that it makes lies under target/browser; arguments go to node (a test's file, --test-name-pattern=..);
# --install-only stops before the tests.
#
# POSEBRIDGE names another program to test than the one that is built here, BROWSER_UI_DIR=$PWD/web the folder of the page instead of the one that is
# in the program, CHROMIUM and FIREFOX other browsers. BROWSER_SCREENSHOTS=1 writes the
# pictures of the README anew, BROWSER_SOAK_S=600 with BROWSER_TIMEOUT_MS=900000 lets the
# test of memory look at ten minutes.
set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
here="$root/tests/browser"
target="${CARGO_TARGET_DIR:-$root/target}"
made="$target/browser"
mkdir -p "$made"

source "$here/install.sh"

install_node_modules
install_browser CHROMIUM chromium
install_browser FIREFOX firefox-esr
install_proxy
if [[ "${1:-}" == --install-only ]]; then
    exit
fi

if [[ -z "${POSEBRIDGE:-}" ]]; then
    (cd "$root" && cargo build --quiet --locked --package posebridge)
    export POSEBRIDGE="$target/debug/posebridge"
fi

# Node looks for modules beside the files that name them: tests and page run from a copy beside the installed ones.
rm -rf "$modules/"{support,web,*.mjs}
cp -r "$here/support" "$here"/*.mjs "$root/web" "$modules"
export BROWSER_ROOT="$root"
cd "$modules"
if [[ $# -eq 0 ]]; then
    set -- ./*.test.mjs
fi
# A test that hangs shall fail, not stop the rest.
exec node --test --test-concurrency=1 --test-timeout="${BROWSER_TIMEOUT_MS:-120000}" --test-reporter=spec "$@"
