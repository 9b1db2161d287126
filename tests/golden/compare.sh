#!/usr/bin/env bash
# compare.sh OLD-BINARY NEW-BINARY [DATA]: runs the golden net with both programs, and shows what they say differently.
# Exit code 1 if anything differs. DATA is the folder with the foreign data sets. ROWS='replay-*' runs only these rows.
set -euo pipefail

if [[ $# -lt 2 || $# -gt 3 ]]; then
    printf 'usage: compare.sh OLD-BINARY NEW-BINARY [DATA]\n' >&2
    exit 2
fi
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
root="$(cd "$here/../.." && pwd)"
source "$here/lists.sh"
made="$(mktemp -d)"
trap 'rm -rf "$made"' EXIT

for side in old new; do
    [[ $side == old ]] && binary="$1" || binary="$2"
    printf '%s: ' "$side"
    "$here/golden.sh" "$binary" "$root" "${3:--}" "$made/$side"
done

# A file as lines that a reader can compare: JSON on one line is spread out.
readable() {
    case "$(head -c 1 "$1" | tr -d '\0')" in
        '{' | '[') python3 -m json.tool "$1" 2>/dev/null || cat "$1" ;;
        *) cat "$1" ;;
    esac
}

# The first lines in which a file differs.
show() {
    if ! grep -qI . "$made/old/$1" || ! grep -qI . "$made/new/$1"; then
        printf '    %d and %d bytes\n' "$(stat -c %s "$made/old/$1")" "$(stat -c %s "$made/new/$1")"
        return
    fi
    { diff <(readable "$made/old/$1") <(readable "$made/new/$1") || true; } | { head -20; cat >/dev/null; } | cut -c 1-200 | sed 's/^/    /'
}

count=0
for list in manifest events-manifest help-manifest data-manifest; do
    while read -r what name; do
        count=$((count + 1))
        printf '%s %s\n' "$what" "$name"
        if [[ $what == changed ]]; then
            show "$name"
        fi
    done < <(differing "$made/old/$list.sha256" "$made/new/$list.sha256")
done
printf '%d files differ\n' "$count"
[[ $count -eq 0 ]]
