#!/usr/bin/env bash
# Installs a wheel into an empty virtual environment and a .deb into an empty folder, and tries both programs: try.sh FILE.whl FILE.deb
# Needs Python 3.11 with venv, and dpkg-deb.
set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
wheel="$(realpath "$1")"
deb="$(realpath "$2")"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT

fail() {
    printf 'package: %s\n' "$1" >&2
    exit 1
}

# A title, the program, the descriptor of the recording that comes with it, and the folder with its files. The program sees no Rust.
try_program() {
    local home="$folder/home of $1"
    printf '\n== %s\n' "$1"
    shift
    mkdir "$home"
    (cd "$home" && env -i HOME="$home" PATH=/usr/bin:/bin "$python" "$root/contrib/package/try_program.py" "$root/Cargo.toml" "$@")
}

python3 -m venv "$folder/venv"
python="$folder/venv/bin/python"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-index "$wheel"
try_program wheel "$folder/venv/bin/posebridge" "$root/config/recordings/optiodom.toml" "$root/tests/data"

dpkg-deb -x "$deb" "$folder/root"
share="$folder/root/usr/share"
try_program .deb "$folder/root/usr/bin/posebridge" "$share/posebridge/optiodom.toml" "$share/posebridge"

printf '\n== files of the .deb\n'
cmp "$folder/venv/bin/posebridge" "$folder/root/usr/bin/posebridge"
cmp "$root/contrib/udev/70-posebridge.rules" "$folder/root/usr/lib/udev/rules.d/70-posebridge.rules"
for file in bash-completion/completions/posebridge zsh/vendor-completions/_posebridge fish/vendor_completions.d/posebridge.fish; do
    [[ -s "$share/$file" ]] || fail "there is no /usr/share/$file"
done
cmp "$root/protocol/definitions/posebridge.xml" "$share/posebridge/dialect/posebridge.xml"
for file in posebridge_mavlink.py posebridge_mavlink.lua posebridge_mavlink.h; do
    [[ -s "$share/posebridge/dialect/$file" ]] || fail "there is no /usr/share/posebridge/dialect/$file"
done
gunzip --test "$share/man/man1/posebridge.1.gz" "$share/man/man1/posebridge-run.1.gz"
if command -v man >/dev/null; then
    man --local-file "$share/man/man1/posebridge-run.1.gz" >"$folder/page"
    grep --quiet 'posebridge run' "$folder/page" || fail "man does not show posebridge-run(1)"
fi
started="$(sed -n 's/^ExecStart=\([^ ]*\) .*/\1/p' "$folder/root/usr/lib/systemd/system/posebridge.service")"
[[ -n "$started" && -x "$folder/root$started" ]] || fail "the unit starts ${started:-nothing}, which is not in the .deb"
dpkg-deb --field "$deb" Package Version Architecture Depends Installed-Size
