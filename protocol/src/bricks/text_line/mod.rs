//! Boards that print lines of text with a declared layout, such as those of an Arduino sketch or a student's board.
//!
//! The station only reads; if configured, it prints the estimate back as a line of whole numbers, which a board of 2 KB reads
//! without floating point. SPEC.md beside this file defines the lines. Without checksums a damaged digit is accepted, so at
//! least the time is compared with the host's.

mod clock;
pub(crate) mod numbers;
mod row;
mod settings;

use std::collections::BTreeSet;

use posebridge_telemetry::severity::{INFO, WARNING};
use posebridge_telemetry::{
    Address, Celsius, ChannelName, EncoderTicks, HostClock, Meters, RadiansPerSecond, ReceiveError, SourceHealth,
    TimeDelta, Timestamp,
};

use self::clock::{BoardClock, SubstituteClock};
pub(crate) use self::row::strip_checksum;
use self::row::{BoardReading, ChecksumStatus, LineError, exclusive_or};
pub(crate) use self::settings::QuantityKind;
pub use self::settings::{
    ChecksumPolicy, Column, ColumnSign, LayoutError, LineLayout, QUANTITIES, Quantity, Separator, TextLineSettings,
};
use super::codec::{
    BrickCodec, CodecEvent, CodecEventSink, CodecSettings, DEFAULT_BRICK_ADDRESS, HeartbeatSource, emit_message,
    emit_status_text, validity_bits,
};
use super::line_splitter::{LineSplitter, SplitItem, printable};
use crate::framing::FramerCounters;
use crate::message::{Battery, Heartbeat, Inertial, Message, PlanarPose, WheelTicks, WireStamp};

/// A line that is interrupted for longer was cut off: a board at 9600 baud prints the longest one in 270 ms.
const QUIET_TIME: TimeDelta = TimeDelta::from_millis(500);
const MAX_UNKNOWN: usize = 8;
/// Longest line, bytes without its end: three times NMEA's 82, and more than Fast Robots' 151 byte strings.
const MAX_LINE_BYTES: usize = 256;
/// A battery changes within minutes, and boards print it with each line.
const BATTERY_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);
const THERMOMETER: &[u8] = b"temperature";
/// The message id of a line in [`ReceiveError`]s, which has no number.
const LINE_ID: u32 = 0;
/// Counts that fall to zero from more than this multiple of their last change were reset.
const CHANGES_TO_ZERO: i64 = 3;
/// Counts below this may have rolled to zero.
const NEAR_ZERO: i64 = 10;

#[derive(Debug)]
struct TextLineCodec {
    settings: TextLineSettings,
    splitter: LineSplitter<MAX_LINE_BYTES>,
    last_byte: Timestamp<HostClock>,
    /// The next line may be incomplete at its beginning.
    may_be_truncated: bool,
    clock: BoardClock,
    substitute_clock: SubstituteClock,
    wheels: ResettableCounters,
    heartbeat: HeartbeatSource,
    counts: FramerCounters,
    is_error_reported: bool,
    unknown: BTreeSet<String>,
    last_estimate: Option<Timestamp<HostClock>>,
    last_battery: Option<Timestamp<HostClock>>,
}

pub(super) fn open(settings: &CodecSettings) -> Box<dyn BrickCodec> {
    open_with(settings.line.clone())
}

/// For boards that print for people: the numbers of a line are its columns, whatever stands between them, and lines without a number are
/// skipped.
pub(super) fn open_columns(settings: &CodecSettings) -> Box<dyn BrickCodec> {
    let mut settings = settings.line.clone();
    if let LineLayout::Columns { separator, .. } = &mut settings.layout {
        *separator = Separator::Words;
    }
    open_with(settings)
}

fn open_with(settings: TextLineSettings) -> Box<dyn BrickCodec> {
    Box::new(TextLineCodec {
        settings,
        splitter: LineSplitter::default(),
        last_byte: Timestamp::ZERO,
        may_be_truncated: true,
        clock: BoardClock::default(),
        substitute_clock: SubstituteClock::default(),
        wheels: ResettableCounters::default(),
        heartbeat: HeartbeatSource::new(Heartbeat::ROVER),
        counts: FramerCounters::default(),
        is_error_reported: false,
        unknown: BTreeSet::new(),
        last_estimate: None,
        last_battery: None,
    })
}

impl BrickCodec for TextLineCodec {
    fn on_link_up(&mut self, _now: Timestamp<HostClock>) {
        self.splitter.clear();
        self.may_be_truncated = true;
        self.is_error_reported = false;
        self.substitute_clock = SubstituteClock::default();
    }

    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: CodecEventSink<'_>) {
        self.last_byte = now;
        // The splitter lends its line while it is read, which needs the rest of the state.
        let mut splitter = std::mem::take(&mut self.splitter);
        splitter.push(bytes, &mut |cut| match cut {
            SplitItem::Line(line) => self.handle_line(now, line, sink),
            SplitItem::TooLong(bytes) => self.reject_long(bytes, sink),
        });
        self.splitter = splitter;
    }

    fn deadline(&self) -> Option<Timestamp<HostClock>> {
        (self.splitter.waiting_bytes() > 0).then(|| self.last_byte + QUIET_TIME)
    }

    fn tick(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        if self.deadline().is_some_and(|due| due <= now) {
            let bytes = self.splitter.clear();
            self.may_be_truncated = true;
            self.counts.stalls += 1;
            self.counts.garbage_bytes += u64::from(bytes);
            sink(CodecEvent::Error(ReceiveError::Timeout { bytes }));
        }
    }

    fn poll(&mut self) -> Option<Vec<u8>> {
        // It sends unasked.
        None
    }

    fn encode(&mut self, now: Timestamp<HostClock>, _from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        let (Message::PlanarPose(pose), Some(interval)) = (message, self.settings.estimate_interval) else {
            return 0;
        };
        if self.last_estimate.is_some_and(|last| now - last < interval) {
            return 0;
        }
        let Some(line) = encode_line(pose, self.clock.last_accepted()) else {
            return 0;
        };
        self.last_estimate = Some(now);
        out.extend_from_slice(line.as_bytes());
        line.len()
    }

    fn counters(&self) -> FramerCounters {
        self.counts
    }

    fn source_health(&self) -> Vec<SourceHealth> {
        let health = SourceHealth { source: DEFAULT_BRICK_ADDRESS, frames: self.counts.frames, lost: 0 };
        (health.frames > 0).then_some(health).into_iter().collect()
    }
}

impl TextLineCodec {
    fn handle_line(&mut self, now: Timestamp<HostClock>, line: &[u8], sink: CodecEventSink<'_>) {
        let is_cut = std::mem::replace(&mut self.may_be_truncated, false);
        let read = strip_checksum(line, self.settings.checksum).and_then(|(text, proof)| {
            let unknown = &mut self.unknown;
            let row = row::parse_row(text, &self.settings, &mut |name| {
                if unknown.len() < MAX_UNKNOWN && unknown.insert(name.to_owned()) {
                    let name = printable(name.as_bytes());
                    emit_status_text(sink, INFO, format!("the board's `{name}` is not used"));
                }
            })?;
            Ok((row, proof))
        });
        match read {
            Ok((row, proof)) if !is_cut || proof == ChecksumStatus::Verified => self.handle_row(now, &row, sink),
            // The rest of a line may look complete; it is not reported.
            Ok(_) => self.count_unframed(line.len() as u32, sink),
            Err(LineError::NoNumber) => {}
            Err(flaw) => {
                self.reject(line, flaw, sink);
                if !is_cut {
                    self.quote(line, flaw, sink);
                }
            }
        }
    }

    fn handle_row(&mut self, now: Timestamp<HostClock>, row: &BoardReading, sink: CodecEventSink<'_>) {
        let stamp = match row.time {
            Some(time) if !self.clock.accept(time, now) => {
                sink(CodecEvent::Error(ReceiveError::Payload { message_id: LINE_ID }));
                return;
            }
            Some(time) => time,
            None => self.substitute_stamp(now, sink),
        };
        self.counts.frames += 1;
        if let Some(message) = self.heartbeat.heartbeat_if_due(now) {
            emit_message(sink, message);
        }
        self.emit_row(stamp, row, sink);
        if let Some(volts) = row.battery_v
            && self.last_battery.is_none_or(|last| now - last >= BATTERY_PERIOD)
        {
            self.last_battery = Some(now);
            emit_message(sink, Message::BatteryStatus(Battery { voltage_v: Some(volts), ..Battery::default() }));
        }
    }

    /// The host's time as the stamp of a line without one.
    fn substitute_stamp(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) -> WireStamp {
        if self.substitute_clock.is_due(now) {
            sink(CodecEvent::ClockReply { from: DEFAULT_BRICK_ADDRESS, sent: now, peer_nanos: now.as_nanos() });
        }
        WireStamp::HostInterval { sent: now - self.settings.delay.max(TimeDelta::ZERO), answered: now }
    }

    fn emit_row(&mut self, stamp: WireStamp, row: &BoardReading, sink: CodecEventSink<'_>) {
        if let (Some(left), Some(right)) = (row.left, row.right) {
            let (total, is_rebased) = self.wheels.push([left, right]);
            // At each doubling: a loose wire resets a board many times a second.
            let falls = self.wheels.reset_count;
            if is_rebased && falls.is_power_of_two() {
                let times = if falls == 1 { String::new() } else { format!(", {falls} times so far") };
                let text = format!("the board's counts fell to zero{times}; that is taken for no motion");
                emit_status_text(sink, INFO, text);
            }
            let [left, right] = total.map(EncoderTicks);
            emit_message(sink, Message::WheelTicks(WheelTicks { stamp, left, right }));
        }
        if let Some(rad_per_s) = row.turn_rate_rad_per_s {
            let inertial = Inertial { turn_rate: Some(RadiansPerSecond(rad_per_s)), ..Inertial::empty(stamp) };
            emit_message(sink, Message::Inertial(inertial));
        }
        if let Some(range_m) = row.range_m {
            emit_message(sink, Message::DistanceSensor { stamp, range: Meters(range_m), sigma: None });
        }
        if let Some(temperature_c) = row.temperature_c {
            let channel = ChannelName::from_bytes(THERMOMETER);
            emit_message(sink, Message::Thermometer { stamp, channel, temperature: Celsius(temperature_c) });
        }
    }

    fn reject_long(&mut self, bytes: u32, sink: CodecEventSink<'_>) {
        let is_cut = std::mem::replace(&mut self.may_be_truncated, false);
        self.count_unframed(bytes, sink);
        if !is_cut && !std::mem::replace(&mut self.is_error_reported, true) {
            let text =
                format!("a line of {bytes} bytes is longer than {MAX_LINE_BYTES}; expected `{}`", self.settings.layout);
            emit_status_text(sink, WARNING, text);
        }
    }

    fn reject(&mut self, line: &[u8], flaw: LineError, sink: CodecEventSink<'_>) {
        if let LineError::Checksum { found, expected } = flaw {
            self.counts.checksum_errors += 1;
            sink(CodecEvent::Error(ReceiveError::Checksum {
                message_id: LINE_ID,
                found: u16::from(found),
                expected: u16::from(expected),
            }));
        } else {
            self.count_unframed(line.len() as u32, sink);
        }
    }

    fn quote(&mut self, line: &[u8], flaw: LineError, sink: CodecEventSink<'_>) {
        if !std::mem::replace(&mut self.is_error_reported, true) {
            let text = format!(
                "the line `{}` is not understood: {flaw}; expected `{}`",
                printable(line),
                self.settings.layout
            );
            emit_status_text(sink, WARNING, text);
        }
    }

    fn count_unframed(&mut self, bytes: u32, sink: CodecEventSink<'_>) {
        self.counts.garbage_bytes += u64::from(bytes);
        sink(CodecEvent::Error(ReceiveError::UnframedBytes { bytes }));
    }
}

/// Totals of a board that restarts its counts at zero when it is reset.
#[derive(Clone, Copy, Debug, Default)]
struct ResettableCounters {
    last: Option<[i64; 2]>,
    change: [i64; 2],
    base: [i64; 2],
    reset_count: u64,
}

impl ResettableCounters {
    /// The totals, and whether the counts were reset: both are exactly zero, and one is further from it than its last
    /// change explains.
    fn push(&mut self, counts: [i64; 2]) -> ([i64; 2], bool) {
        let last = self.last.replace(counts).unwrap_or(counts);
        let is_far = |(count, change): (&i64, &i64)| count.abs() > CHANGES_TO_ZERO * change.abs() + NEAR_ZERO;
        let is_rebased = counts == [0, 0] && last.iter().zip(&self.change).any(is_far);
        let [last_left, last_right] = last;
        let [left, right] = counts;
        if is_rebased {
            self.reset_count += 1;
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

/// Numbers on a board have 32 bits.
const MAX_NUMBER: f64 = i32::MAX as f64;

/// The line of an estimate, `E,<tick_ms>,<x_mm>,<y_mm>,<heading_mrad>,<sigma_mm>,<flags>*hh`, where `tick_ms` is of the
/// board's own clock and `hh` the exclusive or of all characters before the `*`.
///
/// `None` if a number of it is not finite. `last` is the time of the board's last line.
fn encode_line(pose: &PlanarPose, last: Option<WireStamp>) -> Option<String> {
    let origin = pose.pose.origin();
    let x_mm = to_i32(origin.x.0 * 1_000.0)?;
    let y_mm = to_i32(origin.y.0 * 1_000.0)?;
    let heading_mrad = to_i32(pose.pose.heading.rad() * 1_000.0)?;
    // Rounded up, so that no sigma of a real estimate is zero.
    let sigma_mm = to_i32((pose.position_sigma_m() * 1_000.0).ceil())?;
    let tick_ms = tick_ms(pose.stamp, last);
    let flags = validity_bits(pose.flags);
    let text = format!("E,{tick_ms},{x_mm},{y_mm},{heading_mrad},{sigma_mm},{flags}");
    let sum = exclusive_or(text.as_bytes());
    Some(format!("{text}*{sum:02X}\n"))
}

/// The instant as the board's millisecond counter shows it. The stamp holds microseconds modulo 2^32, a shorter period:
/// the rest comes from the board's last line.
fn tick_ms(stamp: WireStamp, last: Option<WireStamp>) -> u32 {
    let micros = stamp.as_micros();
    let Some(WireStamp::Millis32(last_ms)) = last else {
        return (micros / 1_000) as u32;
    };
    let last_micros = (u64::from(last_ms) * 1_000) as u32;
    let since_micros = (micros as u32).wrapping_sub(last_micros) as i32;
    let since_ms = TimeDelta::from_micros(i64::from(since_micros)).as_nanos() / 1_000_000;
    last_ms.wrapping_add_signed(since_ms as i32)
}

fn to_i32(value: f64) -> Option<i32> {
    let is_number = value.is_finite();
    is_number.then_some(value.round().clamp(-MAX_NUMBER, MAX_NUMBER) as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tick_is_the_boards_own_after_the_microseconds_have_wrapped() {
        // 100 minutes on the board: 6 000 000 ms, and 6e9 µs modulo 2^32.
        let stamp = WireStamp::Micros32((6_000_000_000_u64 % (1 << 32)) as u32);
        assert_eq!(tick_ms(stamp, Some(WireStamp::Millis32(6_000_040))), 6_000_000);
        assert_eq!(tick_ms(stamp, Some(WireStamp::Millis32(5_999_980))), 6_000_000);
        let micros = Some(WireStamp::Micros32(7));
        assert_eq!(tick_ms(WireStamp::Micros32(123_999), micros), 123);
    }
}
