"""Writes targets.json: one frame by pymavlink of every message that names a target, to test our routing against.

Usage: make_targets.py posebridge.xml common.xml > targets.json     (see README.md for the whole recipe)

Every number is 1, except target_system (MANUAL_CONTROL: target), which is 42, and target_component, which is 84: whatever the
order on the wire, a 42 and an 84 stand at one place each. "NAME system" has 42 and 0, so that a trailing zero is cut off.
"""

import json
import sys

from make_golden import load

SYSTEM, COMPONENT = 42, 84


def value(message, field, component):
    """What a field of a message is set to."""
    if field == "target_system" or (message.msgname == "MANUAL_CONTROL" and field == "target"):
        return SYSTEM
    if field == "target_component":
        return component
    index = message.fieldnames.index(field)
    kind = message.fieldtypes[index]
    length = message.array_lengths[message.ordered_fieldnames.index(field)]
    if kind == "char":
        return b"a" * max(length, 1)
    return [1] * length if length else 1


def cases(module):
    for message in module.mavlink_map.values():
        names = message.fieldnames
        if "target_system" not in names and message.msgname != "MANUAL_CONTROL":
            continue
        for suffix, component in (("", COMPONENT), (" system", 0)):
            if suffix and "target_component" not in names:
                continue
            link = module.MAVLink(None, srcSystem=1, srcComponent=1)
            fields = [value(message, field, component) for field in names]
            yield message.msgname + suffix, message(*fields).pack(link).hex()


if __name__ == "__main__":
    frames = {}
    for xml in sys.argv[1:]:
        frames.update(cases(load(xml, "2.0")))
    json.dump(frames, sys.stdout, indent=0, sort_keys=True)
    print()
