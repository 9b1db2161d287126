"""The text file of square_log.py is brick/vectors/square_log.csv, which the lab's own test reads.

python3 brick/check/test_square_log.py
"""

import io
import sys
import unittest
from pathlib import Path

brick = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(brick / "micropython"))
from square_log import SquareLog  # noqa: E402


class Rows(unittest.TestCase):
    def test_each_reading_has_its_cell_and_silence_an_empty_one(self):
        stream = io.StringIO()
        log = SquareLog(stream)
        log.row(0, 0, 0)
        log.row(50, 3, -4, 2, (0.1, -0.25), 359)
        log.row(101, 2046, -180, -1)
        self.assertEqual(stream.getvalue(), (brick / "vectors" / "square_log.csv").read_text())


if __name__ == "__main__":
    unittest.main()
