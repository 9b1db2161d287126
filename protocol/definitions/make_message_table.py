"""Writes protocol/src/dialect/message_table.txt: every message of MAVLink's all.xml and ardupilotmega.xml with what they include, and of ours.

    python3 -m venv /tmp/mavlink && /tmp/mavlink/bin/pip install pymavlink==2.4.50
    /tmp/mavlink/bin/python protocol/definitions/make_message_table.py FOLDER [--check]

FOLDER holds the XML of the MAVLink project: `mavlink/message_definitions/v1.0` in the package of the crate `mavlink` (0.21.0: upstream commit
19795337), below ~/.cargo/registry/src. With `--check` nothing is written; the script fails if the file differs. Checksum seeds, lengths and
the order of fields are computed by pymavlink's mavparse; the file holds facts about the wire and no text of the definitions.
"""

import pathlib
import sys

from pymavlink.generator import mavparse

HERE = pathlib.Path(__file__).resolve().parent
TABLE = HERE.parent / "src" / "dialect" / "message_table.txt"
TYPES = {
    "char": "char", "float": "f32", "double": "f64",
    **{f"{sign}int{bits}_t": f"{short}{bits}" for sign, short in (("", "i"), ("u", "u")) for bits in (8, 16, 32, 64)},
}


def messages(path, seen):
    """All messages of a file and of those that it includes, each file once."""
    if path.name in seen:
        return
    seen.add(path.name)
    xml = mavparse.MAVXML(str(path), "2.0")
    for include in xml.include:
        yield from messages(path.parent / include, seen)
    yield from xml.message


def field(message, index):
    one = message.ordered_fields[index]
    array = f"[{one.array_length}]" if one.array_length else ""
    start = message.extensions_start
    extension = "+" if start is not None and index >= start else ""
    words = [one.name, f"{extension}{TYPES[one.type]}{array}"]
    if one.units:
        # `[m/s]` in the XML's reading of mavparse.
        words.append(one.units.strip("[]"))
    assert not any(set(word) & set(" ;,") for word in words), words
    return " ".join(words)


def row(message):
    head = f"{message.id},{message.crc_extra},{message.wire_min_length},{message.wire_length},{message.name}"
    return ";".join([head, *(field(message, index) for index in range(len(message.ordered_fields)))])


def table(folder):
    found, seen = {}, set()
    for path in (folder / "all.xml", folder / "ardupilotmega.xml", HERE / "posebridge.xml"):
        for message in messages(path, seen):
            line = row(message)
            assert found.setdefault(message.id, line) == line, f"two definitions of {message.id}: {line} and {found[message.id]}"
    return "".join(found[number] + "\n" for number in sorted(found))


def main():
    text = table(pathlib.Path(sys.argv[1]))
    if "--check" not in sys.argv[2:]:
        TABLE.write_text(text)
    elif TABLE.read_text() != text:
        sys.exit(f"{TABLE} is not what the definitions give: write it anew")


main()
