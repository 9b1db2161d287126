"""ev3-dc as it is against the simulated EV3 on the loopback network: beacon by UDP, commands by TCP."""

import socket
import struct
import tempfile
import time
import unittest

import ev3_dc

from harness import DEADLINE_S, SimulatedBrick

# No program runs. ev3-dc listens on UDP port 3015 and wants a TCP port of four digits; neither can be left to the system.
SCENARIO = """
seed = 3
[camera]
is_present = false
[brick]
program = "none"
turn_around_ms = 2.0
wall_x_m = 0.8
"""
HOST = "00:16:53:0B:0E:03"
BEACON = "udp://127.0.0.1:3015"


def free_port():
    for port in range(5555, 9999):
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
                return port
            except OSError:
                continue
    raise AssertionError("no TCP port of four digits is free")


class Ev3Dc(unittest.TestCase):
    def setUp(self):
        self.start(SCENARIO)

    def start(self, scenario):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.program = SimulatedBrick(
            folder.name, "ev3", f"tcp://127.0.0.1:{free_port()}", scenario, "--announce", BEACON)
        self.addCleanup(self.program.kill)
        self.brick = ev3_dc.EV3(protocol=ev3_dc.WIFI, host=HOST)
        self.addCleanup(self.disconnect)

    def disconnect(self):
        """ev3-dc would keep the connection as long as anything of it lives, and refuse a second one."""
        physical = self.brick._physical_ev3
        if physical is not None and physical._socket is not None:
            physical._socket.close()
            physical._devices.discard(physical._host)
            physical._socket = None

    def ask(self, layout, *codes):
        """The values of a direct command's answer."""
        reply = self.brick.send_direct_cmd(b"".join(codes), global_mem=struct.calcsize(layout))
        return struct.unpack(layout, reply)

    def counts(self):
        ops = (
            ev3_dc.opOutput_Get_Count, ev3_dc.LCX(0), ev3_dc.LCX(1), ev3_dc.GVX(0),
            ev3_dc.opOutput_Get_Count, ev3_dc.LCX(0), ev3_dc.LCX(2), ev3_dc.GVX(4),
        )
        return self.ask("<2i", *ops)

    def clock_us(self):
        return self.ask("<I", ev3_dc.opTimer_Read_Us, ev3_dc.GVX(0))[0]

    def wait_until(self, is_so, what):
        deadline = time.monotonic() + DEADLINE_S
        while not is_so():
            if time.monotonic() > deadline:
                self.fail(f"not so: {what}")

    def test_it_is_found_by_its_beacon_and_tells_who_it_is(self):
        self.assertEqual((self.brick.name, self.brick.host), ("EV3", HOST))
        self.assertEqual(self.brick.system.fw_version, "V1.09H")
        self.assertEqual((self.brick.volume, self.brick.sleep), (50, 30))
        self.brick.name = "rover"
        self.brick._physical_ev3._introspection = None
        self.assertEqual(self.brick.name, "rover")

    def test_what_is_plugged_in_is_told(self):
        sensors = self.brick.sensors
        self.assertEqual((sensors.Port_1, sensors.Port_2), (None, ev3_dc.EV3_GYRO))
        self.assertEqual((sensors.Port_3, sensors.Port_4), (None, ev3_dc.EV3_ULTRASONIC))
        self.assertEqual((sensors.Port_A, sensors.Port_B), (None, ev3_dc.EV3_LARGE_MOTOR))
        self.assertEqual((sensors.Port_C, sensors.Port_D), (ev3_dc.EV3_LARGE_MOTOR, None))

    def test_battery(self):
        battery = self.brick.battery
        self.assertAlmostEqual(battery.voltage, 8.0, delta=0.1)
        self.assertEqual(battery.percentage, 100)

    def test_the_clock_counts_microseconds(self):
        host, brick = time.monotonic(), self.clock_us()
        self.wait_until(lambda: time.monotonic() - host > 0.5, "half a second is over")
        passed = (time.monotonic() - host) * 1e6
        self.assertLess(abs(self.clock_us() - brick - passed), 40_000)

    def test_a_motor_goes_where_it_is_told(self):
        motor = ev3_dc.Motor(ev3_dc.PORT_B, ev3_obj=self.brick)
        motor.start_move_by(180, speed=30, brake=True)
        self.wait_until(lambda: not motor.busy, "the motor has done its way")
        self.wait_until(lambda: len({motor.position for _ in range(10)}) == 1, "the motor rests")
        self.assertAlmostEqual(motor.position, 180, delta=12)
        self.assertEqual(self.counts(), (motor.position, 0))

    def test_a_motor_goes_to_a_place_that_the_brick_calculates(self):
        motor = ev3_dc.Motor(ev3_dc.PORT_C, ev3_obj=self.brick)
        motor.start_move_to(-120, speed=25, brake=True)
        self.wait_until(lambda: not motor.busy, "the motor has done its way")
        self.wait_until(lambda: len({motor.position for _ in range(10)}) == 1, "the motor rests")
        self.assertAlmostEqual(motor.position, -120, delta=12)

    def test_the_gyro_feels_a_right_turn_as_positive(self):
        gyro = ev3_dc.Gyro(ev3_dc.PORT_2, ev3_obj=self.brick)
        left, right = (ev3_dc.Motor(port, ev3_obj=self.brick) for port in (ev3_dc.PORT_B, ev3_dc.PORT_C))
        left.start_move(speed=30, direction=1)
        right.start_move(speed=30, direction=-1)
        # 315 degrees per second of each wheel, 28 mm, on a track of 112 mm: 158 degrees per second.
        self.wait_until(lambda: gyro.state.rate > 130, "a right turn is felt")
        self.wait_until(lambda: gyro.state.angle > 40, "an angle is felt")
        left.stop()
        right.stop()

    def test_the_ultrasonic_sensor_sees_the_wall(self):
        # ev3-dc's own class asks for an NXT's sensor.
        codes = (
            ev3_dc.opInput_Device, ev3_dc.READY_SI, ev3_dc.LCX(0), ev3_dc.PORT_4,
            ev3_dc.LCX(ev3_dc.EV3_ULTRASONIC), ev3_dc.LCX(0), ev3_dc.LCX(1), ev3_dc.GVX(0))
        self.assertAlmostEqual(self.ask("<f", *codes)[0], 80.0, delta=2.0)

    def test_an_unknown_command_is_an_error_and_the_next_one_is_not(self):
        with self.assertRaises(ev3_dc.exceptions.DirCmdError):
            self.ask("<i", ev3_dc.opFile, b"\x1f", ev3_dc.GVX(0))
        self.assertEqual(self.counts(), (0, 0))

    def test_a_mailbox_takes_a_message(self):
        message = b"\x09estimate\0" + struct.pack("<H", 24) + bytes(24)
        self.assertEqual(self.brick.send_system_cmd(ev3_dc.WRITEMAILBOX + message), b"\0")


if __name__ == "__main__":
    unittest.main()
