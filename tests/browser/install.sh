# Installs what run.sh needs, which sources this. Modules go into a folder that is named by what is pinned and kept between runs; a half
# installed one is never used. Only the browsers may go into the system. What cannot be had ends the run with what to do.

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

# A browser of this computer, else Debian's: the variable that names it, Debian's package. Sets and exports the variable.
install_browser() {
    local variable="$1" package="$2"
    if [[ -n "${!variable:-}" ]]; then
        return
    fi
    if [[ ! -x "/usr/bin/$package" ]]; then
        [[ "$(id -u)" == 0 ]] || fail "there is no /usr/bin/$package. Install it (apt-get install $package), or name one: $variable=/path/to/it"
        install_packages "$package" >"$made/$package.log" 2>&1 ||
            fail "there is no /usr/bin/$package, and apt-get does not install it: $(tail -1 "$made/$package.log")"
    fi
    export "$variable=/usr/bin/$package"
}

# HAProxy and openssl, for the recipe with TLS. Sets and exports HAPROXY.
install_proxy() {
    if [[ -z "${HAPROXY:-}" && ! -x /usr/sbin/haproxy ]] || ! command -v openssl >/dev/null; then
        [[ "$(id -u)" == 0 ]] || fail "there is no haproxy or no openssl. Install them (apt-get install haproxy openssl)"
        install_packages haproxy openssl >"$made/haproxy.log" 2>&1 || fail "apt-get does not install haproxy and openssl: $(tail -1 "$made/haproxy.log")"
    fi
    export HAPROXY="${HAPROXY:-/usr/sbin/haproxy}"
}

# With a font: without one there is no text to measure or to photograph.
install_packages() {
    local apt=(env DEBIAN_FRONTEND=noninteractive apt-get -qq --yes --no-install-recommends)
    # A fresh machine has no lists, an old one has stale ones.
    "${apt[@]}" install "$@" fonts-dejavu-core || { "${apt[@]}" update && "${apt[@]}" install "$@" fonts-dejavu-core; }
}
