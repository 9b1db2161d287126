# The text file that `posebridge lab nxt-square --data` reads, written row by row; docs/lab/square.md describes it.
#
# On an EV3 (or a board with a file system) give an open file, on a Pybricks hub sys.stdout and copy the output:
#
#   log = SquareLog(open("square.csv", "w"))
#   while driving:
#       log.row(watch.time(), left.angle(), right.angle(), gyro_deg_per_s)
#
# Counts are forward positive, rates counter-clockwise positive with the gyro's bias. None is a sensor that said nothing.

COLUMNS = ("time_ms", "left_counts", "right_counts", "gyro_deg_per_s", "accel_left_m_per_s2", "accel_right_m_per_s2", "compass_deg")


class SquareLog:
    def __init__(self, stream):
        self.write = stream.write
        self.write(",".join(COLUMNS) + "\n")

    def row(self, time_ms, left, right, gyro_deg_per_s=None, accel_m_per_s2=(None, None), compass_deg=None):
        cells = (time_ms, left, right, gyro_deg_per_s) + tuple(accel_m_per_s2) + (compass_deg,)
        self.write(",".join(["" if cell is None else str(cell) for cell in cells]) + "\n")
