"""A ground station that speaks with pymavlink's own connections, by the dialect that has our messages beside the standard ones."""

import collections
import time

import posebridge_all
from pymavlink import mavutil

from harness import DEADLINE_S

GCS = (255, 190)
VEHICLE = (1, 1)
ESTIMATOR = (1, 197)
ACCEPTED = mavutil.mavlink.MAV_RESULT_ACCEPTED

mavutil.set_dialect("posebridge_all")


def sender(message):
    return message.get_srcSystem(), message.get_srcComponent()


class Ground:
    """One link; keeps what it hears and counts what is missing."""

    def __init__(self, address, scheme="udp", key=None, own=GCS):
        host, port = address
        kind = {"udp": "udpout", "tcp": "tcp"}[scheme]
        self.link = mavutil.mavlink_connection(f"{kind}:{host}:{port}", source_system=own[0], source_component=own[1])
        self.unsigned = 0
        if key is not None:
            # What the station passes on for a robot that does not sign comes as it was.
            self.link.setup_signing(key, link_id=9, allow_unsigned_callback=self._count_unsigned)
        self.heard = []
        self.last, self.lost = {}, collections.Counter()
        self.beaten = 0.0
        self.beat()

    def close(self):
        self.link.close()

    def _count_unsigned(self, _link, _message_id):
        self.unsigned += 1
        return True

    @property
    def mav(self):
        return self.link.mav

    def beat(self):
        """A heartbeat each second, by which the station knows that somebody listens."""
        if time.monotonic() - self.beaten >= 1.0:
            self.beaten = time.monotonic()
            self.mav.heartbeat_send(mavutil.mavlink.MAV_TYPE_GCS, mavutil.mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4)

    def hear(self, is_wanted, what):
        """Reads until a message that is wanted has come, and returns it."""
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            self.beat()
            message = self.link.recv_match(blocking=True, timeout=0.5)
            if message is not None:
                self._take(message)
                if is_wanted(message):
                    return message
        raise AssertionError(f"{what} does not come; heard {dict(self.kinds())}, {self.link.mav.total_receive_errors} errors")

    def _take(self, message):
        self.heard.append(message)
        of, number = sender(message), message.get_seq()
        self.lost[of] += (number - self.last.get(of, number - 1) - 1) % 256
        self.last[of] = number

    def hear_from(self, of, kind, is_wanted=lambda message: True):
        """Reads until a message of that kind has come from somebody."""
        return self.hear(lambda message: message.get_type() == kind and sender(message) == of and is_wanted(message), f"{kind} of {of}")

    def hear_beats(self, count, of=(VEHICLE, ESTIMATOR)):
        """Reads until each of them has said that many more heartbeats, which come once a second."""
        missing = collections.Counter({one: count for one in of})
        while +missing:
            beat = self.hear(lambda message: message.get_type() == "HEARTBEAT", f"heartbeats of {of}")
            missing[sender(beat)] -= 1

    def kinds(self):
        """How many messages of which kind came from whom."""
        return collections.Counter((*sender(message), message.get_type()) for message in self.heard)

    def command(self, number, *parameters, of=ESTIMATOR):
        """Sends a command and returns the MAV_RESULT of its answer."""
        self.mav.command_long_send(*of, number, 0, *parameters, *(0.0,) * (7 - len(parameters)))
        return self.hear_from(of, "COMMAND_ACK", lambda answer: answer.command == number).result

    def undecoded(self):
        """What pymavlink could not make sense of."""
        return [message for message in self.heard if message.get_type() == "BAD_DATA" or message.get_type().startswith("UNKNOWN")]

    def parameters(self, of=ESTIMATOR):
        """Fetches all parameters: their values by name."""
        self.mav.param_request_list_send(*of)
        found = {}
        while True:
            value = self.hear_from(of, "PARAM_VALUE")
            if value.param_index != 65535:
                found[value.param_id] = value.param_value
            if len(found) == value.param_count:
                return found


def of_ones(message):
    """A message of some class with 1 in every field."""
    fields = []
    lengths = dict(zip(message.ordered_fieldnames, message.array_lengths))
    for name, kind in zip(message.fieldnames, message.fieldtypes):
        length = lengths[name]
        if kind == "char":
            fields.append(b"x")
        else:
            one = 1.0 if kind in ("float", "double") else 1
            fields.append([one] * length if length else one)
    return message(*fields)


def every_message():
    """Every message of our dialect and the standard ones."""
    return [of_ones(message) for _, message in sorted(posebridge_all.mavlink_map.items())]
