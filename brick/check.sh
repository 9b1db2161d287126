#!/usr/bin/env bash
# The brick SDK as compilers and interpreters of robots see it: sizes on an ATmega328P, the Arduino example, the NXC program, MicroPython, and
# the filters on an ATmega328P, a Cortex-M4F, an NXT and under MicroPython. Beside it the stock MAVLink library on a simulated Uno, as a robot of the
# real program: POSEBRIDGE names one, else cargo builds it.
# What `cargo test -p posebridge-brick` checks needs gcc and Python only; this needs tools that it installs itself, without
# root, into target/brick. A tool that cannot be had ends it with 1 and the reason. Run it from anywhere.
set -euo pipefail

brick="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
root="$(dirname "$brick")"
made="${CARGO_TARGET_DIR:-$root/target}/brick"
mkdir -p "$made"

# Bars on an ATmega328P, an empty program subtracted, in bytes.
transmit_flash=1024 transmit_ram=64
receive_flash=1536 receive_ram=160

# Debian 12 has these; exact, so that the sizes are comparable. Each with the SHA-256 of its package.
packages="
binutils-avr=2.26.20160125+Atmel3.6.2-4 cbda4048ad79ddc82239afcbf0ed00f1a961deb2d4523aabc2e7ec00eb8cde83
gcc-avr=1:5.4.0+Atmel3.6.2-3 1d0723749c4cbd55eb2478795a581dd29783150e3340a72c4aa7606d96109fbd
avr-libc=1:2.0.0+Atmel3.6.2-3 a7adb563082d291c49fe5f4a483fca18d27f30627c2c8a520c5e23578d0fa5af
arduino-core-avr=1.8.7+dfsg-1~deb12u1 357869fa1f5a122ea06f470b9a88d2e5d27dd52afb0de0578ecd1b72d6b5c8c4
nbc=1.2.1.r4+dfsg-11+b1 50ae47332b2a29eb9d3bf9ddfe164921d22ce9cbeaf53b0ecf0fde58a81dccb3
libusb-0.1-4=2:0.1.12-32 ecc251e8af96904290669233988a91e195670bb432396c408e01489c9efff993
libsimavr2=1.6+dfsg-3 583a3a741b499f2c1d1dd5229c471ea1f086774c47bd1f2b67317a30a37a6e82
libsimavr-dev=1.6+dfsg-3 e458c46b9d54309424a1ccea1f02369805f5c50d7b38f74606cff8c678127f7b
libelf1=0.188-2.1 619add379c606b3ac6c1a175853b918e6939598a83d8ebadf3bdfd50d10b3c8c
binutils-arm-none-eabi=2.40-2+18+b1 c8f9da2a434366bfe5a66a8267cb3b1df028f1d95278715050c222b43e1c221c
gcc-arm-none-eabi=15:12.2.rel1-1 2bbd4f4145e9a3669f58ddab6a3190b768949f07cc444d23e98743d905f83e16
libnewlib-dev=3.3.0-1.3+deb12u1 ab5e6e80d66a6f2f8b9b22b9297154a676a5434ac82e48b88e8164548bc72115
libnewlib-arm-none-eabi=3.3.0-1.3+deb12u1 c80278e8332940eaf9738910258bb85b21c30aacf246a5e363fee230d3605e84
"
# Of ARM's compiler and libraries only what a Cortex-M4F needs: the whole would be a gigabyte.
arm_parts=('*/bin/*gcc' '*/12.2.1/cc1' '*/12.2.1/collect2' '*/12.2.1/include/*' '*/include-fixed/*' '*/v7e-m+fp/hard/*')
micropython="@micropython/micropython-webassembly-pyscript@1.27.0"

fail() {
    printf 'brick SDK: %s\n' "$1" >&2
    exit 1
}

# Fetches and unpacks the packages into a folder, by apt but without root and without touching what apt keeps.
unpack_packages() {
    local into="$1" names apt=(apt-get -qq)
    names="$(awk 'NF { print $1 }' <<<"$packages")"
    command -v apt-get >/dev/null && command -v dpkg-deb >/dev/null || return 1
    mkdir -p "$into/deb" "$into/apt/lists/partial" "$into/apt/cache/archives/partial"
    if ! (cd "$into/deb" && "${apt[@]}" download $names 2>/dev/null); then
        # A fresh machine has no lists: read them into a folder of our own.
        apt+=(-o "Dir::State::lists=$into/apt/lists" -o "Dir::Cache=$into/apt/cache" -o APT::Sandbox::User=)
        "${apt[@]}" update >"$made/apt.log" 2>&1 || return 1
        (cd "$into/deb" && "${apt[@]}" download $names) >>"$made/apt.log" 2>&1 || return 1
    fi
    local sums
    sums="$(cd "$into/deb" && sha256sum -- *.deb | cut -d' ' -f1)"
    awk 'NF { print $2 }' <<<"$packages" | while read -r sum; do
        grep -qx "$sum" <<<"$sums" || fail "a package is not the one that is pinned: SHA-256 $sum is missing in $into/deb"
    done || return 1
    local deb
    mkdir -p "$into/root"
    for deb in "$into"/deb/*.deb; do
        case "$deb" in
            */gcc-arm-* | */libnewlib-arm-*)
                # tar complains of a part that is not in this package.
                dpkg-deb --fsys-tarfile "$deb" | tar -x -C "$into/root" --wildcards "${arm_parts[@]}" 2>/dev/null || true
                ;;
            *) dpkg-deb -x "$deb" "$into/root" || return 1 ;;
        esac
    done
    [[ -x "$into/root/usr/bin/arm-none-eabi-gcc" && -f "$into/root/usr/lib/arm-none-eabi/newlib/thumb/v7e-m+fp/hard/libm.a" ]] || return 1
    rm -rf "$into/deb" "$into/apt"
}

# Compilers for AVR, ARM and NXT below $tools; a half unpacked folder is never used.
install_compilers() {
    tools="$made/tools-$(sha256sum <<<"$packages" | cut -c1-16)"
    if [[ ! -f "$tools/complete" ]]; then
        rm -rf "$tools"
        unpack_packages "$tools" || fail "cannot install gcc-avr, avr-libc, arduino-core-avr, nbc, simavr and gcc-arm-none-eabi as check.sh pins them.
They are packages of Debian 12 for amd64; it takes apt-get, dpkg-deb and, the first time, Debian's archive. Nothing needs root.
$(tail -3 "$made/apt.log" 2>/dev/null)"
        touch "$tools/complete"
    fi
    arduino="$tools/root/usr/share/arduino/hardware/arduino/avr"
    libraries="$tools/root/usr/lib/x86_64-linux-gnu:$tools/root/lib/x86_64-linux-gnu"
    export PATH="$tools/root/usr/bin:$PATH"
}

install_python() {
    python="$made/venv-$(cat "$brick/vectors/requirements.txt" "$brick/check/requirements.txt" | sha256sum | cut -c1-16)"
    if [[ ! -f "$python/complete" ]]; then
        rm -rf "$python"
        python3 -m venv "$python" &&
            "$python/bin/pip" install --quiet --disable-pip-version-check -r "$brick/vectors/requirements.txt" &&
            "$python/bin/pip" install --quiet --disable-pip-version-check -r "$brick/check/requirements.txt" ||
            fail "cannot install the requirements.txt of brick/vectors and brick/check: it takes Python 3 with venv and, the first time, the package index"
        touch "$python/complete"
    fi
}

install_micropython() {
    node_modules="$made/micropython-1.27.0/node_modules"
    if [[ ! -f "$node_modules/complete" ]]; then
        mkdir -p "$made/micropython-1.27.0"
        npm install --silent --no-audit --no-fund --prefix "$made/micropython-1.27.0" "$micropython" ||
            fail "cannot install $micropython: it takes Node with npm and, the first time, its registry"
        touch "$node_modules/complete"
    fi
}

vectors_are_those_of_make_py() {
    "$python/bin/python" "$brick/vectors/make.py" >"$made/vectors.txt" 2>"$made/make.log" ||
        fail "brick/vectors/make.py failed: $(tail -1 "$made/make.log")"
    cmp --quiet "$made/vectors.txt" "$brick/vectors/vectors.txt" ||
        fail "brick/vectors/vectors.txt is not what make.py makes: diff it with $made/vectors.txt"
    printf 'vectors: made again, the same\n'
}

# Compiles a program for the ATmega328P; the output, then arguments of the compiler.
avr_program() {
    local output="$1"
    shift
    avr-gcc -mmcu=atmega328p -Os -std=c99 -Wall -Wextra -Werror -pedantic -ffunction-sections -fdata-sections -Wl,--gc-sections \
        -I "$brick/c" "$@" -o "$output"
}

# Flash and static RAM of a program: text and data, data and bss.
sizes() {
    avr-size "$1" | awk 'END { print $1 + $2, $2 + $3 }'
}

# Prints the size of robot.c with some switches, without the empty program and the bytes that stand for its hardware; holds it to
# bars unless they are 0.
size_of() {
    local title="$1" most_flash="$2" most_ram="$3" flash ram empty_flash empty_ram hardware
    shift 3
    avr_program "$made/empty.elf" "$brick/check/size/empty.c"
    avr_program "$made/robot.elf" "$@" "$brick/check/size/robot.c" "$brick/check/size/registers.c"
    read -r empty_flash empty_ram <<<"$(sizes "$made/empty.elf")"
    read -r flash ram <<<"$(sizes "$made/robot.elf")"
    hardware="$(avr-nm -S "$made/robot.elf" | awk '$4 == "uart" || $4 == "sensors" { print $2 }' |
        while read -r hex; do echo $((16#$hex)); done | awk '{ sum += $1 } END { print sum + 0 }')"
    flash=$((flash - empty_flash)) ram=$((ram - empty_ram - hardware))
    if ((most_flash == 0)); then
        printf 'size: %-48s %5d B flash              %4d B static RAM\n' "$title" "$flash" "$ram"
    else
        printf 'size: %-48s %5d B flash (bar %4d)   %4d B static RAM (bar %3d)\n' "$title" "$flash" "$most_flash" "$ram" "$most_ram"
        ((flash <= most_flash && ram <= most_ram)) || fail "$title is above its bar"
    fi
}

check_sizes() {
    printf 'size: %s, ATmega328P, -Os, without an empty program\n' "$(avr-gcc --version | head -1)"
    size_of "all messages out" "$transmit_flash" "$transmit_ram"
    size_of "the same, estimate and TIMESYNC in" "$receive_flash" "$receive_ram" -DPB_RECEIVE
    size_of "all messages out, with the sum of a gyro" 0 0 -DWITH_GYRO_SUM
    size_of "the same, estimate and TIMESYNC in" 0 0 -DPB_RECEIVE -DWITH_GYRO_SUM
}

# Arduino's own core with its Wire library, as the board manager would build them for an Uno.
build_arduino_core() {
    local core="$arduino/cores/arduino" wire="$arduino/libraries/Wire/src" source
    objects="$made/arduino"
    rm -rf "$objects"
    mkdir -p "$objects"
    # This compiler is older than the core expects: its <float.h> keeps DECIMAL_DIG from C++.
    flags=(-mmcu=atmega328p -DDECIMAL_DIG=__DECIMAL_DIG__ -DF_CPU=16000000L -DARDUINO=10807 -DARDUINO_AVR_UNO -DARDUINO_ARCH_AVR -Os -ffunction-sections -fdata-sections
        -I "$core" -I "$arduino/variants/standard" -I "$wire" -I "$wire/utility")
    for source in "$core"/*.c "$wire"/utility/*.c; do
        avr-gcc -w -std=gnu11 "${flags[@]}" -c "$source" -o "$objects/$(basename "$source").o"
    done
    for source in "$core"/*.cpp "$wire"/*.cpp; do
        avr-g++ -w -std=gnu++11 -fno-exceptions -fno-threadsafe-statics "${flags[@]}" -c "$source" -o "$objects/$(basename "$source").o"
    done
}

check_arduino() {
    local library="$made/library" sketch
    rm -rf "$library"
    mkdir -p "$library"
    python3 "$brick/arduino/pack.py" "$library" >/dev/null
    python3 -m zipfile -e "$library/PosebridgeBrick.zip" "$library"
    build_arduino_core
    sketch="$library/PosebridgeBrick/examples/TwoWheels/TwoWheels.ino"
    avr-g++ -std=gnu++11 -fno-exceptions -fno-threadsafe-statics -Wall -Wextra -Werror "${flags[@]}" \
        -I "$library/PosebridgeBrick/src" -include Arduino.h -x c++ -c "$sketch" -o "$objects/sketch.o"
    avr-gcc -mmcu=atmega328p -Os -Wl,--gc-sections "$objects"/*.o -lm -o "$made/arduino.elf"
    read -r flash ram <<<"$(sizes "$made/arduino.elf")"
    printf 'arduino: TwoWheels with Arduino'\''s core and Wire: %d of 32256 B flash, %d of 2048 B RAM\n' "$flash" "$ram"
    ((flash <= 32256 && ram <= 1536)) || fail "the Arduino example does not fit an Uno"
}

# The stock C library, which mavgen makes from common.xml, in a sketch on a simulated Uno, in real time on a pseudo-terminal.
check_stock_mavlink() {
    local library="$made/stock_mavlink" here="$brick/check/stock_mavlink" posebridge="${POSEBRIDGE:-}" native="$tools/root/usr/lib/x86_64-linux-gnu" common
    common="$(echo "$python"/lib/python3*/site-packages/pymavlink/dialects/v20/common.xml)"
    rm -rf "$library"
    mkdir -p "$library"
    "$python/bin/python" -m pymavlink.tools.mavgen --no-validate --lang=C --wire-protocol=2.0 --output="$library/c" "$common" >"$library/mavgen.log" 2>&1 ||
        fail "mavgen makes no C library: $(tail -1 "$library/mavgen.log")"
    avr-g++ -std=gnu++11 -fno-exceptions -fno-threadsafe-statics -Wall -Wextra -Werror "${flags[@]}" \
        -isystem "$library/c" -include Arduino.h -x c++ -c "$here/stock_mavlink.ino" -o "$library/sketch.o"
    rm -f "$objects/sketch.o"
    avr-gcc -mmcu=atmega328p -Os -Wl,--gc-sections "$objects"/*.o "$library/sketch.o" -lm -o "$library/sketch.elf"
    read -r flash ram <<<"$(sizes "$library/sketch.elf")"
    printf 'stock MAVLink: with Arduino'\''s core: %d of 32256 B flash, %d of 2048 B RAM\n' "$flash" "$ram"
    ((flash <= 32256 && ram <= 1700)) || fail "the stock MAVLink library does not fit an Uno"
    avr-objcopy -O binary "$library/sketch.elf" "$library/sketch.bin"
    gcc -O2 -Wall -Wextra -Werror -I "$tools/root/usr/include/simavr" "$here/run_uno.c" "$native/libsimavr.a" "$native/libelf.so.1" \
        "-Wl,-rpath,$native" -o "$library/run_uno"
    if [[ -z "$posebridge" ]]; then
        (cd "$root" && cargo build --quiet --locked --package posebridge)
        posebridge="${CARGO_TARGET_DIR:-$root/target}/debug/posebridge"
    fi
    python3 -B "$here/check.py" "$posebridge" "$library/run_uno" "$library/sketch.bin" "$library/run"
}

# nbc looks for included files where it writes, unless it is told where they are.
check_nxc() {
    LD_LIBRARY_PATH="$libraries" nbc -v=128 -Z2 "-I=$brick/nxc/" "-O=$made/posebridge.rxe" "-L=$made/posebridge.lst" \
        "$brick/nxc/posebridge.nxc" >"$made/nbc.log" 2>&1 || true
    [[ -s "$made/posebridge.rxe" ]] && ! grep -q '^# Error' "$made/nbc.log" || fail "nbc does not compile posebridge.nxc:
$(cat "$made/nbc.log")"
    printf 'nxc: posebridge.nxc compiles for the firmware that LEGO ships, %d B\n' "$(stat -c %s "$made/posebridge.rxe")"
    grep -E '^(heartbeat|wheel_ticks|inertial) ' "$brick/vectors/vectors.txt" >"$made/lines.txt"
    sed 's/ = .*//' "$made/lines.txt" | python3 -B "$brick/check/run_nxc.py" "$made/posebridge.lst" >"$made/nxc.txt"
    sed 's/.* = //' "$made/lines.txt" | diff - "$made/nxc.txt" >&2 || fail "what nbc makes of posebridge_frames.nxc makes other bytes than brick/vectors"
    printf 'nxc: %d vectors, the same by the code that nbc has made\n' "$(wc -l <"$made/lines.txt")"
    # The sum of the gyro: 3459 degrees * ms are 60370 microradians, 46 are 802.
    turns=$'turn 90 20 90 20 -45 100 400 100 -360 99 1 1 -1 1 -1 1\nturn -1 1 -1 1 -1 1 42 1 5 101 7 1'
    [[ "$(python3 -B "$brick/check/run_nxc.py" "$made/posebridge.lst" <<<"$turns")" == $'60370\n802' ]] ||
        fail "what nbc makes of pb_add_turn adds up wrongly"
}

check_square_log() {
    LD_LIBRARY_PATH="$libraries" nbc -v=128 -Z2 "-I=$brick/nxc/" "-O=$made/square_log.rxe" "-L=$made/square_log.lst" \
        "$brick/nxc/square_log.nxc" >"$made/nbc.log" 2>&1 || true
    [[ -s "$made/square_log.rxe" ]] && ! grep -q '^# Error' "$made/nbc.log" || fail "nbc does not compile square_log.nxc:
$(cat "$made/nbc.log")"
    python3 -B "$brick/check/test_square_log.py" >"$made/square_log.log" 2>&1 || fail "brick/micropython/square_log.py:
$(cat "$made/square_log.log")"
    printf 'square log: square_log.nxc compiles, %d B; square_log.py writes brick/vectors/square_log.csv\n' "$(stat -c %s "$made/square_log.rxe")"
}

check_micropython() {
    grep -Ev '^(#|$)' "$brick/vectors/vectors.txt" >"$made/lines.txt"
    sed 's/ = .*//' "$made/lines.txt" |
        node "$brick/check/run_micropython.mjs" "$node_modules/@micropython/micropython-webassembly-pyscript" >"$made/micropython.txt"
    sed 's/.* = //' "$made/lines.txt" | diff - "$made/micropython.txt" >&2 || fail "MicroPython makes other bytes than brick/vectors"
    printf 'micropython: %d vectors, the same under MicroPython 1.27.0\n' "$(wc -l <"$made/lines.txt")"
    python3 -B "$brick/check/test_named_value.py" >"$made/named_value.log" 2>&1 || fail "brick/micropython/posebridge_brick.py:
$(cat "$made/named_value.log")"
    printf 'micropython: reads NAMED_VALUE_FLOAT from pymavlink\n'
}

check_bridge() {
    python3 -B "$brick/check/test_bridge.py" >"$made/bridge.log" 2>&1 || fail "brick/micropython/pybricks_bridge.py:
$(cat "$made/bridge.log")"
    printf 'bridge: carries frames both ways without a hub\n'
}

# The filters on every target; the table that docs and README print.
check_filters() {
    "$python/bin/python" -B "$brick/check/filters/check.py" "$tools/root" "$made/filters" \
        "$node_modules/@micropython/micropython-webassembly-pyscript"
}

# What waits for the network, at once. A failure in the background is repeated, and said, in the foreground.
(install_python) >/dev/null 2>&1 &
(install_micropython) >/dev/null 2>&1 &
install_compilers
wait
install_python
install_micropython
check_filters >"$made/filters.log" 2>&1 &
filters=$!
trap 'kill "$filters" 2>/dev/null || true' EXIT
vectors_are_those_of_make_py
check_sizes
check_arduino
check_stock_mavlink
check_nxc
check_square_log
check_micropython
check_bridge
code=0
wait "$filters" || code=$?
trap - EXIT
cat "$made/filters.log"
exit "$code"
