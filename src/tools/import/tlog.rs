//! Imports a telemetry log: the frames of all senders but the station, at the times in the file.
//!
//! # Model
//! ```text
//! host time = time of the record - zero
//! zero      = time - stamp of the station's own first time request, which is by the host's clock; else the first time that counts
//! ```
//! Only times of verified frames that are consistent with a neighbouring time determine zero. The station's frames are omitted, because
//! a replay makes its own. Its time requests are kept as instants: the replayed station wakes at them and sends its requests then, so
//! that the answers in the file match. The file does not contain link states and chunk boundaries: such a replay is close to the live
//! run, not bit for bit the same.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use posebridge_protocol::dialect;
use posebridge_protocol::framing::{FrameRef, parse_verified};
use posebridge_protocol::message::{Message, WireStamp};
use posebridge_recording::container::RecordingHeader;
use posebridge_recording::tlog::{FrameCheck, OLDEST_MICROS, TlogRecord};
use posebridge_telemetry::{Address, HostClock, Input, LinkId, LinkState, PeerId, TimeDelta, Timestamp};

use super::timeline::{ClockReading, FrameSink, TimedRecord, Timeline, TimelineDefects, are_consistent, is_possible};
use crate::config::{Config, LinkSection};
use crate::station::input_file::{InputFile, first_tlog_records, tlog_records};
use crate::station::recording_files::header;

const LINK: LinkId = LinkId(0);
/// Number of records searched for the station's frames.
const SEARCH_RECORDS: usize = 20_000;
/// Interval of station wake-ups during a silence, so that it detects a lost robot.
const TICK: TimeDelta = TimeDelta::from_millis(1_000);
/// Further ticks in a silence change nothing: the station has detected all losses by then.
const MAX_TICKS: u32 = 60;

pub type InputSink<'s> = dyn FnMut(Timestamp<HostClock>, &Input) -> Result<()> + 's;

pub struct TlogSource {
    /// With the station's configuration for the log: one link, without outputs.
    pub header: RecordingHeader,
    first_micros: u64,
    path: PathBuf,
    own: Address,
}

impl TlogSource {
    pub fn open(path: &Path, station: Config) -> Result<Self> {
        let own = Address::new(station.station.system, station.station.component);
        let config = Config {
            links: vec![LinkSection {
                accept_mavlink1: true,
                outputs: Some(Vec::new()),
                ..LinkSection::new(&format!("file://{}", path.display()))
            }],
            ..station
        };
        let beginning = find_origin(path, own)?;
        Ok(Self {
            header: header(&config, beginning.zero_micros)?,
            first_micros: beginning.first_micros,
            path: path.to_owned(),
            own,
        })
    }

    /// Passes the inputs in time order, the first one always at [`Timestamp::ZERO`]. Returns messages about omitted data.
    pub fn inputs(&self, sink: &mut InputSink<'_>) -> Result<Vec<String>> {
        let mut inputs = InputBuilder {
            own: self.own,
            epoch_micros: self.header.utc_start_micros,
            latest: Timestamp::ZERO,
            of_station: 0,
            failure: None,
            buffer: Vec::new(),
            sink,
        };
        inputs.emit(Timestamp::ZERO, &Input::Link { link: LINK, state: LinkState::Up });
        let (bytes_outside, found) = process_times(&self.path, self.own, self.first_micros, &mut |micros, frame| {
            inputs.push_frame(micros, frame);
        })?;
        inputs.failure.map_or(Ok(()), Err)?;
        let counts = [
            (inputs.of_station, format!("frames of the station {} itself", self.own)),
            (bytes_outside, "bytes outside frames".to_owned()),
        ];
        let counts = counts.into_iter().filter(|(count, _)| *count > 0);
        let mut notes: Vec<String> = counts.map(|(count, what)| format!("{count} {what}")).collect();
        notes.extend(found.notes());
        Ok(notes)
    }
}

/// Passes the frames of a log with corrected times, microseconds since 1970, which never decrease; returns messages about the
/// corrections.
pub(super) fn timed_frames(path: &Path, own: Address, take: &mut FrameSink<'_>) -> Result<Vec<String>> {
    let first_micros = find_origin(path, own)?.first_micros;
    let (_, found) = process_times(path, own, first_micros, take)?;
    Ok(found.notes())
}

/// Also returns the number of bytes outside frames.
fn process_times(
    path: &Path,
    own: Address,
    first_micros: u64,
    take: &mut FrameSink<'_>,
) -> Result<(u64, TimelineDefects)> {
    let mut timeline = Timeline::new(first_micros);
    let reader = tlog_records(InputFile::open(path)?, |record| {
        timeline.push(timed_record(&record, own), take);
    })?;
    Ok((reader.counts().skipped_bytes, timeline.finish(take)))
}

fn timed_record<'f>(record: &TlogRecord<'f, ()>, own: Address) -> TimedRecord<'f> {
    TimedRecord {
        micros: record.micros,
        clock_reading: parse_verified(record.frame).and_then(|frame| clock_reading(&frame, own)),
        frame: Cow::Borrowed(record.frame),
    }
}

fn clock_reading(frame: &FrameRef<'_>, own: Address) -> Option<ClockReading> {
    let requested_at = own_request(frame, own);
    let (micros, wraps_micros) = if let Some(requested_at) = requested_at {
        (requested_at.as_micros(), None)
    } else {
        let stamp = dialect::timestamp_of(frame)?;
        let wraps_micros = match stamp {
            WireStamp::Micros32(_) => Some(1 << 32),
            WireStamp::Millis32(_) => Some(1_000 << 32),
            WireStamp::Micros64(_) | WireStamp::HostInterval { .. } => None,
        };
        (i64::try_from(stamp.as_micros()).ok()?, wraps_micros)
    };
    // A date is no clock of its own: it may be set with the computer's.
    (micros < OLDEST_MICROS as i64).then_some(ClockReading {
        clock: (frame.source, frame.message_id),
        micros,
        wrap_period_micros: wraps_micros,
        is_host_clock: requested_at.is_some(),
    })
}

/// The host time in a frame, if it is the station's own time request.
fn own_request(frame: &FrameRef<'_>, own: Address) -> Option<Timestamp<HostClock>> {
    if frame.source != own {
        return None;
    }
    match dialect::decode(frame) {
        Ok(Some(Message::TimeSync(sync))) if sync.answer_nanos == 0 && sync.request_nanos >= 0 => {
            Some(Timestamp::from_nanos(sync.request_nanos))
        }
        _ => None,
    }
}

/// Start times of a log, microseconds since 1970.
struct TimeOrigin {
    zero_micros: u64,
    first_micros: u64,
}

#[derive(Default)]
struct OriginSearch {
    record_count: usize,
    /// Offset and time of the first verified record.
    lone: Option<(u64, u64)>,
    /// Time of the previous verified record, and the zero derived from it.
    before: Option<(u64, Option<u64>)>,
    first: Option<u64>,
    zero: Option<u64>,
}

impl OriginSearch {
    fn push(&mut self, record: &TlogRecord<'_, ()>, own: Address) {
        self.record_count += 1;
        let micros = record.micros;
        if record.check != FrameCheck::Valid(()) {
            return;
        }
        self.lone.get_or_insert((record.offset, micros));
        let zero = parse_verified(record.frame)
            .and_then(|frame| own_request(&frame, own))
            .and_then(|at| micros.checked_sub(u64::try_from(at.as_micros()).ok()?));
        let before = self.before.replace((micros, zero));
        let Some((before, zero_before)) = before.filter(|(before, _)| are_consistent(*before, micros)) else {
            return;
        };
        let first = *self.first.get_or_insert(before);
        // A zero behind the first record would make times negative: then the stamps are by another clock.
        self.zero = zero_before.or(zero).filter(|zero| *zero <= first);
    }

    fn finish(self, path: &Path) -> Result<TimeOrigin> {
        let name = path.display();
        let Some((offset, lone)) = self.lone else {
            bail!(
                "`{name}` holds no MAVLink frame that can be verified: is it a telemetry log? `posebridge inspect {name}` says what it holds"
            );
        };
        let first = self.first.or(is_possible(lone).then_some(lone));
        let Some(first_micros) = first else {
            bail!(
                "`{name}`: the time at byte {offset} is {lone} us after 1970, beyond the year 2100, and no two times behind it agree: the times are damaged"
            );
        };
        Ok(TimeOrigin { zero_micros: self.zero.unwrap_or(first_micros), first_micros })
    }
}

fn find_origin(path: &Path, own: Address) -> Result<TimeOrigin> {
    let mut sought = OriginSearch::default();
    first_tlog_records(InputFile::open(path)?, |record| {
        sought.push(&record, own);
        sought.zero.is_none() && sought.record_count < SEARCH_RECORDS
    })?;
    sought.finish(path)
}

struct InputBuilder<'a, 's> {
    own: Address,
    epoch_micros: u64,
    latest: Timestamp<HostClock>,
    of_station: u64,
    failure: Option<anyhow::Error>,
    /// Reused for each frame.
    buffer: Vec<u8>,
    sink: &'a mut InputSink<'s>,
}

impl InputBuilder<'_, '_> {
    fn push_frame(&mut self, micros: u64, frame: &[u8]) {
        let since_zero = micros.saturating_sub(self.epoch_micros);
        let mut at = Timestamp::from_micros(i64::try_from(since_zero).unwrap_or(i64::MAX));
        let of_station = parse_verified(frame).filter(|frame| frame.source == self.own);
        let Some(of_station) = of_station else {
            return self.emit_bytes(at, frame);
        };
        self.of_station += 1;
        let Some(requested_at) = own_request(&of_station, self.own) else {
            return;
        };
        // The stamp has nanoseconds, the record's time has not.
        if (at - requested_at).as_secs_f64().abs() < 1e-3 {
            at = requested_at;
        }
        self.emit(at, &Input::Tick);
    }

    fn emit_bytes(&mut self, at: Timestamp<HostClock>, frame: &[u8]) {
        let mut bytes = std::mem::take(&mut self.buffer);
        bytes.clear();
        bytes.extend_from_slice(frame);
        let input = Input::Bytes { link: LINK, peer: PeerId(0), bytes };
        self.emit(at, &input);
        if let Input::Bytes { bytes, .. } = input {
            self.buffer = bytes;
        }
    }

    /// Passes an input, and ticks in the silence before it.
    fn emit(&mut self, at: Timestamp<HostClock>, input: &Input) {
        let at = at.max(self.latest);
        for _ in 0..MAX_TICKS {
            if at - self.latest <= TICK {
                break;
            }
            self.latest = self.latest + TICK;
            self.send(&Input::Tick);
        }
        self.latest = at;
        self.send(input);
    }

    fn send(&mut self, input: &Input) {
        if self.failure.is_none() {
            self.failure = (self.sink)(self.latest, input).err();
        }
    }
}
