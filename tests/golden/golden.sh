#!/usr/bin/env bash
# golden.sh BINARY REPO DATA OUT: runs every row of the golden net, and lists the hashes of all that the program wrote.
#
# The lists are OUT/manifest.sha256, and beside it those of rows whose names begin so: events-manifest.sha256,
# help-manifest.sha256, data-manifest.sha256. DATA is the folder with the foreign data sets; where it is not there
# (or is -), the rows that need it are left out. ROWS, a pattern in the environment, runs only the rows that match.
#
# A row is one command in a folder of its own: its files, its stdout and its exit code count, its stderr does not.
set -euo pipefail

if [[ $# -ne 4 ]]; then
    printf 'usage: golden.sh BINARY REPO DATA OUT\n' >&2
    exit 2
fi
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
binary="$(realpath "$1")" repo="$(realpath "$2")" data="$3"
if [[ -e "$4" && ! -e "$4/.in" && -n "$(ls -A "$4")" ]]; then
    printf '%s is not empty and was not made by golden.sh\n' "$4" >&2
    exit 2
fi
rm -rf "$4"
mkdir -p "$4/.in"
out="$(realpath "$4")"
[[ -d "$data" ]] && data="$(realpath "$data")" || data=""

# What could get into the outputs from outside.
unset POSEBRIDGE_DATA POSEBRIDGE COLUMNS NO_COLOR CLICOLOR_FORCE RUST_LOG
export LC_ALL=C TZ=UTC

# The inputs under names that are the same everywhere, because they stand in the outputs. So does the program's own name.
inputs="$out/.in"
recordings=()
for packed in "$here"/recordings/*.mcap.gz; do
    name="$(basename "$packed" .mcap.gz)"
    recordings+=("$name")
    gunzip -c "$packed" >"$inputs/$name.mcap"
done
install -m 600 "$here/recordings/signed.key" "$inputs/signed.key"
cp "$repo/tests/data/tlog/mixed.tlog" "$inputs/mixed.tlog"
ln "$binary" "$inputs/posebridge" 2>/dev/null || cp "$binary" "$inputs/posebridge"

# row NAME ARGUMENT ..: one command, unless ROWS leaves it out.
row() {
    local name="$1" code=0
    shift
    # shellcheck disable=SC2053 # ROWS is a pattern.
    [[ $name == ${ROWS:-*} ]] || return 0
    mkdir "$out/$name"
    (cd "$out/$name" && timeout 300 ../.in/posebridge "$@" >stdout 2>../.in/stderr </dev/null) || code=$?
    printf '%s\n' "$code" >"$out/$name/exit"
    if [[ $code -ne 0 ]]; then
        failed+=("$name ($code: $(head -c 200 "$inputs/stderr" | head -1))")
    fi
    # How long it took on this machine is no output, nor is today's date.
    sed -i -E 's/"(wall_seconds|cpu_seconds|times_real_time|seconds)": ?[-0-9.eE+]+/"\1":0/g' "$out/$name/stdout"
    if [[ -e "$out/$name/learned.toml" ]]; then
        sed -i '/^date = /d' "$out/$name/learned.toml"
    fi
}
failed=()

for name in "${recordings[@]}"; do
    file="../.in/$name.mcap" key=()
    [[ $name == signed ]] && key=(--key ../.in/signed.key)
    row "replay-$name" replay "$file" "${key[@]}" --json --figure figure.svg --save-calibration learned.toml
    row "smooth-$name" replay "$file" "${key[@]}" --smooth --json
    # The log holds what the station sent, byte by byte: estimates, requests for the time, heartbeats.
    row "export-$name" export "$file" "${key[@]}" --format csv,tum,tlog --out .
    row "inspect-$name" inspect "$file" --json
    row "report-$name" report "$file" "${key[@]}" --json --out .
    row "tables-$name" replay "$file" "${key[@]}"
    row "events-$name" replay "$file" "${key[@]}" --events events.txt
done
for filter in odometry ekf5 indirect dynamic range-kf; do
    row "filter-$filter" replay ../.in/square.mcap --filter "$filter" --json
done
for filter in odometry ekf5 indirect; do
    row "filter-$filter-kidnap" replay ../.in/kidnap.mcap --filter "$filter" --json
    row "filter-$filter-redundant" replay ../.in/redundant.mcap --filter "$filter" --json
done
for filter in dynamic range-kf; do
    row "filter-$filter-ev3" replay ../.in/ev3.mcap --filter "$filter" --json
done
row optiodom replay "$repo/config/recordings/optiodom.toml" --data "$repo/tests/data" --json
row optiodom-fixes replay "$repo/config/recordings/optiodom-fixes.toml" --data "$repo/tests/data" --json
row tlog-inspect inspect ../.in/mixed.tlog --json
row tlog-import import ../.in/mixed.tlog --out imported.mcap
row lab-accuracy lab accuracy --scenario camera-10hz --runs 4 --seed 1 --json
row lab-nxt-square lab nxt-square --runs 4 --seed 1 --json
row lab-thermometer lab thermometer --runs 10 --seed 1 --json
row lab-wall lab wall --runs 4 --seed 1 --json
row lab-indirect lab indirect --runs 4 --robots 8 --seed 1 --json
row lab-links lab links --runs 2 --seed 1 --json
row umbmark calibrate umbmark --sim --runs 2 --seed 1 --json
row identify-rest identify rest --sim camera-10hz --seed 1 --json
row identify-step identify step --sim thermometer --json
row identify-step-recording identify step --recording ../.in/ev3.mcap --json
row identify-rest-recording identify rest --recording ../.in/square.mcap --json
row identify-delay-recording identify delay --recording ../.in/square.mcap --json
row calibrate-path calibrate path ../.in/square.mcap --json
row calibrate-rest calibrate rest ../.in/square.mcap --json
row tune tune --sim camera-10hz --runs 2 --seed 1 --json
row tune-recording tune --recording ../.in/square.mcap --json
# What people read: check.sh looks whether every line fits a terminal of 80 columns.
for name in "${recordings[@]}"; do
    file="../.in/$name.mcap" key=()
    [[ $name == signed ]] && key=(--key ../.in/signed.key)
    row "text-replay-$name" replay "$file" "${key[@]}" --verbose --fix-wiring
    row "text-compare-$name" replay "$file" "${key[@]}" --filter odometry --filter ekf5-camera-corrected --filter pose
    row "text-report-$name" report "$file" "${key[@]}" --out .
    row "text-inspect-$name" inspect "$file"
done
row text-replay-optiodom replay "$repo/config/recordings/optiodom-fixes.toml" --data "$repo/tests/data"
row text-report-optiodom report "$repo/config/recordings/optiodom-fixes.toml" --data "$repo/tests/data" --run circular/250620202104/run-01 --out .
row text-inspect-tlog inspect ../.in/mixed.tlog
row text-lab-accuracy lab accuracy --scenario camera-10hz --runs 4 --seed 1
row text-lab-nxt-square lab nxt-square --runs 4 --seed 1
row text-lab-thermometer lab thermometer --runs 10 --seed 1
row text-lab-wall lab wall --runs 4 --seed 1
row text-lab-indirect lab indirect --runs 4 --robots 8 --seed 1
row text-lab-links lab links --runs 2 --seed 1
row text-umbmark calibrate umbmark --sim --runs 2 --seed 1
row text-calibrate-path calibrate path ../.in/square.mcap
row text-calibrate-rest calibrate rest ../.in/square.mcap
row text-identify-rest identify rest --sim camera-10hz --seed 1
row text-identify-step identify step --sim thermometer
row text-identify-step-recording identify step --recording ../.in/ev3.mcap
row text-identify-delay identify delay --recording ../.in/square.mcap
row text-tune tune --sim camera-10hz --runs 2 --seed 1

row config-print config print
row config-keys config schema
# The keys without what is said of them.
[[ -d "$out/config-keys" ]] && sed -i -E '/^ *"description": /d' "$out/config-keys/stdout"

row help-schema config schema
row help-params config params
row help-pages man --out .
row help-complete-bash completions bash
row help --help
for command in run sim play relay replay export import report inspect lab calibrate identify tune key doctor init config completions man; do
    row "help-$command" "$command" --help
done

if [[ -n "$data" ]]; then
    for set in lego-nxt-camera husky-outdoor mrclam6 plaza1 uwb-labyrinth neato-gyro-camera roomba-imu ds18b20-step nxt-ultrasonic \
        rtd-step tof-wall; do
        row "data-$set" replay "$repo/config/recordings/$set.toml" --data "$data" --json
    done
fi

# list FILE PATTERN [NOT]: the hashes of the rows that match the one and not the other.
cd "$out"
list() {
    find . -mindepth 2 -type f ! -path './.in/*' | sed 's|^\./||' | sort |
        { grep -E "^($2)" || true; } | { grep -Ev "^(${3:-/})" || true; } | xargs -r -d '\n' sha256sum >"$1"
}
apart='events-|help(-|/)|data-'
list manifest.sha256 . "$apart"
list events-manifest.sha256 events-
list help-manifest.sha256 'help(-|/)'
list data-manifest.sha256 data-
printf '%s files' "$(cat ./*manifest.sha256 | wc -l)"
if [[ ${#failed[@]} -gt 0 ]]; then
    printf '; ended with an error: %s' "${failed[@]}"
fi
printf '\n'
