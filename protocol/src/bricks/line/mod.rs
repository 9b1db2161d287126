//! Boards that print: lines of text with a declared layout, as an Arduino sketch or a student's board writes them.
//!
//! The station only listens; if it is told to, it prints the estimate back. Gets bytes from a link and gives messages. SPEC.md beside this
//! file says what passes. Without checksums a damaged digit is believed, so that the time at least is held against the host's.

mod clock;
mod estimate;
mod row;
mod settings;

use std::collections::BTreeSet;

use posebridge_telemetry::{
    Address, Celsius, ChannelName, Defect, EncoderTicks, HostClock, Meters, RadiansPerSecond, SourceHealth, Span, Stamp,
};

use self::clock::{BoardClock, LentClock};
use self::row::{Flaw, Proof, Row, Time};
pub use self::settings::{
    Checksum, Column, LayoutError, LineLayout, LineSettings, QUANTITIES, Quantity, Sense, Separator,
};
use super::pulse::Pulse;
use super::splitter::{Cut, Splitter, printable};
use super::{BrickCodec, BrickSettings, Heard, ONLY_BRICK};
use crate::framing::ScanCounters;
use crate::message::{Inertial, Message, WheelTicks, WireStamp};

/// A line that stops for so long was cut off: a board at 9600 baud prints the longest one in 270 ms.
const QUIET: Span = Span::from_millis(500);
/// So many names that mean nothing here are told.
const MOST_UNKNOWN: usize = 8;
/// Longest line, bytes without its end: three times NMEA's 82, and more than Fast Robots' 151 byte strings.
const LONGEST: usize = 256;
/// The channel of the only thermometer.
const THERMOMETER: &[u8] = b"temperature";
/// MAV_SEVERITY_WARNING, _INFO.
const WARNING: u8 = 4;
const INFO: u8 = 6;
/// What [`Defect`]s call a line, which has no number.
const LINE_ID: u32 = 0;
/// Counts that fell to zero from further than so many steps of the last change were set to zero.
const CHANGES_TO_ZERO: i64 = 3;
/// Counts near zero may have rolled there.
const NEAR_ZERO: i64 = 10;

type Sink<'a> = dyn FnMut(Heard<'_>) + 'a;

/// The state of one link to a board that prints.
#[derive(Debug)]
struct Line {
    settings: LineSettings,
    splitter: Splitter<LONGEST>,
    last_byte: Stamp<HostClock>,
    /// The next line may be the end of one whose beginning is missing.
    is_cut: bool,
    clock: BoardClock,
    lent: LentClock,
    wheels: Wheels,
    pulse: Pulse,
    counts: ScanCounters,
    /// A bad line was quoted since the link came up.
    is_flaw_told: bool,
    unknown: BTreeSet<String>,
    last_estimate: Option<Stamp<HostClock>>,
}

pub(super) fn open(settings: &BrickSettings) -> Box<dyn BrickCodec> {
    Box::new(Line {
        settings: settings.line.clone(),
        splitter: Splitter::default(),
        last_byte: Stamp::ZERO,
        is_cut: true,
        clock: BoardClock::default(),
        lent: LentClock::default(),
        wheels: Wheels::default(),
        pulse: Pulse::default(),
        counts: ScanCounters::default(),
        is_flaw_told: false,
        unknown: BTreeSet::new(),
        last_estimate: None,
    })
}

impl BrickCodec for Line {
    fn begin(&mut self, _now: Stamp<HostClock>) {
        self.splitter.clear();
        self.is_cut = true;
        self.is_flaw_told = false;
        self.lent = LentClock::default();
    }

    fn push(&mut self, now: Stamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(Heard<'_>)) {
        self.last_byte = now;
        // The splitter lends its line while it is read, which needs the rest of the state.
        let mut splitter = std::mem::take(&mut self.splitter);
        splitter.push(bytes, &mut |cut| match cut {
            Cut::Line(line) => self.hear(now, line, sink),
            Cut::TooLong(bytes) => self.refuse_long(bytes, sink),
        });
        self.splitter = splitter;
    }

    fn deadline(&self) -> Option<Stamp<HostClock>> {
        (self.splitter.waiting_bytes() > 0).then(|| self.last_byte + QUIET)
    }

    fn tick(&mut self, now: Stamp<HostClock>, sink: &mut dyn FnMut(Heard<'_>)) {
        if self.deadline().is_some_and(|due| due <= now) {
            let bytes = self.splitter.clear();
            self.is_cut = true;
            self.counts.stalls += 1;
            self.counts.garbage_bytes += u64::from(bytes);
            sink(Heard::Defect(Defect::Stall { bytes }));
        }
    }

    fn poll(&mut self) -> Option<Vec<u8>> {
        // It speaks by itself.
        None
    }

    fn encode(&mut self, now: Stamp<HostClock>, _from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        let (Message::PlanarPose(pose), Some(interval)) = (message, self.settings.estimate_interval) else {
            return 0;
        };
        if self.last_estimate.is_some_and(|last| now - last < interval) {
            return 0;
        }
        let Some(line) = estimate::line(pose, self.clock.last()) else {
            return 0;
        };
        self.last_estimate = Some(now);
        out.extend_from_slice(line.as_bytes());
        line.len()
    }

    fn counters(&self) -> ScanCounters {
        self.counts
    }

    fn sources(&self) -> Vec<SourceHealth> {
        let heard = SourceHealth { source: ONLY_BRICK, frames: self.counts.frames, lost: 0 };
        (heard.frames > 0).then_some(heard).into_iter().collect()
    }
}

impl Line {
    fn hear(&mut self, now: Stamp<HostClock>, line: &[u8], sink: &mut Sink<'_>) {
        let is_cut = std::mem::replace(&mut self.is_cut, false);
        let read = row::text_of(line, self.settings.checksum).and_then(|(text, proof)| {
            let unknown = &mut self.unknown;
            let row = row::read(text, &self.settings, &mut |name| {
                if unknown.len() < MOST_UNKNOWN && unknown.insert(name.to_owned()) {
                    let name = printable(name.as_bytes());
                    tell(sink, INFO, format!("the board's `{name}` is not used"));
                }
            })?;
            Ok((row, proof))
        });
        match read {
            Ok((row, proof)) if !is_cut || proof == Proof::Checked => self.take(now, &row, sink),
            // What is left of a line may look whole; nobody need hear of it.
            Ok(_) => self.count_garbage(line.len() as u32, sink),
            Err(flaw) => {
                self.refuse(line, flaw, sink);
                if !is_cut {
                    self.quote(line, flaw, sink);
                }
            }
        }
    }

    fn take(&mut self, now: Stamp<HostClock>, row: &Row, sink: &mut Sink<'_>) {
        let stamp = match row.time {
            Some(time) if !self.clock.believes(time, now) => {
                sink(Heard::Defect(Defect::Payload { message_id: LINE_ID }));
                return;
            }
            Some(Time::Millis(millis)) => WireStamp::Millis32(millis),
            Some(Time::Micros(micros)) => WireStamp::Micros32(micros),
            None => self.lend_clock(now, sink),
        };
        self.counts.frames += 1;
        if let Some(message) = self.pulse.heard(now) {
            say(sink, message);
        }
        self.say_row(stamp, row, sink);
    }

    /// The stamp of a line without a time, by the host's clock.
    fn lend_clock(&mut self, now: Stamp<HostClock>, sink: &mut Sink<'_>) -> WireStamp {
        if self.lent.is_due(now) {
            sink(Heard::Time { from: ONLY_BRICK, sent: now, peer_nanos: now.as_nanos() });
        }
        WireStamp::Asked { sent: now - self.settings.delay.max(Span::ZERO), answered: now }
    }

    fn say_row(&mut self, stamp: WireStamp, row: &Row, sink: &mut Sink<'_>) {
        if let (Some(left), Some(right)) = (row.left, row.right) {
            let (total, is_rebased) = self.wheels.take([left, right]);
            // At each doubling: a loose wire resets a board many times a second.
            let falls = self.wheels.falls;
            if is_rebased && falls.is_power_of_two() {
                let times = if falls == 1 { String::new() } else { format!(", {falls} times so far") };
                let text = format!("the board's counts fell to zero{times}; that is taken for no motion");
                tell(sink, INFO, text);
            }
            let [left, right] = total.map(EncoderTicks);
            say(sink, Message::WheelTicks(WheelTicks { stamp, left, right }));
        }
        if let Some(rad_per_s) = row.turn_rate_rad_per_s {
            let inertial =
                Inertial { stamp, turn_rate: Some(RadiansPerSecond(rad_per_s)), turn: None, wheel_accelerations: None };
            say(sink, Message::Inertial(inertial));
        }
        if let Some(range_m) = row.range_m {
            let range = Meters(range_m);
            let sigma = None;
            say(sink, Message::DistanceSensor { stamp, range, sigma });
        }
        if let Some(temperature_c) = row.temperature_c {
            let message = Message::Thermometer {
                stamp,
                channel: ChannelName::from_bytes(THERMOMETER),
                temperature: Celsius(temperature_c),
            };
            say(sink, message);
        }
    }

    fn refuse_long(&mut self, bytes: u32, sink: &mut Sink<'_>) {
        let is_cut = std::mem::replace(&mut self.is_cut, false);
        self.count_garbage(bytes, sink);
        if !is_cut && !std::mem::replace(&mut self.is_flaw_told, true) {
            let text = format!("a line of {bytes} bytes is longer than {LONGEST}; expected `{}`", self.settings.layout);
            tell(sink, WARNING, text);
        }
    }

    fn refuse(&mut self, line: &[u8], flaw: Flaw, sink: &mut Sink<'_>) {
        if let Flaw::Checksum { found, expected } = flaw {
            self.counts.checksum_errors += 1;
            sink(Heard::Defect(Defect::Checksum {
                message_id: LINE_ID,
                found: u16::from(found),
                expected: u16::from(expected),
            }));
        } else {
            self.count_garbage(line.len() as u32, sink);
        }
    }

    fn quote(&mut self, line: &[u8], flaw: Flaw, sink: &mut Sink<'_>) {
        if !std::mem::replace(&mut self.is_flaw_told, true) {
            let text = format!(
                "the line `{}` is not understood: {flaw}; expected `{}`",
                printable(line),
                self.settings.layout
            );
            tell(sink, WARNING, text);
        }
    }

    fn count_garbage(&mut self, bytes: u32, sink: &mut Sink<'_>) {
        self.counts.garbage_bytes += u64::from(bytes);
        sink(Heard::Defect(Defect::Garbage { bytes }));
    }
}

/// Totals of a board whose counts begin anew when it is reset.
#[derive(Clone, Copy, Debug, Default)]
struct Wheels {
    last: Option<[i64; 2]>,
    change: [i64; 2],
    base: [i64; 2],
    /// How often the counts were set to zero.
    falls: u64,
}

impl Wheels {
    /// The totals, and whether the counts were set to zero: both are exactly zero, and one is further from it than its last change explains.
    fn take(&mut self, counts: [i64; 2]) -> ([i64; 2], bool) {
        let last = self.last.replace(counts).unwrap_or(counts);
        let is_far = |(count, change): (&i64, &i64)| count.abs() > CHANGES_TO_ZERO * change.abs() + NEAR_ZERO;
        let is_rebased = counts == [0, 0] && last.iter().zip(&self.change).any(is_far);
        let [last_left, last_right] = last;
        let [left, right] = counts;
        if is_rebased {
            self.falls += 1;
            self.base = [self.base[0].wrapping_add(last_left), self.base[1].wrapping_add(last_right)];
            self.change = [0, 0];
        } else {
            self.change = [left - last_left, right - last_right];
        }
        // Totals wrap, as those of every brick.
        let total = [self.base[0].wrapping_add(left), self.base[1].wrapping_add(right)];
        (total, is_rebased)
    }
}

fn say(sink: &mut Sink<'_>, message: Message) {
    sink(Heard::Message { from: ONLY_BRICK, message });
}

fn tell(sink: &mut Sink<'_>, severity: u8, text: String) {
    sink(Heard::Note { from: ONLY_BRICK, severity, text });
}
