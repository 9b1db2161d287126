# Installs what run.sh needs, which sources this. Modules go into a folder that is named by what is pinned and kept between runs; a half
# installed one is never used. Only Chromium may go into the system. What cannot be had ends the run with what to do.

fail() {
    printf 'browser tests: %s\n' "$1" >&2
    exit 1
}

# Sets `modules`, the folder with node_modules.
install_node_modules() {
    modules="$made/node-$(cat "$here/package.json" "$here/package-lock.json" | sha256sum | cut -c1-16)"
    [[ -f "$modules/complete" ]] && return
    rm -rf "$made"/node-*
    mkdir -p "$modules"
    cp "$here/package.json" "$here/package-lock.json" "$modules"
    npm ci --prefix "$modules" --silent --no-audit --no-fund --ignore-scripts >"$modules/log" 2>&1 ||
        fail "cannot install tests/browser. It takes Node 20 or newer with npm and, the first time, its registry. $(tail -1 "$modules/log")"
    touch "$modules/complete"
}

# Chromium of this computer, else Debian's. Sets and exports CHROMIUM.
install_chromium() {
    if [[ -n "${CHROMIUM:-}" ]]; then
        return
    fi
    if [[ ! -x /usr/bin/chromium ]]; then
        [[ "$(id -u)" == 0 ]] || fail "there is no /usr/bin/chromium. Install it (apt-get install chromium), or name one: CHROMIUM=/path/to/chromium"
        install_package_of_chromium >"$made/chromium.log" 2>&1 ||
            fail "there is no /usr/bin/chromium, and apt-get does not install it: $(tail -1 "$made/chromium.log")"
    fi
    export CHROMIUM=/usr/bin/chromium
}

install_package_of_chromium() {
    local apt=(env DEBIAN_FRONTEND=noninteractive apt-get -qq --yes --no-install-recommends)
    # A fresh machine has no lists, an old one has stale ones. Without a font there is no text to measure or to photograph.
    "${apt[@]}" install chromium fonts-dejavu-core || { "${apt[@]}" update && "${apt[@]}" install chromium fonts-dejavu-core; }
}
