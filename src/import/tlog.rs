//! A telemetry log: the frames of everybody but the station, at the times that the file says.
//!
//! # Model
//! ```text
//! host time = time of the record - zero
//! zero      = time - stamp of the station's own first time request, which is by the host's clock; else the first time that counts
//! ```
//! Only times of verified frames with which the time before or behind them agrees say where zero is.
//! The station's frames are left out, because the pipeline makes its own. Its time requests are kept as instants: a pipeline that is
//! woken at them asks at them, and so the answers in the file are answers to it. What the file cannot tell, when links came and went
//! and how chunks were cut, is lost: such a replay is close to what was live, not the same bit for bit.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use posebridge_protocol::dialect;
use posebridge_protocol::framing::{FrameRef, verified_before};
use posebridge_protocol::message::{Message, WireStamp};
use posebridge_recording::tlog::{Judged, OLDEST_MICROS, Record};
use posebridge_telemetry::{Address, HostClock, Input, LinkId, LinkState, PeerId, Span, Stamp};

use super::Sink;
use super::timeline::{Found, Take, Timed, Timeline, Told, agree, is_possible};
use crate::config::{Config, LinkSection};
use crate::input_file::InputFile;
use crate::tlog::{first_records, records};

/// The only link of the recording.
const LINK: LinkId = LinkId(0);
/// The station is sought in so many records.
const SOUGHT: usize = 20_000;
/// In a silence the pipeline is woken so often, to find out that a robot was lost.
const TICK: Span = Span::from_millis(1_000);
/// No silence is longer than this many ticks to a pipeline: it has found out by then.
const MOST_TICKS: u32 = 60;

/// An opened log.
pub(super) struct Source {
    /// The station that the log is read with; one link, and nothing is sent on it.
    pub(super) config: Config,
    /// The host clock's zero, microseconds since 1970.
    pub(super) epoch_micros: u64,
    first_micros: u64,
    path: PathBuf,
    own: Address,
}

impl Source {
    /// Looks for the zero of the host's clock.
    ///
    /// # Errors
    /// The file cannot be read or holds no frame, or its times make no sense.
    pub(super) fn open(path: &Path, station: Config) -> Result<Self> {
        let own = Address::new(station.station.system, station.station.component);
        let config = Config {
            links: vec![LinkSection {
                accept_mavlink1: true,
                outputs: Some(Vec::new()),
                ..LinkSection::new(&format!("file://{}", path.display()))
            }],
            ..station
        };
        let beginning = beginning_of(path, own)?;
        Ok(Self {
            epoch_micros: beginning.zero_micros,
            first_micros: beginning.first_micros,
            config,
            path: path.to_owned(),
            own,
        })
    }

    /// Gives the inputs in the order of their times.
    ///
    /// # Errors
    /// The file cannot be read any further, or as `sink` says.
    pub(super) fn inputs(&self, sink: &mut Sink<'_>) -> Result<Vec<String>> {
        let mut inputs = Inputs {
            own: self.own,
            epoch_micros: self.epoch_micros,
            latest: Stamp::ZERO,
            of_station: 0,
            failure: None,
            spare: Vec::new(),
            sink,
        };
        inputs.give(Stamp::ZERO, &Input::Link { link: LINK, state: LinkState::Up });
        let (bytes_outside, found) =
            in_time(&self.path, (self.own, self.first_micros), &mut |micros, frame| inputs.hand_on(micros, frame))?;
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

/// Gives the frames of a log with the times that count, microseconds since 1970, which never fall; says in words what was wrong with those
/// in the file.
///
/// # Errors
/// The file cannot be read to its end, or holds no frame, or its times make no sense.
pub(super) fn frames_in_time(path: &Path, own: Address, take: &mut Take<'_>) -> Result<Vec<String>> {
    let first_micros = beginning_of(path, own)?.first_micros;
    let (_, found) = in_time(path, (own, first_micros), take)?;
    Ok(found.notes())
}

/// Also says how many bytes lie outside of frames.
fn in_time(path: &Path, (own, first_micros): (Address, u64), take: &mut Take<'_>) -> Result<(u64, Found)> {
    let mut timeline = Timeline::new(first_micros);
    let reader = records(InputFile::open(path)?, |record| {
        timeline.push(timed(&record, own), take);
    })?;
    Ok((reader.counts().bytes_outside, timeline.finish(take)))
}

/// A record with what its sender's clock said.
fn timed<'f>(record: &Record<'f, ()>, own: Address) -> Timed<'f> {
    Timed {
        micros: record.micros,
        told: verified_before(record.frame).and_then(|frame| told(&frame, own)),
        frame: Cow::Borrowed(record.frame),
    }
}

fn told(frame: &FrameRef<'_>, own: Address) -> Option<Told> {
    let asked = own_request(frame, own);
    let (micros, wraps_micros) = if let Some(asked) = asked {
        (asked.as_micros(), None)
    } else {
        let stamp = dialect::stamp_of(frame)?;
        let wraps_micros = match stamp {
            WireStamp::Micros32(_) => Some(1 << 32),
            WireStamp::Millis32(_) => Some(1_000 << 32),
            WireStamp::Micros64(_) | WireStamp::Asked { .. } => None,
        };
        (i64::try_from(stamp.as_micros()).ok()?, wraps_micros)
    };
    // A date is no clock of its own: it may be set with the computer's.
    (micros < OLDEST_MICROS as i64).then_some(Told {
        clock: (frame.source, frame.message_id),
        micros,
        wraps_micros,
        is_hosts: asked.is_some(),
    })
}

/// The host instant of a time request, if a frame is one of the station's own.
fn own_request(frame: &FrameRef<'_>, own: Address) -> Option<Stamp<HostClock>> {
    if frame.source != own {
        return None;
    }
    match dialect::decode(frame) {
        Ok(Some(Message::TimeSync(sync))) if sync.answer_nanos == 0 && sync.request_nanos >= 0 => {
            Some(Stamp::from_nanos(sync.request_nanos))
        }
        _ => None,
    }
}

/// Where the times of a log begin, microseconds since 1970.
struct Beginning {
    /// Zero of the host's clock.
    zero_micros: u64,
    /// The first time with which another agrees.
    first_micros: u64,
}

/// What is known of a log's beginning while it is sought.
#[derive(Default)]
struct Sought {
    seen: usize,
    /// Offset and time of the first verified record.
    lone: Option<(u64, u64)>,
    /// Time of the verified record before, and the zero that it tells.
    before: Option<(u64, Option<u64>)>,
    first: Option<u64>,
    zero: Option<u64>,
}

impl Sought {
    fn take(&mut self, record: &Record<'_, ()>, own: Address) {
        self.seen += 1;
        let micros = record.micros;
        if record.judged != Judged::Whole(()) {
            return;
        }
        self.lone.get_or_insert((record.offset, micros));
        let zero = verified_before(record.frame)
            .and_then(|frame| own_request(&frame, own))
            .and_then(|at| micros.checked_sub(u64::try_from(at.as_micros()).ok()?));
        let before = self.before.replace((micros, zero));
        let Some((before, zero_before)) = before.filter(|(before, _)| agree(*before, micros)) else {
            return;
        };
        let first = *self.first.get_or_insert(before);
        // A zero behind the first record would make times negative: then the stamps are by another clock.
        self.zero = zero_before.or(zero).filter(|zero| *zero <= first);
    }

    fn found(self, path: &Path) -> Result<Beginning> {
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
        Ok(Beginning { zero_micros: self.zero.unwrap_or(first_micros), first_micros })
    }
}

fn beginning_of(path: &Path, own: Address) -> Result<Beginning> {
    let mut sought = Sought::default();
    first_records(InputFile::open(path)?, |record| {
        sought.take(&record, own);
        sought.zero.is_none() && sought.seen < SOUGHT
    })?;
    sought.found(path)
}

/// Turns records into inputs.
struct Inputs<'a, 's> {
    own: Address,
    epoch_micros: u64,
    latest: Stamp<HostClock>,
    of_station: u64,
    failure: Option<anyhow::Error>,
    /// The memory in which a frame is given.
    spare: Vec<u8>,
    sink: &'a mut Sink<'s>,
}

impl Inputs<'_, '_> {
    /// Takes a frame with the time that counts.
    fn hand_on(&mut self, micros: u64, frame: &[u8]) {
        let since_zero = micros.saturating_sub(self.epoch_micros);
        let mut at = Stamp::from_micros(i64::try_from(since_zero).unwrap_or(i64::MAX));
        let of_station = verified_before(frame).filter(|frame| frame.source == self.own);
        let Some(of_station) = of_station else {
            return self.give_bytes(at, frame);
        };
        self.of_station += 1;
        let Some(asked) = own_request(&of_station, self.own) else {
            return;
        };
        // The stamp has nanoseconds, the record's time has not.
        if (at - asked).as_secs_f64().abs() < 1e-3 {
            at = asked;
        }
        self.give(at, &Input::Tick);
    }

    fn give_bytes(&mut self, at: Stamp<HostClock>, frame: &[u8]) {
        let mut bytes = std::mem::take(&mut self.spare);
        bytes.clear();
        bytes.extend_from_slice(frame);
        let input = Input::Bytes { link: LINK, peer: PeerId(0), bytes };
        self.give(at, &input);
        if let Input::Bytes { bytes, .. } = input {
            self.spare = bytes;
        }
    }

    /// Gives an input, and ticks in the silence before it.
    fn give(&mut self, at: Stamp<HostClock>, input: &Input) {
        let at = at.max(self.latest);
        for _ in 0..MOST_TICKS {
            if at - self.latest <= TICK {
                break;
            }
            self.latest = self.latest + TICK;
            self.pass(&Input::Tick);
        }
        self.latest = at;
        self.pass(input);
    }

    fn pass(&mut self, input: &Input) {
        if self.failure.is_none() {
            self.failure = (self.sink)(self.latest, input).err();
        }
    }
}
