"""Writes signed.json: frames signed by pymavlink, a foreign implementation, to test our signatures against.

Usage: make_signed.py posebridge.xml common.xml > signed.json     (see README.md for the whole recipe)
"""

import json
import sys

from make_golden import HEARTBEAT, load

KEYS = [bytes(range(32)), bytes(255 - 5 * k for k in range(32))]


def case(module, name, message, sender, signature, **fields):
    """One message as a whole frame, with everything that its signature depends on."""
    (system, component, sequence), (key, link_id, timestamp) = sender, signature
    link = module.MAVLink(None, srcSystem=system, srcComponent=component)
    link.seq = sequence
    if key is not None:
        link.signing.secret_key = KEYS[key]
        link.signing.sign_outgoing = True
        link.signing.link_id = link_id
        link.signing.timestamp = timestamp
    if message == "heartbeat":
        fields["mavlink_version"] = 3
    frame = getattr(link, message + "_encode")(**fields).pack(link)
    return dict(name=name, key=key, link_id=link_id, timestamp=timestamp, frame=frame.hex())


def main():
    own, std, std_v1 = load(sys.argv[1], "2.0"), load(sys.argv[2], "2.0"), load(sys.argv[2], "1.0")
    ticks = dict(time_us=4294967290, left=-123456, right=2147483647, flags=3)
    radio = dict(rssi=100, remrssi=90, txbuf=80, noise=10, remnoise=11, rxerrors=1, fixed=2)
    unsigned = (None, 0, 0)
    cases = [
        case(std, "heartbeat", "heartbeat", (1, 1, 5), (0, 3, 123456789), **HEARTBEAT),
        case(std, "heartbeat_first_instant", "heartbeat", (1, 1, 6), (0, 0, 0), **HEARTBEAT),
        case(std, "heartbeat_last_instant", "heartbeat", (1, 1, 7), (0, 255, (1 << 48) - 1), **HEARTBEAT),
        case(std, "heartbeat_other_key", "heartbeat", (1, 1, 8), (1, 3, 123456789), **HEARTBEAT),
        case(std, "timesync", "timesync", (255, 190, 9), (1, 7, 0x123456789ABC),
             tc1=0, ts1=123456789012, target_system=0, target_component=0),
        case(own, "pb_wheel_ticks", "pb_wheel_ticks", (1, 1, 10), (1, 0, 37550000000000), **ticks),
        case(std, "heartbeat_unsigned", "heartbeat", (1, 1, 11), unsigned, **HEARTBEAT),
        case(std, "radio_status_unsigned", "radio_status", (51, 68, 0), unsigned, **radio),
        case(std_v1, "v1_heartbeat", "heartbeat", (1, 1, 12), unsigned, **HEARTBEAT),
    ]
    json.dump(dict(keys=[key.hex() for key in KEYS], cases=cases), sys.stdout, indent=1)
    print()


main()
