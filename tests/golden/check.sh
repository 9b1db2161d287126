#!/usr/bin/env bash
# check.sh BINARY [--renew]: runs the golden net without foreign data sets, and compares it with the lists in this folder.
# Exit code 1 if an output differs. Help texts change often: where they differ, that is only said. --renew writes the lists anew.
set -euo pipefail

usage() {
    printf 'usage: check.sh BINARY [--renew]\n' >&2
    exit 2
}

here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
source "$here/lists.sh"
binary="" renew=false
for argument in "$@"; do
    case "$argument" in
        --renew) renew=true ;;
        -*) usage ;;
        *) [[ -z $binary ]] && binary="$argument" || usage ;;
    esac
done
[[ -n $binary ]] || usage
made="$(mktemp -d)"
trap 'rm -rf "$made"' EXIT

# All rows, whatever the environment says: the lists are complete.
env -u ROWS "$here/golden.sh" "$binary" "$here/../.." - "$made/out"
# A schema and a script are for programs.
printf "%s\0" "$made/out"/{text,help}*/stdout | grep -zv -e help-schema -e help-complete | xargs -0 python3 "$here/line_widths.py"
lists=(manifest events-manifest help-manifest)
if $renew; then
    for list in "${lists[@]}"; do
        cp "$made/out/$list.sha256" "$here/$list.sha256"
    done
    exit 0
fi
count=0
for list in "${lists[@]}"; do
    found="$(differing "$here/$list.sha256" "$made/out/$list.sha256")"
    if [[ -z $found ]]; then
        continue
    elif [[ $list == help-manifest ]]; then
        printf 'help texts are new, which is no error: %s\n' "$(cut -d ' ' -f 2 <<<"$found" | cut -d / -f 1 | sort -u | paste -s -d ' ')"
    else
        printf '%s\n' "$found"
        count=$((count + $(wc -l <<<"$found")))
    fi
done
if [[ $count -gt 0 ]]; then
    printf '%d files are not as they were; tests/golden/compare.sh shows how, beside the program of an older commit\n' "$count" >&2
    exit 1
fi
