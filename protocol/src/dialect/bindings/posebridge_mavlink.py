"""The messages of posebridge for pymavlink, beside whatever dialect is in use. Written by `posebridge dialect --for python`.

    from pymavlink import mavutil
    import posebridge_mavlink

    messages = posebridge_mavlink.register()
    link = mavutil.mavlink_connection("udpin:127.0.0.1:14550")     # or a log: "recording.tlog"
    pose = link.recv_match(type="PB_PLANAR_POSE", blocking=True)
    link.mav.send(messages["PB_WHEEL_TICKS"](time_us=0, left=12, right=12, flags=3))

`posebridge dialect --for xml` prints what the fields mean.
"""

import importlib
import struct

# Id, name, CRC_EXTRA, and the fields in the order of the wire: name, type, number of elements (0: no array), unit.
MESSAGES = (
@MESSAGES@)
# Types as the module `struct` and pymavlink write them.
CODES = {
    "char": "c", "uint8_t": "B", "uint16_t": "H", "uint32_t": "I", "uint64_t": "Q", "int8_t": "b", "int16_t": "h", "int32_t": "i",
    "int64_t": "q", "float": "f", "double": "d",
}


def register(dialect=None):
    """Adds the messages to the module of a dialect and returns their classes by name. Default: MAVLink 2 of the dialect that mavutil uses."""
    if dialect is None:
        from pymavlink import mavutil

        dialect = importlib.import_module(f"pymavlink.dialects.v20.{mavutil.current_dialect}")
    if dialect.WIRE_PROTOCOL_VERSION != "2.0":
        raise ValueError(f"{dialect.__name__} is MAVLink {dialect.WIRE_PROTOCOL_VERSION}: take one of pymavlink.dialects.v20")
    classes = {}
    for number, name, crc_extra, fields in MESSAGES:
        if number not in dialect.mavlink_map:
            made = _message_class(dialect.MAVLink_message, number, name, crc_extra, fields)
            dialect.mavlink_map[number] = made
            setattr(dialect, made.__name__, made)
            setattr(dialect, f"MAVLINK_MSG_ID_{name}", number)
        classes[name] = dialect.mavlink_map[number]
    return classes


def _message_class(base, number, name, crc_extra, fields):
    names = [field for field, _, _, _ in fields]
    codes = [CODES[kind] for _, kind, _, _ in fields]
    counts = [count for _, _, count, _ in fields]
    packed = (f"{count}s" if code == "c" else f"{count or ''}{code}" for code, count in zip(codes, counts))
    unpacker = struct.Struct("<" + "".join(packed))

    def __init__(self, *values, **named):
        base.__init__(self, number, name)
        self._fieldnames = names
        given = {**dict(zip(names, values)), **named}
        if len(given) != len(values) + len(named) or set(given) != set(names):
            raise TypeError(f"{name} takes each of these once: {', '.join(names)}")
        for field, code in zip(names, codes):
            value = given[field]
            if code == "c":
                setattr(self, f"_{field}_raw", value)
                value = value.split(b"\x00", 1)[0].decode("utf-8", errors="replace")
            setattr(self, field, value)

    def pack(self, mav, force_mavlink1=False):
        values = []
        for field, code, count in zip(names, codes, counts):
            value = getattr(self, f"_{field}_raw" if code == "c" else field)
            values.extend(value if count and code != "c" else [value])
        return self._pack(mav, crc_extra, unpacker.pack(*values), force_mavlink1=force_mavlink1)

    return type(f"MAVLink_{name.lower()}_message", (base,), {
        "__init__": __init__,
        "pack": pack,
        "id": number,
        "msgname": name,
        "fieldnames": names,
        "ordered_fieldnames": names,
        "fieldtypes": [kind for _, kind, _, _ in fields],
        "fielddisplays_by_name": {},
        "fieldenums_by_name": {},
        "fieldunits_by_name": {field: unit for field, _, _, unit in fields if unit},
        "native_format": bytearray("<" + "".join(codes), "ascii"),
        "orders": list(range(len(fields))),
        "lengths": [1 if code == "c" else max(1, count) for code, count in zip(codes, counts)],
        "array_lengths": counts,
        "crc_extra": crc_extra,
        "unpacker": unpacker,
        "instance_field": None,
        "instance_offset": -1,
    })
