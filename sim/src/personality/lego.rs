//! Common parts of the NXT and EV3 emulations: a firmware pass, length-prefixed telegrams, a radio with turn-around time, and the
//! estimate in the program's mailbox.
//!
//! # Model of the radio
//! ```text
//! one buffer is on the air, others wait; a telegram for which there is none is dropped
//! on the air for   turn-around, if something was received since the last turn, + bytes * time of a byte
//! ```
//! # Estimate in a mailbox
//! ```text
//! 0 u32 tick_ms    4 f32 x_m    8 f32 y_m    12 f32 heading_rad    16 f32 sigma_m    20 u8 flags    21 u8 reset_counter    22 u16 sequence
//! ```
//! Little-endian, 24 bytes. `tick_ms` is the brick's own clock; flag bit 0 says that the position is valid, bit 1 that the
//! heading is. An NXT mailbox adds a zero byte at the end, which may be there or not. NXT: inbox 0; EV3: the mailbox called
//! `estimate`.
//!
//! # Sources
//! LEGO's figure of about 30 ms for the Bluetooth chip of the NXT, which all its hosts report; the firmware's send buffers.

use std::collections::VecDeque;
use std::fmt::Debug;
use std::ops::RangeInclusive;

use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{Arena, BrickClock, Heading, Meters, Pose, TimeDelta, Timestamp};

use super::plugged_sensors::PluggedSensors;
use crate::firmware::Program;
use crate::sensors::SensorBoard;
use crate::wheels::PerWheel;

pub(super) trait LegoFirmware: Debug + Send + Sync {
    /// One pass of 1 ms; returns the duty of both motors.
    fn step(&mut self, pass: &mut FirmwarePass<'_>) -> PerWheel<f64>;
    /// Receives bytes from the station; `now` is world time.
    fn receive(&mut self, now: TimeDelta, bytes: &[u8]);
    fn reopen(&mut self);
    /// Power cycle: everything is reset except the brick's name.
    fn restart(&mut self, pass: &mut FirmwarePass<'_>);
    /// Stops and starts the program: motors, counters and sensors are reset.
    fn restart_program(&mut self, pass: &mut FirmwarePass<'_>);
}

/// One pass of a brick's firmware and everything that it can access.
pub(super) struct FirmwarePass<'a> {
    /// World time, for the timers of other chips on the board.
    pub(super) sim_time: TimeDelta,
    pub(super) now: Timestamp<BrickClock>,
    pub(super) board: &'a mut SensorBoard,
    pub(super) senses: &'a PluggedSensors,
    pub(super) battery_v: f64,
    pub(super) program: &'a mut Program,
    pub(super) outgoing: &'a mut VecDeque<Vec<u8>>,
    /// The estimates that the program took from its mailbox: instant and pose.
    pub(super) estimates: &'a mut Vec<(Timestamp<BrickClock>, Pose<Arena>)>,
}

impl FirmwarePass<'_> {
    pub(super) fn counts(&self) -> PerWheel<i64> {
        self.board.counts()
    }

    pub(super) const fn tick_ms(&self) -> u32 {
        (self.now.as_micros() / 1_000) as u32
    }

    pub(super) fn apply_mail(&mut self, message: &[u8]) {
        if let Some((stamp, pose)) = estimate_from(message) {
            self.estimates.push((self.program.apply_estimate(self.now, stamp, pose), pose));
        }
    }

    pub(super) fn run_program(&mut self) -> PerWheel<f64> {
        self.program.step(self.now, self.board.counts())
    }

    /// A pass without a running program.
    pub(super) fn idle(&mut self) {
        self.program.observe_odometry(self.now, self.board.counts());
    }
}

/// Receive buffer of the brick and the link before it; the excess of a sender without flow control is lost.
pub(super) const RECEIVE_BYTES: usize = 16 * 1024;
/// Silence after which a new telegram begins. Our choice: a station that lost synchronisation waits a little longer.
const RESYNC_TIMEOUT: TimeDelta = TimeDelta::from_millis(100);

/// Splits bytes into telegrams, each prefixed with its length as LE16.
///
/// There is no checksum and no start byte. After an invalid length, or a telegram that stays incomplete, everything is discarded until
/// the line was silent for 100 ms.
#[derive(Clone, Debug, Default)]
pub(super) struct TelegramBuffer {
    pub(super) bytes: Vec<u8>,
    last_received: TimeDelta,
    is_lost: bool,
}

impl TelegramBuffer {
    pub(super) fn receive(&mut self, now: TimeDelta, bytes: &[u8]) {
        if now - self.last_received >= RESYNC_TIMEOUT {
            self.clear();
        }
        self.last_received = now;
        if !self.is_lost {
            let free_bytes = RECEIVE_BYTES - self.bytes.len().min(RECEIVE_BYTES);
            self.bytes.extend(bytes.iter().take(free_bytes));
        }
    }

    /// The next complete telegram without its length, which must be within `lengths`.
    pub(super) fn next(&mut self, lengths: RangeInclusive<usize>) -> Option<Vec<u8>> {
        let length = usize::from(u16::from_le_bytes(*self.bytes.first_chunk()?));
        if !lengths.contains(&length) {
            self.abandon();
        }
        (self.bytes.len() >= 2 + length).then(|| self.bytes.drain(..2 + length).skip(2).collect())
    }

    /// Discards everything until the line was silent.
    pub(super) fn abandon(&mut self) {
        self.bytes.clear();
        self.is_lost = true;
    }

    pub(super) fn clear(&mut self) {
        self.bytes.clear();
        self.is_lost = false;
    }
}

pub(super) fn with_length(telegram: &[u8]) -> Vec<u8> {
    [&(telegram.len() as u16).to_le_bytes()[..], telegram].concat()
}

/// A half-duplex radio with a turn-around time; see the module.
#[derive(Clone, Debug)]
pub(super) struct Radio {
    turn_around: TimeDelta,
    byte_s: f64,
    buffers: usize,
    /// Received something since the last turn-around.
    must_turn: bool,
    /// The telegram in transmission and its end, in world time.
    on_air: Option<(Vec<u8>, TimeDelta)>,
    queued: VecDeque<Vec<u8>>,
}

impl Radio {
    /// A radio that sends a byte in `byte_s` seconds and holds `buffers` telegrams, the one in transmission included.
    pub(super) const fn new(turn_around: TimeDelta, byte_s: f64, buffers: usize) -> Self {
        Self { turn_around, byte_s, buffers, must_turn: true, on_air: None, queued: VecDeque::new() }
    }

    pub(super) fn reset(&mut self) {
        *self = Self::new(self.turn_around, self.byte_s, self.buffers);
    }

    pub(super) const fn receive(&mut self) {
        self.must_turn = true;
    }

    pub(super) fn is_idle(&self) -> bool {
        self.on_air.is_none() && self.queued.is_empty()
    }

    /// Queues a telegram; drops it if no buffer is free.
    pub(super) fn send(&mut self, bytes: Vec<u8>) {
        if self.queued.len() + usize::from(self.on_air.is_some()) < self.buffers {
            self.queued.push_back(bytes);
        }
    }

    /// The telegram whose transmission is complete at `now`, in world time.
    pub(super) fn step(&mut self, now: TimeDelta) -> Option<Vec<u8>> {
        if self.on_air.is_none()
            && let Some(bytes) = self.queued.pop_front()
        {
            let turn = if std::mem::take(&mut self.must_turn) { self.turn_around } else { TimeDelta::ZERO };
            let sending = TimeDelta::from_secs_f64(bytes.len() as f64 * self.byte_s);
            self.on_air = Some((bytes, now + turn + sending));
        }
        self.on_air.take_if(|(_, done)| *done <= now).map(|(bytes, _)| bytes)
    }
}

const LENGTH: usize = 24;
/// Flags of a valid position and heading.
const USABLE: u8 = 0b11;

/// `None` if the message is not a usable estimate.
fn estimate_from(message: &[u8]) -> Option<(WireStamp, Pose<Arena>)> {
    let payload = message.get(..LENGTH)?;
    let is_complete = matches!(message.get(LENGTH..), Some([] | [0]));
    let flags = *payload.get(20)?;
    if !is_complete || flags & USABLE != USABLE {
        return None;
    }
    let word = |offset: usize| Some(*payload.get(offset..)?.first_chunk::<4>()?);
    let real = |offset: usize| Some(f64::from(f32::from_le_bytes(word(offset)?)));
    let stamp = WireStamp::Millis32(u32::from_le_bytes(word(0)?));
    let (x, y, heading) = (real(4)?, real(8)?, real(12)?);
    // A heading that is no number has no place on the circle.
    let is_finite = x.is_finite() && y.is_finite() && heading.is_finite();
    is_finite.then(|| {
        let pose = Pose::new(Meters(x), Meters(y), Heading::from_rad(heading));
        (stamp, pose)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TELEGRAM: [u8; 4] = [2, 0, 0, 0x0B];
    const FRAME: [u8; 9] = [7, 0, 42, 0, 0, 4, 0, 0x8F, 0x60];

    fn received(buffer: &mut TelegramBuffer, millis: i64, bytes: &[u8]) -> Vec<Vec<u8>> {
        buffer.receive(TimeDelta::from_millis(millis), bytes);
        std::iter::from_fn(|| buffer.next(2..=128)).collect()
    }

    #[test]
    fn telegrams_come_together_from_any_pieces_and_after_a_lost_byte_and_a_pause() {
        for telegram in [&TELEGRAM[..], &FRAME] {
            for size in 1..=2 * telegram.len() {
                let mut buffer = TelegramBuffer::default();
                let stream = telegram.repeat(2);
                let found: Vec<_> = stream.chunks(size).flat_map(|chunk| received(&mut buffer, 1, chunk)).collect();
                assert_eq!(found, [&telegram[2..], &telegram[2..]], "pieces of {size}");
            }
            for lost in 0..telegram.len() {
                let mut buffer = TelegramBuffer::default();
                received(&mut buffer, 1_000, &[&telegram[..lost], &telegram[lost + 1..]].concat());
                assert_eq!(received(&mut buffer, 1_100, telegram), [&telegram[2..]], "byte {lost} lost");
            }
        }
    }

    #[test]
    fn a_length_that_cannot_be_is_not_believed_until_the_line_was_quiet() {
        for length in [0, 1, 129, 0xFFFF_u16] {
            let mut buffer = TelegramBuffer::default();
            assert!(received(&mut buffer, 1_000, &length.to_le_bytes()).is_empty(), "{length}");
            assert!(received(&mut buffer, 1_050, &TELEGRAM).is_empty(), "{length}");
            assert!(received(&mut buffer, 1_149, &TELEGRAM).is_empty(), "{length}");
            assert_eq!(received(&mut buffer, 1_249, &TELEGRAM).len(), 1, "{length}");
        }
    }

    #[test]
    fn a_burst_waits_for_its_turn_up_to_a_limit() {
        assert_eq!(received(&mut TelegramBuffer::default(), 1_000, &TELEGRAM.repeat(5_000)).len(), 4_096);
    }

    /// Written by hand: 1000 ms, 1.5 m, -0.5 m, 0.25 rad, sigma 0.0078125 m, flags 3, resets 7, sequence 258, and the mailbox's zero.
    const MESSAGE: [u8; 25] =
        [0xe8, 0x03, 0, 0, 0, 0, 0xc0, 0x3f, 0, 0, 0, 0xbf, 0, 0, 0x80, 0x3e, 0, 0, 0, 0x3c, 3, 7, 2, 1, 0];

    #[test]
    fn an_estimate_is_read_with_or_without_the_zero_at_its_end_and_what_is_incomplete_or_not_finite_is_none() {
        for message in [&MESSAGE[..], &MESSAGE[..24]] {
            let (stamp, pose) = estimate_from(message).unwrap();
            assert_eq!(stamp, WireStamp::Millis32(1_000));
            assert_eq!((pose.x.0, pose.y.0, pose.heading.rad()), (1.5, -0.5, 0.25));
        }
        let changed = |at: usize, bytes: &[u8]| {
            let mut message = MESSAGE.to_vec();
            message[at..at + bytes.len()].copy_from_slice(bytes);
            message
        };
        let [none, position, heading] = [0, 1, 2].map(|flags| changed(20, &[flags]));
        let (short, long, nan) = (&MESSAGE[..23], [&MESSAGE[..], &[0]].concat(), changed(12, &f32::NAN.to_le_bytes()));
        for message in [short, &long, &none, &position, &heading, &nan] {
            assert_eq!(estimate_from(message), None, "{message:02x?}");
        }
    }
}
