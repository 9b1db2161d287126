# Installs foreign programs for run.sh, which sources this. Each goes into a folder of its own that is named by what is pinned and kept
# between runs; a half installed one is never used. Only tshark may go into the system, see there. What cannot be had ends the run with
# what to do.

fail() {
    printf 'peer tests: %s\n' "$1" >&2
    exit 1
}

# The first digits of the checksum over files.
fingerprint() {
    cat "$@" | sha256sum | cut -c1-16
}

# A virtual environment: name, requirements, further arguments for pip. Sets `venv`.
install_venv() {
    local name="$1" requirements="$2"
    shift 2
    venv="$made/$name-$(fingerprint "$requirements")"
    [[ -f "$venv/complete" ]] && return
    rm -rf "$made/$name"-*
    if ! python3 -m venv "$venv" || ! "$venv/bin/pip" install --quiet --disable-pip-version-check "$@" -r "$requirements"; then
        rm -rf "$venv"
        fail "cannot install ${requirements#"$root/"}. It takes Python 3.11 or newer with the venv module, and the Python package index the first time."
    fi
    touch "$venv/complete"
}

# The definition of the standard messages that our code is generated from: it comes with the `mavlink` crate.
standard_definitions() {
    (cd "$root" && cargo metadata --locked --format-version 1) | "$python" -c '
import json, pathlib, sys
crate = next(package for package in json.load(sys.stdin)["packages"] if package["name"] == "mavlink")
print(pathlib.Path(crate["manifest_path"]).parent / "mavlink/message_definitions/v1.0")'
}

# Our messages and the standard ones as foreign programs understand them, in Python and, for Wireshark, in Lua. Sets `dialect`.
install_dialect() {
    local definition="$root/protocol/definitions/posebridge.xml" standard
    standard="$(standard_definitions)" || fail "cargo does not tell where the definitions of the standard messages are"
    dialect="$made/dialect-$(fingerprint "$definition" "$standard"/{common,standard,minimal}.xml "$here/install.sh" "$here/requirements.txt")"
    [[ -f "$dialect/complete" ]] && return
    rm -rf "$made"/dialect-*
    mkdir -p "$dialect"
    cp "$standard"/{common,standard,minimal}.xml "$definition" "$dialect"
    printf '<mavlink><include>common.xml</include><include>posebridge.xml</include><messages/></mavlink>\n' >"$dialect/posebridge_all.xml"
    "$python" - "$dialect" >"$dialect/log" 2>&1 <<'PYTHON' || fail "mavgen does not take our definition: $(tail -1 "$dialect/log")"
import sys
from pymavlink.generator import mavgen

folder = sys.argv[1]
for module, language, xml in (
    ("posebridge_dialect", "Python3", "posebridge"),
    ("posebridge_all", "Python3", "posebridge_all"),
    ("posebridge_all", "WLua", "posebridge_all"),
):
    options = mavgen.Opts(f"{folder}/{module}", wire_protocol="2.0", language=language, validate=False)
    mavgen.mavgen(options, [f"{folder}/{xml}.xml"]) or sys.exit(f"{module} in {language}")
PYTHON
    touch "$dialect/complete"
}

# The stock C library as mavgen makes it, with the standard messages alone. Sets `c_library`.
install_c_library() {
    local standard
    standard="$(standard_definitions)" || fail "cargo does not tell where the definitions of the standard messages are"
    c_library="$made/c-library-$(fingerprint "$standard"/{common,standard,minimal}.xml "$here/install.sh" "$here/requirements.txt")"
    [[ -f "$c_library/complete" ]] && return
    rm -rf "$made"/c-library-*
    mkdir -p "$c_library"
    "$python" - "$standard/common.xml" "$c_library" >"$c_library/log" 2>&1 <<'PYTHON' || fail "mavgen makes no C library: $(tail -1 "$c_library/log")"
import sys
from pymavlink.generator import mavgen

options = mavgen.Opts(sys.argv[2], wire_protocol="2.0", language="C", validate=False)
mavgen.mavgen(options, [sys.argv[1]]) or sys.exit("common in C")
PYTHON
    touch "$c_library/complete"
}

# Programs of pymavlink and MAVProxy look for a dialect among their own.
show_dialect_to_pymavlink() {
    local theirs
    theirs="$(echo "$1"/lib/python3*/site-packages/pymavlink/dialects/v20)"
    cmp --quiet "$dialect/posebridge_all.py" "$theirs/posebridge_all.py" || cp "$dialect/posebridge_all.py" "$theirs"
}

# Sets `node`, the folder with the modules.
install_node_modules() {
    node="$made/node-$(fingerprint "$here/node/package-lock.json")"
    [[ -f "$node/complete" ]] && return
    rm -rf "$made"/node-*
    mkdir -p "$node"
    cp "$here/node/package.json" "$here/node/package-lock.json" "$node"
    npm ci --prefix "$node" --silent --no-audit --no-fund --ignore-scripts >"$node/log" 2>&1 ||
        fail "cannot install tests/peers/node. It takes Node 18 or newer with npm and, the first time, its registry. $(tail -1 "$node/log")"
    touch "$node/complete"
}

# Wireshark's program for terminals: the one of this computer, else Debian's. Root gets it installed, because tshark takes no settings
# from elsewhere when root runs it and would leave the dissector out; for others it is unpacked into a folder. Sets `tshark`.
install_tshark() {
    if tshark="$(command -v tshark)"; then
        return
    fi
    local unpacked="$made/tshark"
    if [[ "$(id -u)" == 0 ]]; then
        install_package_of_tshark >"$made/tshark.log" 2>&1 || fail "there is no tshark, and apt-get does not install it: $(tail -1 "$made/tshark.log")"
        tshark="$(command -v tshark)"
        return
    fi
    if [[ ! -f "$unpacked/complete" ]]; then
        rm -rf "$unpacked"
        mkdir -p "$unpacked"
        unpack_tshark "$unpacked" >"$unpacked/log" 2>&1 ||
            fail "there is no tshark. Install Wireshark's, or let this run on Debian with apt-get and dpkg-deb. $(tail -1 "$unpacked/log")"
        touch "$unpacked/complete"
    fi
    tshark="$unpacked/tshark"
}

install_package_of_tshark() {
    local apt=(env DEBIAN_FRONTEND=noninteractive apt-get -qq --yes --no-install-recommends)
    # A fresh machine has no lists, an old one has stale ones.
    "${apt[@]}" install tshark || { "${apt[@]}" update && "${apt[@]}" install tshark; }
}

# Debian's tshark and the libraries that this computer lacks, with a script that finds them.
unpack_tshark() {
    local into="$1" apt=(apt-get -qq -o Debug::NoLocking=1) names deb
    mkdir -p "$into/deb" "$into/lists/partial" "$into/cache/archives/partial"
    if ! names="$(missing_packages)" || ! (cd "$into/deb" && "${apt[@]}" download $names); then
        # A fresh machine has no lists, an old one has stale ones: read them into a folder of our own.
        apt+=(-o "Dir::State::lists=$into/lists" -o "Dir::Cache=$into/cache" -o APT::Sandbox::User=)
        "${apt[@]}" update || return 1
        names="$(missing_packages)" || return 1
        (cd "$into/deb" && "${apt[@]}" download $names) || return 1
    fi
    for deb in "$into"/deb/*.deb; do
        dpkg-deb -x "$deb" "$into/root" || return 1
    done
    # Debian links this to /etc.
    cp --remove-destination "$into/root/etc/wireshark/init.lua" "$into/root/usr/share/wireshark/init.lua" || return 1
    cat >"$into/tshark" <<'SCRIPT'
#!/bin/sh
root="$(dirname "$0")/root"
export LD_LIBRARY_PATH="$(echo "$root"/usr/lib/*-linux-gnu):$(echo "$root"/lib/*-linux-gnu)"
export WIRESHARK_DATA_DIR="$root/usr/share/wireshark"
exec "$root/usr/bin/tshark" "$@"
SCRIPT
    chmod +x "$into/tshark"
    rm -rf "$into/deb" "$into/lists" "$into/cache"
    "$into/tshark" --version
}

# What apt would install for tshark, as NAME=VERSION; uses the caller's `apt`.
missing_packages() {
    local found
    found="$("${apt[@]}" --print-uris --yes --no-install-recommends install tshark)" || return 1
    # 'URL' NAME_VERSION_ARCHITECTURE.deb SIZE CHECKSUM
    awk 'NF >= 3 { split($2, part, "_"); gsub("%3a", ":", part[2]); print part[1] "=" part[2] }' <<<"$found"
}
