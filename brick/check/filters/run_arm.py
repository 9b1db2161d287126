"""Runs steps.c on an emulated Cortex-M4F (Unicorn) and counts the instructions of a step."""

import struct

from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_MODE_MCLASS, UC_MODE_THUMB, Uc
from unicorn.arm_const import UC_ARM_REG_SP, UC_CPU_ARM_CORTEX_M4

BASE = 0x10000
RAM_END = 0x40000
# Steps that are counted, the first of all among them: counting takes far longer than running.
COUNTED = 24


class Machine:
    """Runs the program once over all rows. What it waits for are functions that it calls: a hook on the first instruction of each."""

    def __init__(self, image, symbols, rows):
        self.symbols, self.rows, self.answers, self.given = symbols, rows, [], 0
        self.emulator = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self.emulator.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M4)
        self.emulator.mem_map(0, RAM_END)
        self.emulator.mem_write(BASE, image)
        self.emulator.reg_write(UC_ARM_REG_SP, RAM_END)
        self.hook("check_ready", self.exchange)

    def hook(self, name, function):
        place = self.symbols[name] & ~1
        self.emulator.hook_add(UC_HOOK_CODE, function, begin=place, end=place)

    def exchange(self, *_):
        """Takes the answer to the row before, gives the next one."""
        if self.given > 0:
            self.answers.append(struct.unpack("<5f", self.emulator.mem_read(self.symbols["check_out"], 20)))
        if self.given == len(self.rows):
            self.emulator.emu_stop()
            return
        self.emulator.mem_write(self.symbols["check_in"], struct.pack("<7f", *self.rows[self.given]))
        self.given += 1

    def run(self):
        self.emulator.emu_start(self.symbols["main"] | 1, RAM_END - 2)
        return self.answers


class CountingMachine(Machine):
    def __init__(self, image, symbols, rows):
        super().__init__(image, symbols, rows)
        self.steps, self.stack, self.top, self.is_step = [], 0, 0, False
        self.hook("check_before", self.begin)
        self.hook("check_after", self.end)
        self.emulator.hook_add(UC_HOOK_CODE, self.count)

    def begin(self, *_):
        self.is_step = True
        self.steps.append(0)
        self.top = self.emulator.reg_read(UC_ARM_REG_SP)

    def end(self, *_):
        self.is_step = False

    def count(self, *_):
        if self.is_step:
            self.steps[-1] += 1
            self.stack = max(self.stack, self.top - self.emulator.reg_read(UC_ARM_REG_SP))


def run(image, symbols, rows):
    """The answers, the most instructions of the first steps, and the most bytes of stack. `image` is loaded at BASE."""
    counting = CountingMachine(image, symbols, rows[:COUNTED])
    counting.run()
    return Machine(image, symbols, rows).run(), max(counting.steps), counting.stack
