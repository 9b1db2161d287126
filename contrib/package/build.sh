#!/usr/bin/env bash
# Builds the wheel and the .deb, then tries both: try.sh. Needs cargo, Python 3 with venv, Debian's binutils, dpkg-dev and xz-utils, and
# once the network, for maturin and cargo-deb. The two files are in target/package/out.
set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
here="$root/contrib/package"
# Absolute, because maturin and cargo-deb run in folders of their own.
export CARGO_TARGET_DIR="$(realpath --canonicalize-missing "${CARGO_TARGET_DIR:-$root/target}")"
made="$CARGO_TARGET_DIR/package"
out="$made/out"

maturin_version=1.16.0
cargo_deb_version=3.8.0

fail() {
    printf 'package: %s\n' "$1" >&2
    exit 1
}

# Sets `maturin`. A half installed one is never used.
install_maturin() {
    local venv="$made/maturin-$maturin_version"
    maturin="$venv/bin/maturin"
    [[ -f "$venv/complete" ]] && return
    rm -rf "$made"/maturin-*
    python3 -m venv "$venv" && "$venv/bin/pip" install --quiet --disable-pip-version-check "maturin==$maturin_version" ||
        fail "cannot install maturin. It takes Python 3 with the venv module and the Python package index."
    touch "$venv/complete"
}

# Sets `cargo_deb`. Without its default features it calls xz, and needs no library for it.
install_cargo_deb() {
    local folder="$made/cargo-deb-$cargo_deb_version"
    cargo_deb="$folder/bin/cargo-deb"
    [[ -x "$cargo_deb" ]] && return
    cargo install --quiet --locked --version "$cargo_deb_version" --no-default-features --root "$folder" --target-dir "$made/tools" cargo-deb
    rm -rf "$made/tools"
}

# What the program prints for a system that it is installed on: manual pages, completions, its messages for other programs, and the unit
# with the path of the package.
write_assets() {
    local assets="$CARGO_TARGET_DIR/dist/package" shell tool
    rm -rf "$assets"
    mkdir -p "$assets/completions"
    "$program" man --out "$assets/man"
    gzip -9 --no-name "$assets/man"/*
    for shell in bash zsh fish; do
        "$program" completions "$shell" >"$assets/completions/$shell"
    done
    for tool in python wireshark c xml; do
        "$program" dialect --for "$tool" --out "$assets/dialect"
    done
    sed 's|^ExecStart=/usr/local/bin/|ExecStart=/usr/bin/|' "$root/contrib/systemd/posebridge.service" >"$assets/posebridge.service"
}

mkdir -p "$made"
install_maturin
install_cargo_deb

rm -rf "$out"
# This builds the program, in the profile `dist`: optimised across crates. The .deb takes the same file.
(cd "$here" && "$maturin" build --out "$out")
program="$CARGO_TARGET_DIR/dist/posebridge"
[[ "$(readelf --sections "$program")" != *.symtab* ]] || fail "$program is not stripped"
write_assets
# It warns that contrib/package has no unit: it looks there for others than that of write_assets.
(cd "$root" && "$cargo_deb" --no-build --no-strip --locked --output "$out/")

"$here/try.sh" "$out"/posebridge-*.whl "$out"/posebridge_*.deb

printf '\n'
ls -l --human-readable "$program" "$out"/*
