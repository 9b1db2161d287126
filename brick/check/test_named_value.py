"""The MicroPython receiver reads what the station says of a thermometer.

python3 brick/check/test_named_value.py

The frames are those of pymavlink 2.4 (MAVLink 2, sender 255/190): named_value_float_encode(1234, name, value).
"""

import sys
import unittest
from pathlib import Path

brick = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(brick / "micropython"))
from posebridge_brick import Link, Receiver  # noqa: E402

END = bytes.fromhex("fd0d000000ffbefb0000d204000000c04242656e645f31e95b")
SIGMA = bytes.fromhex("fd0c000000ffbefb0000d20400000000803e73645f311988")
NOT_FINITE = bytes.fromhex("fd0d000000ffbefb0000d20400000000c07f656e645f31d541")


class NamedValues(unittest.TestCase):
    def receiver(self):
        return Receiver(Link(lambda frame: None))

    def test_the_newest_value_of_each_name_is_kept_whatever_the_chunks(self):
        stream = SIGMA[:9] + SIGMA + b"\xfd" + END + NOT_FINITE
        for chunk in range(1, len(stream) + 1):
            receiver = self.receiver()
            for place in range(0, len(stream), chunk):
                self.assertEqual(receiver.feed(stream[place : place + chunk], 0), [])
            self.assertEqual(receiver.values, {"end_1": (48.6875, 1234), "sd_1": (0.25, 1234)})

    def test_a_damaged_frame_changes_nothing(self):
        for place in range(len(END)):
            receiver = self.receiver()
            receiver.feed(END[:place] + bytes((END[place] ^ 4,)) + END[place + 1 :], 0)
            self.assertEqual(receiver.values, {})


if __name__ == "__main__":
    unittest.main()
