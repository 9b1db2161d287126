"""Message signing against pymavlink: both ways, over UDP and TCP, and across restarts of the station."""

import os
import subprocess
import tempfile
import unittest

from harness import Peer, Station, events_named, last_health, refusals, stamp_of, stamp_of_now

MINUTE = 6_000_000
SIGNING = '{ key_file = "station.key", link_id = 3 }'
SCHEMES = ("udp", "tcp")


class Signing(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name
        subprocess.run(
            [os.environ["POSEBRIDGE"], "key", "new", "station.key"],
            cwd=self.folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        with open(os.path.join(self.folder, "station.key")) as file:
            self.key = bytes.fromhex(file.read().strip())

    def station(self, name="run", scheme="udp", signing=SIGNING):
        station = Station(self.folder, name, scheme, signing)
        self.addCleanup(station.kill)
        return station

    def peer(self, station, scheme="udp", **signing):
        peer = Peer(station, scheme, **signing)
        self.addCleanup(peer.close)
        return peer

    def drive(self, peer):
        """A few telegrams, each answered with an estimate."""
        for step in range(10):
            peer.wheel_ticks(5_000_000 + 50_000 * step, 4 * step, 4 * step)
            peer.hear(lambda message: message.get_type() == "PB_PLANAR_POSE")

    def test_each_believes_the_other(self):
        for scheme in SCHEMES:
            with self.subTest(scheme):
                station = self.station(f"both-{scheme}", scheme)
                peer = self.peer(station, scheme, key=self.key)
                peer.heartbeat()
                peer.ping()
                self.drive(peer)
                peer.hear_seconds(2)
                events = station.stop()
                self.assertEqual(peer.failures, [])
                self.assertTrue(all(frame[2] == 1 for frame, _ in peer.heard))
                self.assertTrue(all(frame[-13] == 3 for frame, _ in peer.heard))
                stamps = [stamp_of(frame) for frame, _ in peer.heard]
                self.assertEqual(stamps, sorted(set(stamps)))
                self.assertEqual(refusals(events), [])
                self.assertEqual(last_health(events, "refused_frames"), 0)
                self.assertEqual(last_health(events, "frames_lost"), 0)
                self.assertTrue(events_named(events, "robot_seen"))
                self.assertEqual(len(events_named(events, "observed")), 10)

    def test_what_must_not_be_believed_is_refused_and_counted(self):
        for scheme in SCHEMES:
            with self.subTest(scheme):
                station = self.station(f"refused-{scheme}", scheme)
                peer = self.peer(station, scheme, key=self.key)
                first = peer.heartbeat()
                peer.ping()
                unsigned = self.peer(station, scheme)
                unsigned.heartbeat()
                unsigned.wheel_ticks(1, 9_000, 0)
                peer.ping()
                wrong = self.peer(station, scheme, key=bytes(32))
                wrong.wheel_ticks(2, 9_000, 0)
                peer.ping()
                replayed = self.peer(station, scheme)
                replayed.write(first)
                peer.ping()
                stale = self.peer(station, scheme, key=self.key, link_id=9, timestamp=stamp_of_now() - 2 * MINUTE)
                stale.wheel_ticks(3, 9_000, 0)
                peer.hear_seconds(1)
                self.drive(peer)
                peer.hear_seconds(2)
                events = station.stop()
                # Over TCP every client is a connection of its own, so what they sent may be read in another order.
                expected = ["invalid", "replayed", "stale", "unsigned", "unsigned"]
                self.assertEqual(sorted(refusals(events)), expected)
                self.assertEqual(last_health(events, "refused_frames"), 5)
                self.assertEqual(last_health(events, "frames_lost"), 0)
                self.assertEqual(len(events_named(events, "observed")), 10)

    def test_a_radio_may_speak_without_a_key(self):
        station = self.station()
        peer = self.peer(station, key=self.key)
        peer.heartbeat()
        peer.ping()
        radio = self.peer(station)
        radio.std.radio_status_send(100, 90, 80, 10, 11, 1, 2)
        radio.std.attitude_send(1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        peer.hear_seconds(1)
        peer.ping()
        self.assertEqual(refusals(station.stop()), ["unsigned"])

    def test_signing_that_is_not_required_refuses_only_wrong_signatures(self):
        station = self.station(signing='{ key_file = "station.key", required = false }')
        peer = self.peer(station)
        peer.heartbeat()
        peer.ping()
        wrong = self.peer(station, key=bytes(32))
        wrong.heartbeat()
        peer.hear_seconds(1)
        peer.ping()
        self.assertEqual(refusals(station.stop()), ["invalid"])

    def restarted(self, end):
        """What a station refuses after its end and a new start, and how the stamps of both go on."""
        first = self.station("first")
        peer = self.peer(first, key=self.key)
        peer.heartbeat()
        peer.ping()
        peer.hear_seconds(2)
        recorded = list(peer.sent)
        end(first)

        second = self.station("second")
        # Without a key, for what is said was signed long ago.
        attacker = self.peer(second)
        for frame in recorded:
            attacker.write(frame)
        again = self.peer(second, key=self.key, timestamp=max(stamp_of_now(), peer.std.signing.timestamp))
        again.own.signing.stream_timestamps = peer.std.signing.stream_timestamps
        # A station that was cut off refuses what may have been said before; it takes no longer than that.
        again.std.signing.timestamp += 100_000
        again.heartbeat()
        again.ping()
        self.drive(again)
        events = second.stop()
        self.assertEqual(again.failures, [])
        self.assertEqual(set(refusals(events)), {"replayed"})
        self.assertEqual(len(refusals(events)), len(recorded))
        before = max(stamp_of(frame) for frame, _ in peer.heard)
        self.assertGreater(min(stamp_of(frame) for frame, _ in again.heard), before)

    def test_a_restart_forgets_nothing(self):
        self.restarted(lambda station: station.stop())

    def test_a_crash_forgets_nothing(self):
        self.restarted(lambda station: station.kill())

    def test_without_a_key_nothing_is_signed_and_everybody_is_believed(self):
        station = self.station(signing=None)
        peer = self.peer(station)
        peer.heartbeat()
        peer.ping()
        self.drive(peer)
        self.assertEqual(refusals(station.stop()), [])
        self.assertTrue(all(frame[2] == 0 for frame, _ in peer.heard))


if __name__ == "__main__":
    unittest.main()
