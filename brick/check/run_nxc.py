"""Runs the encoder of posebridge.nxc as nbc has compiled it, on an interpreter of the few instructions that it is made of.

python3 brick/check/run_nxc.py posebridge.lst < commands          posebridge.lst is what nbc writes with -L

An NXT's virtual machine is not to be had on a PC, and what nbc makes of a line of NXC may differ from what a C compiler makes of it. So
its output is run here, with the types that its data segment declares; an operation with a float in it is one of single precision. Where sources disagree how the firmware divides and
compares a signed and an unsigned number, both ways are tried, and must come to the same.

Commands and answers are those of brick/vectors; `turn` with pairs of degrees per second and milliseconds answers pb_turn_urad.

Sources: NBC Guide (J. Hansen), chapters on the instructions; LEGO Mindstorms NXT Executable File Specification, section on opcodes.
"""

import math
import re
import struct
import sys

WIDTHS = {"byte": (8, False), "sbyte": (8, True), "word": (16, False), "sword": (16, True), "dword": (32, False), "sdword": (32, True)}
# Comparisons of cmp, tst, brcmp and brtst: a number, or its name.
COMPARE = {
    "LT": lambda a, b: a < b,
    "GT": lambda a, b: a > b,
    "LTEQ": lambda a, b: a <= b,
    "GTEQ": lambda a, b: a >= b,
    "EQ": lambda a, b: a == b,
    "NEQ": lambda a, b: a != b,
}
COMPARE.update({str(code): compare for code, compare in enumerate(list(COMPARE.values()))})
MOST_STEPS = 100_000


def wrapped(value, kind):
    if kind == "float":
        return struct.unpack("<f", struct.pack("<f", value))[0]
    bits, signed = WIDTHS[kind]
    # A float that becomes a whole number loses what is behind its point.
    value = int(value) & (1 << bits) - 1
    return value - (1 << bits) if signed and value >> (bits - 1) else value


class Program:
    """The data segment and the subroutines of a listing."""

    def __init__(self, text):
        data, code = text.split(";------- code -------")
        declarations = data.split(";------- declarations -------")[1]
        self.kinds, self.start = {}, {}
        for line in declarations.splitlines():
            match = re.match(r"(\w+)\s+(s?(?:byte|d?word)|float)(\[\])?(?:\s+(-?[\d.]+))?\s*$", line)
            if match:
                name, kind, is_array, value = match.groups()
                self.kinds[name] = kind
                self.start[name] = [] if is_array else wrapped(float(value or 0), kind)
        current = ([], {})
        self.routines = {}
        for line in code.splitlines():
            if match := re.match(r"(?:subroutine|thread) (\w+)", line):
                current = self.routines[match[1]] = ([], {})
            elif match := re.match(r"(\w+):\s*(.*)", line):  # a label, perhaps with an instruction behind it
                current[1][match[1]] = len(current[0])
                line = "\t" + match[2]
            if re.match(r"\t\w", line):
                name, _, operands = line.strip().partition(" ")
                current[0].append((name, [operand.strip() for operand in operands.split(",")]))


class Machine:
    """Runs subroutines. is_signed says of two kinds whether they are divided and compared as signed numbers."""

    def __init__(self, program, is_signed):
        self.program, self.is_signed = program, is_signed
        self.values = {name: list(value) if isinstance(value, list) else value for name, value in program.start.items()}
        self.steps = 0
        self.call("__initialize_global_data")

    def get(self, operand):
        return self.values[operand] if operand in self.values else int(operand, 0)

    def set(self, operand, value):
        if isinstance(value, list):
            self.values[operand] = value
        else:
            self.values[operand] = wrapped(value, self.program.kinds[operand])

    def pair(self, left, right):
        """Both as signed or both as unsigned numbers of 32 bits; as they are where one is a float."""
        kinds = [self.program.kinds.get(operand, "sword") for operand in (left, right)]
        if "float" in kinds:
            return float(self.get(left)), float(self.get(right))
        as_kind = "sdword" if self.is_signed(*[WIDTHS[kind][1] for kind in kinds]) else "dword"
        return wrapped(self.get(left), as_kind), wrapped(self.get(right), as_kind)

    def call(self, name):
        code, labels = self.program.routines[name]
        place = 0
        while True:
            self.steps += 1
            assert self.steps < MOST_STEPS, f"{name} does not end"
            instruction, operands = code[place]
            place += 1
            if instruction == "subret":
                return
            target = self.step(instruction, operands)
            if target is not None:
                place = labels[target]

    def step(self, name, operands):
        """Does one instruction; returns the label that is jumped to."""
        if name == "jmp":
            return operands[0]
        if name == "subcall":
            self.call(operands[0])
        elif name == "brtst":
            return operands[1] if COMPARE[operands[0]](self.get(operands[2]), 0) else None
        elif name == "brcmp":
            return operands[1] if COMPARE[operands[0]](*self.pair(*operands[2:])) else None
        elif name in ("cmp", "tst"):
            numbers = self.pair(*operands[2:]) if name == "cmp" else (self.get(operands[2]), 0)
            self.set(operands[1], int(COMPARE[operands[0]](*numbers)))
        elif name in ("mov", "set"):
            self.set(operands[0], self.get(operands[1]))
        elif name == "sqrt":
            self.set(operands[0], math.sqrt(self.get(operands[1])))
        elif name == "neg":
            self.set(operands[0], -self.get(operands[1]))
        elif name == "index":
            self.set(operands[0], self.get(operands[1])[self.get(operands[2])])
        elif name == "replace":
            array = list(self.get(operands[1]))
            array[self.get(operands[2])] = wrapped(self.get(operands[3]), self.program.kinds[operands[0]])
            self.values[operands[0]] = array
        elif name == "arrinit":
            self.values[operands[0]] = [wrapped(self.get(operands[1]), self.program.kinds[operands[0]])] * self.get(operands[2])
        else:
            self.set(operands[0], self.arithmetic(name, operands[1], operands[2]))
        return None

    def arithmetic(self, name, left, right):
        a, b = self.pair(left, right)
        if name == "div" and isinstance(a, float):
            return a / b
        if name == "div":
            quotient = abs(a) // abs(b)
            return quotient if (a < 0) == (b < 0) else -quotient
        if name in ("and", "or", "xor"):
            return {"and": a & b, "or": a | b, "xor": a ^ b}[name]
        return {"add": a + b, "sub": a - b, "mul": a * b}[name]

    def give(self, routine, names, numbers):
        for name, number in zip(names, numbers):
            self.set(f"__{routine}_7qG2_{name}_7qG2_000", number)
        self.steps = 0
        self.call(routine)


PARAMETERS = {
    "heartbeat": [],
    "wheel_ticks": ["time_us", "left", "right", "flags"],
    "inertial": ["time_us", "turn_urad", "turn_rate", "accel_left", "accel_right", "valid"],
}


def answer(machine, line):
    command, *numbers = line.split()
    numbers = [int(number) for number in numbers]
    if command == "turn":
        machine.set("pb_turn_urad", 0)
        machine.set("pb_turn_rest", 0)
        for place in range(0, len(numbers), 2):
            machine.give("pb_add_turn", ["rate_deg_per_s", "interval_ms"], numbers[place : place + 2])
        return str(machine.get("pb_turn_urad"))
    for name, number in zip(["pb_sequence", "pb_system", "pb_component"], numbers):
        machine.set(name, number)
    machine.give(f"pb_make_{command}", PARAMETERS[command], numbers[3:])
    return bytes(machine.get("pb_frame")[: machine.get("pb_length")]).hex()


def main():
    with open(sys.argv[1]) as listing:
        program = Program(listing.read())
    machines = [Machine(program, is_signed) for is_signed in (lambda a, b: a or b, lambda a, b: a and b)]
    for machine in machines:
        machine.call("pb_make_table")
    for line in sys.stdin:
        if line.strip():
            answers = {answer(machine, line) for machine in machines}
            assert len(answers) == 1, f"it depends on the firmware what comes of {line.strip()}: {answers}"
            print(answers.pop())


if __name__ == "__main__":
    main()
