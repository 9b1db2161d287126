"""The filters of brick/filters on a PC, an ATmega328P, a Cortex-M4F, an NXT and under MicroPython, against each other.

    python check.py <folder of the tools> <folder for what is made> <folder of MicroPython's package>

Prints a table: filter, target, bytes, cost of a step, largest difference. The difference is to the same C in double precision, which
`cargo test --test bricks filters` holds to the filters of the station; it is a share of the largest value that the quantity takes. Ends with 1 where
it is above the bar.
"""

import concurrent.futures
import math
import subprocess
import sys
from pathlib import Path

import rows as made_rows
import run_arm

HERE = Path(__file__).resolve().parent
BRICK = HERE.parent.parent
sys.path.append(str(BRICK / "check"))
import run_nxc
FILTERS = BRICK / "filters"
SOURCES = [HERE / "steps.c", *(FILTERS / f"posebridge_{name}.c" for name in ("filters", "indirect", "slow_sensor"))]
# Title, -DFILTER of steps.c, rows, numbers of an answer that count.
DRIVE, THERMOMETER, WALL = made_rows.drive(), made_rows.thermometer(), made_rows.wall()
CASES = [
    ("wheel", ["-DFILTER=1"], DRIVE, 5),
    ("speed", ["-DFILTER=2"], DRIVE, 5),
    ("ekf5", ["-DFILTER=3"], DRIVE, 5),
    ("ekf9", ["-DFILTER=4"], DRIVE, 5),
    ("indirect", ["-DFILTER=6"], DRIVE, 5),
    # On the NXT the accelerometers are never silent: they are part of the step.
    ("indirect, 7 states", ["-DFILTER=5", "-DPB_INDIRECT_SMALL"], [[*row[:6], 1.0] for row in DRIVE], 5),
    ("thermometer", ["-DFILTER=7"], THERMOMETER, 2),
    ("wall", ["-DFILTER=8"], WALL, 4),
]
EMPTY = ("empty", [], [], 0)
# What rounding may come to, as a share of the largest value: the largest of single precision is 1.9e-5. MicroPython's port has double precision.
MOST_DIFFERENCE = 5e-5
MOST_DIFFERENCE_DOUBLE = 1e-9
WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]


class Tools:
    def __init__(self, root, made, micropython):
        self.root, self.made, self.micropython = root, made, micropython
        made.mkdir(parents=True, exist_ok=True)

    def run(self, *command, text=None):
        done = subprocess.run([str(word) for word in command], input=text, capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"brick SDK: {Path(str(command[0])).name} ended with {done.returncode}: {(done.stderr or done.stdout)[-1500:]}")
        return done.stdout

    def path(self, target, title, suffix=""):
        return self.made / f"{target}-{title.replace(', ', '-').replace(' ', '-')}{suffix}"

    def symbols(self, nm, program):
        lines = (line.split() for line in self.run(nm, program).splitlines())
        return {words[-1]: int(words[0], 16) for words in lines if len(words) == 3}

    def sizes(self, size, program):
        """Flash and static RAM: text and data, data and bss."""
        text, data, bss = self.run(size, program).splitlines()[1].split()[:3]
        return int(text) + int(data), int(data) + int(bss)


def as_text(rows):
    return "".join(" ".join(repr(value) for value in row) + "\n" for row in rows)


def answers_of(text):
    return [[float(word) for word in line.split()] for line in text.splitlines()]


def on_pc(tools, case, real):
    title, switches, rows, _ = case
    program = tools.path(real, title)
    tools.run("gcc", *WARNINGS, "-O1", f"-DPB_REAL={real}", *switches, "-I", FILTERS, *SOURCES, "-lm", "-o", program)
    return answers_of(tools.run(program, text=as_text(rows)))


def avr_program(tools, case):
    title, switches, _, _ = case
    program = tools.path("avr", title, ".elf")
    target = ["-mmcu=atmega328p", "-Os", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections", "-DON_BRICK", "-DPB_REAL=float"]
    tools.run("avr-gcc", *WARNINGS, *target, *switches, "-I", FILTERS, *SOURCES, "-lm", "-o", program)
    return program


def on_avr(tools, case, runner, empty):
    program = avr_program(tools, case)
    image = program.with_suffix(".bin")
    tools.run("avr-objcopy", "-O", "binary", program, image)
    symbols = tools.symbols("avr-nm", program)
    names = ["check_ready", "check_before", "check_after", "check_in", "check_out", "__addsf3", "__mulsf3", "__divsf3", "sin", "cos", "exp"]
    words = [f"{symbols.get(name, 0):x}" for name in names]
    *lines, cost = tools.run(runner, image, *words, text=as_text(case[2])).splitlines()
    cycles, stack, *operations = [int(word) for word in cost.split()[1:]]
    flash, ram = (mine - other for mine, other in zip(tools.sizes("avr-size", program), empty))
    add, mul, div, special = operations
    flops = f"{add + mul + div} flops" + (f", {special} of libm" if special else "")
    return answers_of("\n".join(lines)), flash, ram + stack, f"{cycles} cycles", flops


def arm_program(tools, case):
    title, switches, _, _ = case
    program = tools.path("arm", title, ".elf")
    newlib = tools.root / "usr/lib/arm-none-eabi/newlib/thumb/v7e-m+fp/hard"
    target = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-Os", "-ffunction-sections", "-fdata-sections"]
    linked = ["-fno-use-linker-plugin", "-nostdlib", "-Wl,--gc-sections,-e,main", f"-Wl,-Ttext={run_arm.BASE:#x}", "-L", newlib]
    headers = ["-isystem", tools.root / "usr/include/newlib", "-I", FILTERS]
    libraries = ["-Wl,--start-group", "-lm", "-lc_nano", "-lgcc", "-Wl,--end-group"]
    switches = ["-DON_BRICK", "-DPB_REAL=float", *switches]
    tools.run("arm-none-eabi-gcc", *WARNINGS, *target, *linked, *switches, *headers, *SOURCES, *libraries, "-o", program)
    return program


def on_arm(tools, case, empty):
    program = arm_program(tools, case)
    image = program.with_suffix(".bin")
    tools.run("arm-none-eabi-objcopy", "-O", "binary", program, image)
    answers, instructions, stack = run_arm.run(image.read_bytes(), tools.symbols("arm-none-eabi-nm", program), case[2])
    flash, ram = (mine - other for mine, other in zip(tools.sizes("arm-none-eabi-size", program), empty))
    return answers, flash, ram + stack, f"{instructions} instr."


# Of each filter that an NXT has: its switch, the calls that begin it and those of a step, with their parameters, and its answer.
SENSES = ["dt", "left_rad", "right_rad", "left_m_s2", "right_m_s2", "gyro_rad_s"]
STATE = ["pb_x", "pb_y", "pb_heading", "pb_forward", "pb_turn"]
NXC = {
    "wheel": ("PB_WHEEL_KF", ["pb_start(0.2, -0.1, 0.3)", "pb_wheel_init()"], "pb_wheel_step", SENSES[:3], STATE),
    "speed": ("PB_SPEED_KF", ["pb_start(0.2, -0.1, 0.3)", "pb_speed_init(0.05)"], "pb_speed_step", SENSES[:5], STATE),
    "ekf5": ("PB_EKF5", ["pb_start(0.2, -0.1, 0.3)", "pb_ekf5_init(0.01, 0.02)"], "pb_ekf5_step", [*SENSES, "has_gyro"], STATE),
    "indirect, 7 states": ("PB_INDIRECT", ["pb_start(0.2, -0.1, 0.3)", "pb_indirect_init(0.01, 0.02, 0.03, 0.05)"], "pb_indirect_step", SENSES[:5], STATE),
    "thermometer": ("PB_THERMOMETER", ["pb_thermometer_init(21.0, 0.03)"], "pb_thermometer_step", ["decay", "shown"], ["pb_u", "pb_transient"]),
}


def nxc_program(tools, title, text):
    """Compiles a program; its size and its listing."""
    source = tools.path("nxc", title, ".nxc")
    source.write_text(text)
    program, listing = source.with_suffix(".rxe"), source.with_suffix(".lst")
    for old in (program, listing):
        old.unlink(missing_ok=True)
    libraries = f"LD_LIBRARY_PATH={tools.root}/usr/lib/x86_64-linux-gnu:{tools.root}/lib/x86_64-linux-gnu"
    command = ["env", libraries, "nbc", "-v=128", "-Z2", f"-I={BRICK / 'nxc'}/", f"-O={program}", f"-L={listing}", source]
    said = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if not program.exists():
        sys.exit(f"brick SDK: nbc does not compile {source.name}: {said.stdout[-1500:]}{said.stderr[-500:]}")
    return program.stat().st_size, listing.read_text()


def on_nxt(tools, case, empty_size):
    """Runs what nbc has made of a filter. A step's cost is the instructions of the NXT's virtual machine."""
    title, _, rows, _ = case
    switch, begins, step, names, results = NXC[title]
    arguments = ", ".join("1" if name == "has_gyro" else "1.0" for name in names)
    calls = "\n".join(f"    {call};" for call in [*begins, f"{step}({arguments})"])
    size, listing = nxc_program(tools, title, f'#define {switch}\n#include "posebridge_filters.nxc"\ntask main()\n{{\n{calls}\n}}\n')
    machine = run_nxc.Machine(run_nxc.Program(listing), lambda a, b: a or b)
    if title != "thermometer":
        machine.give("pb_start", ["x", "y", "heading"], [0.2, -0.1, 0.3])
    if title == "ekf5":
        machine.set("pb_gyro_bias", 0.002)
    if title.startswith("indirect"):
        for name, value in [("wheel", 0.0008), ("travel", 0.001), ("turn", 0.004), ("heading", 0.003)]:
            machine.set(f"pb_{name}_noise", value)
    for call in begins:
        name, numbers = call.rstrip(")").split("(")
        if name == "pb_thermometer_init":
            machine.give(name, ["shown", "sigma"], [rows[0][1], 0.03])
        elif name != "pb_start":
            parameters = {
                "pb_speed_init": ["accelerometer_m_s2"],
                "pb_ekf5_init": ["sigma_m", "sigma_rad"],
                "pb_indirect_init": ["sigma_m", "sigma_rad", "sigma_track", "accelerometer_m_s2"],
            }.get(name, [])
            machine.give(name, parameters, [float(number) for number in numbers.split(",") if number])
    answers, most = [], 0
    for index, row in enumerate(rows):
        if title == "thermometer":
            machine.give(step, names, [1.0 if index == 0 else math.exp(-row[0] / 20), row[1]])
        elif index == 0:
            if title in ("speed", "ekf5"):
                machine.give("pb_feel", ["left_m_s2", "right_m_s2"], row[3:5])
        else:
            felt = row[3:5] if int(row[6]) & 1 else [0.0, 0.0]
            given = dict(zip(SENSES, [*row[:3], *felt, row[5]]), has_gyro=int(row[6]) >> 1 & 1)
            machine.give(step, names, [given[name] for name in names])
        most = max(most, machine.steps)
        answers.append([machine.get(name) for name in results])
    return answers, size - empty_size, "-", f"{most} instr."


MICROPYTHON = ("wheel", "speed", "ekf5", "thermometer", "wall")


def under_micropython(tools, case):
    text = tools.run("node", HERE / "run_micropython.mjs", tools.micropython, case[0], text=as_text(case[2]))
    return answers_of(text), "-", "-", "-"


def largest_difference(case, reference, answers):
    """As a share of the largest value of each quantity."""
    title, _, _, numbers = case
    if len(answers) != len(reference):
        sys.exit(f"brick SDK: {title} answers {len(answers)} of {len(reference)} rows")
    worst = 0.0
    for number in range(numbers):
        scale = max(abs(answer[number]) for answer in reference)
        for exact, rounded in zip(reference, answers):
            worst = max(worst, abs(rounded[number] - exact[number]) / scale)
    return worst


def build_runner(tools):
    runner = tools.made / "run_avr"
    headers = tools.root / "usr/include/simavr"
    libraries = tools.root / "usr/lib/x86_64-linux-gnu"
    elf = next(iter(sorted(tools.root.glob("**/libelf.so.1"))))
    tools.run("gcc", "-O2", "-Wall", "-Wextra", "-I", headers, HERE / "run_avr.c", libraries / "libsimavr.a", elf, f"-Wl,-rpath,{elf.parent}", "-o", runner)
    return runner


def print_line(*cells):
    title, target, flash, ram, step, cost, difference = cells
    print(f"filters: {title:<18} {target:<11} {flash:>6} {ram:>5}  {step:<14} {difference:>8}  {cost}".rstrip())


def check_case(job):
    """All targets of one filter: their lines of the table and what is above the bar."""
    tools, case, runner, empty = job
    reference = on_pc(tools, case, "double")
    *result, flops = on_avr(tools, case, runner, empty["avr"])
    results = [("ATmega328P", result, flops), ("Cortex-M4F", on_arm(tools, case, empty["arm"]), "")]
    if case[0] in NXC:
        results.append(("NXT", on_nxt(tools, case, empty["nxt"]), ""))
    if case[0] in MICROPYTHON:
        results.append(("MicroPython", under_micropython(tools, case), ""))
    lines, failed = [], []
    for target, (answers, flash, ram, step), cost in results:
        difference = largest_difference(case, reference, answers)
        lines.append((case[0], target, flash, ram, step, cost, f"{difference:.1e}"))
        if not difference <= (MOST_DIFFERENCE_DOUBLE if target == "MicroPython" else MOST_DIFFERENCE):
            failed.append(f"{case[0]} on {target}: {difference:.1e}")
    return lines, failed


def main():
    root, made, micropython = (Path(argument).resolve() for argument in sys.argv[1:4])
    tools = Tools(root, made, micropython)
    runner = build_runner(tools)
    empty = {
        "avr": tools.sizes("avr-size", avr_program(tools, EMPTY)),
        "arm": tools.sizes("arm-none-eabi-size", arm_program(tools, EMPTY)),
        "nxt": nxc_program(tools, "empty", "task main()\n{\n}\n")[0],
    }
    print_line("filter", "target", "flash", "RAM", "a step", "its arithmetic", "differs")
    failed = []
    with concurrent.futures.ProcessPoolExecutor() as pool:
        for lines, worse in pool.map(check_case, [(tools, case, runner, empty) for case in CASES]):
            for line in lines:
                print_line(*line)
            failed += worse
    if failed:
        sys.exit(f"brick SDK: a filter differs by more than rounding does, as a share of its largest value: {'; '.join(failed)}")


if __name__ == "__main__":
    main()
