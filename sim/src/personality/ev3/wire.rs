//! The EV3's side of the link: frames out of bytes, and the greeting of a client on the network.
//!
//! ```text
//! frame    LE16 length of what follows, LE16 counter, type, ..        the same on RFCOMM and TCP
//! network  beacon by UDP > the client connects by TCP and sends `GET /target?sn=..VMTP1.0 .. Protocol: EV3` > `Accept:EV340`
//! ```
//! What begins with `GE` cannot be a frame: it would be longer than any. After a length that cannot be, everything is thrown away until the
//! line was quiet for 100 ms, and so is a frame whose end does not come.
//!
//! # Sources
//! LEGO MINDSTORMS EV3 communication developer kit; what the ev3-dc client expects of a brick on the network.

use posebridge_telemetry::TimeDelta;

use super::super::radio::{Radio, RadioSettings};

/// The serial number, which is the address on Bluetooth: LEGO's block, a made-up brick in it.
pub(super) const SERIAL_NUMBER: &str = "0016530B0E03";
/// The name that comes from the factory.
pub(super) const FACTORY_NAME: &str = "EV3";
/// How a greeting begins, what ends it, and the answer.
const GREETING: &[u8] = b"GET ";
const GREETING_END: &[u8] = b"EV3";
const WELCOME: &[u8] = b"Accept:EV340\r\n\r\n";
/// Longest greeting that is waited for.
const GREETING_BYTES: usize = 256;
/// What a frame holds behind its length: counter and type at least, and no more than the firmware's buffer.
const FRAME_BYTES: std::ops::RangeInclusive<usize> = 3..=1_024;
/// Bytes that wait to be handled, here and before the brick.
const RECEIVE_BYTES: usize = 16 * 1024;
/// Answers that wait to be sent; they are matched by their counter, so that many may be under way.
const SEND_BUFFERS: usize = 16;
/// After this much silence a new frame begins.
const RESYNC_TIMEOUT: TimeDelta = TimeDelta::from_millis(100);

/// What a brick that listens on a TCP port of the network says by UDP, to port 3015.
pub fn beacon(tcp_port: u16) -> Vec<u8> {
    format!("Serial-Number: {SERIAL_NUMBER}\r\nPort: {tcp_port}\r\nName: {FACTORY_NAME}\r\nProtocol: EV3\r\n")
        .into_bytes()
}

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Ev3Wire {
    received: Vec<u8>,
    last_received: TimeDelta,
    is_lost: bool,
    radio: Radio,
}

impl Ev3Wire {
    /// An unused link.
    pub(super) const fn new(turn_around: TimeDelta) -> Self {
        Self {
            received: Vec::new(),
            last_received: TimeDelta::ZERO,
            is_lost: false,
            radio: Radio::new(RadioSettings {
                turn_around,
                // Next to the turn-around nothing.
                byte_s: 0.0,
                buffers: SEND_BUFFERS,
            }),
        }
    }

    /// The link has a new peer.
    pub(super) fn reopen(&mut self) {
        self.received.clear();
        self.is_lost = false;
        self.radio.reset();
    }

    /// Takes bytes that arrive at `now`, the time since the beginning of the world.
    pub(super) fn receive(&mut self, now: TimeDelta, bytes: &[u8]) {
        if now - self.last_received >= RESYNC_TIMEOUT {
            self.received.clear();
            self.is_lost = false;
        }
        self.last_received = now;
        self.radio.receive();
        let room = RECEIVE_BYTES - self.received.len().min(RECEIVE_BYTES);
        if !self.is_lost {
            self.received.extend(bytes.iter().take(room));
        }
    }

    /// The next whole frame without its length.
    pub(super) fn next_frame(&mut self) -> Option<Vec<u8>> {
        if self.received.starts_with(GREETING) {
            self.answer_greeting();
            return None;
        }
        let length = usize::from(u16::from_le_bytes(*self.received.first_chunk()?));
        let is_greeting = GREETING.starts_with(&self.received);
        if !FRAME_BYTES.contains(&length) {
            if !is_greeting {
                self.received.clear();
                self.is_lost = true;
            }
            return None;
        }
        if self.received.len() < 2 + length {
            return None;
        }
        Some(self.received.drain(..2 + length).skip(2).collect())
    }

    /// Sends a frame; one for which there is no buffer is dropped.
    pub(super) fn send(&mut self, frame: &[u8]) {
        let length = (frame.len() as u16).to_le_bytes();
        self.radio.send([&length[..], frame].concat());
    }

    /// What has been sent at `now`.
    pub(super) fn step(&mut self, now: TimeDelta) -> Option<Vec<u8>> {
        self.radio.step(now)
    }

    fn answer_greeting(&mut self) {
        let windows = self.received.windows(GREETING_END.len());
        // The line itself may name the brick; the protocol comes last.
        let protocol = self.received.windows(9).position(|text| text == b"Protocol:");
        let end = windows
            .enumerate()
            .filter(|(at, text)| protocol.is_some_and(|from| *at > from) && *text == GREETING_END)
            .map(|(at, _)| at + GREETING_END.len())
            .next();
        if let Some(end) = end {
            let rest = self.received.split_off(end);
            let is_line_end = |byte: &u8| matches!(byte, b'\r' | b'\n');
            self.received = rest.into_iter().skip_while(is_line_end).collect();
            self.radio.send(WELCOME.to_vec());
        } else if self.received.len() > GREETING_BYTES {
            self.received.clear();
            self.is_lost = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(count: i64) -> TimeDelta {
        TimeDelta::from_millis(count)
    }

    const FRAME: [u8; 9] = [7, 0, 42, 0, 0, 4, 0, 0x8F, 0x60];

    #[test]
    fn a_frame_comes_together_from_any_pieces() {
        for size in 1..=18 {
            let mut wire = Ev3Wire::new(TimeDelta::ZERO);
            let mut found = Vec::new();
            for piece in FRAME.repeat(2).chunks(size) {
                wire.receive(ms(1), piece);
                found.extend(std::iter::from_fn(|| wire.next_frame()));
            }
            assert_eq!(found, [&FRAME[2..], &FRAME[2..]], "pieces of {size}");
        }
    }

    #[test]
    fn after_a_lost_byte_and_a_pause_it_is_well_again() {
        for lost in 0..FRAME.len() {
            let mut wire = Ev3Wire::new(TimeDelta::ZERO);
            let mut bytes = FRAME.to_vec();
            bytes.remove(lost);
            wire.receive(ms(1_000), &bytes);
            while wire.next_frame().is_some() {}
            wire.receive(ms(1_101), &FRAME);
            assert_eq!(wire.next_frame().unwrap(), FRAME[2..], "byte {lost} lost");
        }
    }

    #[test]
    fn a_client_on_the_network_is_greeted_in_any_pieces() {
        let greeting = b"GET /target?sn=0016530B0E03VMTP1.0\nProtocol: EV3";
        for size in [1, 2, 7, greeting.len()] {
            let mut wire = Ev3Wire::new(TimeDelta::ZERO);
            let mut sent = Vec::new();
            for (at, piece) in (1..).zip(greeting.chunks(size)) {
                wire.receive(ms(at), piece);
                assert_eq!(wire.next_frame(), None);
                sent.extend(wire.step(ms(at)));
            }
            assert_eq!(sent, [b"Accept:EV340\r\n\r\n"], "pieces of {size}");
            wire.receive(ms(60), &FRAME);
            assert_eq!(wire.next_frame().unwrap(), FRAME[2..]);
        }
    }

    #[test]
    fn a_greeting_without_end_and_a_length_that_cannot_be_are_thrown_away() {
        for bytes in [&[b"GET ".as_slice(), &[b'x'; 300]].concat(), &vec![2, 0, 1, 1], &vec![1, 4]] {
            let mut wire = Ev3Wire::new(TimeDelta::ZERO);
            wire.receive(ms(1), bytes);
            assert_eq!(wire.next_frame(), None);
            wire.receive(ms(2), &FRAME);
            assert_eq!(wire.next_frame(), None);
            wire.receive(ms(102), &FRAME);
            assert_eq!(wire.next_frame().unwrap(), FRAME[2..]);
        }
    }

    #[test]
    fn the_beacon_has_the_lines_that_clients_look_for() {
        let text = String::from_utf8(beacon(5_555)).unwrap();
        let lines: Vec<&str> = text.split_terminator("\r\n").collect();
        assert_eq!(lines, ["Serial-Number: 0016530B0E03", "Port: 5555", "Name: EV3", "Protocol: EV3"]);
    }
}
