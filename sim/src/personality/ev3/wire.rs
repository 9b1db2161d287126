//! The EV3's side of the link: splits bytes into frames, and answers the handshake of a client on the network.
//!
//! ```text
//! frame    LE16 length of what follows, LE16 counter, type, ..        the same on RFCOMM and TCP
//! network  beacon by UDP > the client connects by TCP and sends `GET /target?sn=..VMTP1.0 .. Protocol: EV3` > `Accept:EV340`
//! ```
//! Bytes that begin with `GE` cannot be a frame: it would be longer than any.
//!
//! # Sources
//! LEGO MINDSTORMS EV3 communication developer kit; what the ev3-dc client expects of a brick on the network.

use posebridge_telemetry::TimeDelta;

use super::super::lego::{Radio, TelegramBuffer, with_length};

/// Also the Bluetooth address: LEGO's block, with an invented number.
pub(super) const SERIAL_NUMBER: &str = "0016530B0E03";
pub(super) const FACTORY_NAME: &str = "EV3";
/// Start and end of a handshake request, and the reply.
const GREETING: &[u8] = b"GET ";
const PROTOCOL: &[u8] = b"Protocol:";
const GREETING_END: &[u8] = b"EV3";
const WELCOME: &[u8] = b"Accept:EV340\r\n\r\n";
const GREETING_BYTES: usize = 256;
/// Length of a frame after its length field: at least counter and type, at most the firmware's buffer.
const FRAME_BYTES: std::ops::RangeInclusive<usize> = 3..=1_024;
/// Queued replies; clients match them by counter, so that several can be outstanding.
const SEND_BUFFERS: usize = 16;
/// The UDP datagram to port 3015 with which a brick announces its TCP port.
pub fn beacon(tcp_port: u16) -> Vec<u8> {
    format!("Serial-Number: {SERIAL_NUMBER}\r\nPort: {tcp_port}\r\nName: {FACTORY_NAME}\r\nProtocol: EV3\r\n")
        .into_bytes()
}

#[derive(Clone, Debug)]
pub(super) struct Ev3Wire {
    received: TelegramBuffer,
    pub(super) radio: Radio,
}

impl Ev3Wire {
    pub(super) fn new(turn_around: TimeDelta) -> Self {
        Self {
            received: TelegramBuffer::default(),
            // Next to the turn-around the time of a byte is nothing.
            radio: Radio::new(turn_around, 0.0, SEND_BUFFERS),
        }
    }

    pub(super) fn reopen(&mut self) {
        self.received.clear();
        self.radio.reset();
    }

    pub(super) fn receive(&mut self, now: TimeDelta, bytes: &[u8]) {
        self.radio.receive();
        self.received.receive(now, bytes);
    }

    pub(super) fn next_frame(&mut self) -> Option<Vec<u8>> {
        if self.received.bytes.starts_with(GREETING) {
            self.answer_greeting();
            return None;
        }
        if GREETING.starts_with(&self.received.bytes) {
            return None;
        }
        self.received.next(FRAME_BYTES)
    }

    /// Queues a frame; drops it if no buffer is free.
    pub(super) fn send(&mut self, frame: &[u8]) {
        self.radio.send(with_length(frame));
    }

    fn answer_greeting(&mut self) {
        let received = &mut self.received.bytes;
        // The line itself may name the brick; the protocol comes last.
        let protocol = received.windows(PROTOCOL.len()).position(|text| text == PROTOCOL);
        let mut ends = received.windows(GREETING_END.len()).enumerate().filter(|(_, text)| *text == GREETING_END);
        let end = protocol.and_then(|protocol| ends.find(|(at, _)| *at > protocol));
        if let Some((at, _)) = end {
            let rest = received.split_off(at + GREETING_END.len());
            let is_line_end = |byte: &u8| matches!(byte, b'\r' | b'\n');
            *received = rest.into_iter().skip_while(is_line_end).collect();
            self.radio.send(WELCOME.to_vec());
        } else if received.len() > GREETING_BYTES {
            self.received.abandon();
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
    fn a_client_on_the_network_is_greeted_in_any_pieces() {
        let greeting = b"GET /target?sn=0016530B0E03VMTP1.0\nProtocol: EV3";
        for size in [1, 2, 7, greeting.len()] {
            let mut wire = Ev3Wire::new(TimeDelta::ZERO);
            let mut sent = Vec::new();
            for (at, chunk) in (1..).zip(greeting.chunks(size)) {
                wire.receive(ms(at), chunk);
                assert_eq!(wire.next_frame(), None);
                sent.extend(wire.radio.step(ms(at)));
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
            for (at, bytes, is_received) in [(1, bytes.as_slice(), false), (2, &FRAME, false), (102, &FRAME, true)] {
                wire.receive(ms(at), bytes);
                assert_eq!(wire.next_frame().is_some(), is_received, "{at} ms");
            }
        }
    }

    #[test]
    fn the_beacon_has_the_lines_that_clients_look_for() {
        let expected = "Serial-Number: 0016530B0E03\r\nPort: 5555\r\nName: EV3\r\nProtocol: EV3\r\n";
        assert_eq!(beacon(5_555), expected.as_bytes());
    }
}
