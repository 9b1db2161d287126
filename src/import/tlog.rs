//! A telemetry log: the frames of everybody but the station, at the times that the file says.
//!
//! # Model
//! ```text
//! host time = time of the record - zero
//! zero      = time - stamp of the station's own first time request, which is by the host's clock; else the time of the first record
//! ```
//! The station's frames are left out, because the pipeline makes its own. Its time requests are kept as instants: a pipeline that is
//! woken at them asks at them, and so the answers in the file are answers to it. What the file cannot tell, when links came and went
//! and how chunks were cut, is lost: such a replay is close to what was live, not the same bit for bit.

use std::path::{Path, PathBuf};

use anyhow::Result;
use posebridge_protocol::dialect;
use posebridge_protocol::framing::verified_before;
use posebridge_protocol::message::Message;
use posebridge_recording::tlog::Record;
use posebridge_telemetry::{Address, HostClock, Input, LinkId, LinkState, PeerId, Span, Stamp};

use super::Sink;
use crate::config::{Config, LinkSection};
use crate::input_file::InputFile;
use crate::tlog::{first_records, records};

/// The only link of the recording.
const LINK: LinkId = LinkId(0);
/// The station is sought in so many records.
const SOUGHT: usize = 20_000;
/// A time that lies so far ahead of the record behind it is damaged; a fall by less than that is the disorder of a writer.
const LEAP_MICROS: u64 = 60_000_000;
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
    path: PathBuf,
    own: Address,
}

impl Source {
    /// Looks for the zero of the host's clock.
    ///
    /// # Errors
    /// The file cannot be read.
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
        Ok(Self {
            epoch_micros: epoch_of(path, own)?,
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
            timeline: Timeline::new(self.epoch_micros),
            waiting: None,
            latest: Stamp::ZERO,
            of_station: 0,
            failure: None,
            sink,
        };
        inputs.give(
            Stamp::ZERO,
            Input::Link {
                link: LINK,
                state: LinkState::Up,
            },
        );
        let reader = records(InputFile::open(&self.path)?, |record| inputs.take(&record))?;
        inputs.hand_on(None);
        inputs.failure.map_or(Ok(()), Err)?;
        let notes = [
            (
                inputs.of_station,
                format!("frames of the station {} itself", self.own),
            ),
            (
                reader.counts().bytes_outside,
                "bytes outside frames".to_owned(),
            ),
            (
                inputs.timeline.damaged,
                "times that leap ahead, taken for damage".to_owned(),
            ),
            (
                inputs.timeline.steps,
                "steps back of the computer's date, taken out".to_owned(),
            ),
        ];
        let notes = notes.into_iter().filter(|(count, _)| *count > 0);
        Ok(notes
            .map(|(count, what)| format!("{count} {what}"))
            .collect())
    }
}

/// The host instant of a time request, if a frame is one of the station's own.
fn own_request(frame: &[u8], own: Address) -> Option<Stamp<HostClock>> {
    let frame = verified_before(frame).filter(|frame| frame.source == own)?;
    match dialect::decode(&frame) {
        Ok(Some(Message::TimeSync(sync))) if sync.answer_nanos == 0 && sync.request_nanos >= 0 => {
            Some(Stamp::from_nanos(sync.request_nanos))
        }
        _ => None,
    }
}

fn epoch_of(path: &Path, own: Address) -> Result<u64> {
    let (mut first, mut asked, mut seen) = (None, None, 0);
    first_records(InputFile::open(path)?, |record| {
        seen += 1;
        let first = *first.get_or_insert(record.micros);
        asked = own_request(record.frame, own).and_then(|at| {
            let since_zero = u64::try_from(at.as_micros()).ok()?;
            // A zero behind the first record would make times negative: then the stamps are by another clock.
            let zero = record.micros.checked_sub(since_zero);
            zero.filter(|zero| *zero <= first)
        });
        asked.is_none() && seen < SOUGHT
    })?;
    Ok(asked.or(first).unwrap_or_default())
}

/// Makes host instants of a file's times: they never fall.
struct Timeline {
    epoch_micros: u64,
    /// The computer's date was set back by so much since the beginning.
    shift_micros: u64,
    latest_micros: u64,
    damaged: u64,
    steps: u64,
}

impl Timeline {
    const fn new(epoch_micros: u64) -> Self {
        Self {
            epoch_micros,
            shift_micros: 0,
            latest_micros: epoch_micros,
            damaged: 0,
            steps: 0,
        }
    }

    /// The instant of a record, given the time of the one behind it.
    fn stamp(&mut self, micros: u64, next_micros: Option<u64>) -> Stamp<HostClock> {
        let mut micros = micros.saturating_add(self.shift_micros);
        let next = next_micros.map(|next| next.saturating_add(self.shift_micros));
        let leaps = micros.saturating_sub(self.latest_micros) > LEAP_MICROS;
        if leaps && next.is_some_and(|next| micros.saturating_sub(next) > LEAP_MICROS) {
            self.damaged += 1;
            micros = self.latest_micros;
        }
        let fall = self.latest_micros.saturating_sub(micros);
        if fall > LEAP_MICROS {
            self.steps += 1;
            self.shift_micros = self.shift_micros.saturating_add(fall);
        }
        self.latest_micros = self.latest_micros.max(micros);
        let since_zero = self.latest_micros - self.epoch_micros;
        Stamp::from_micros(i64::try_from(since_zero).unwrap_or(i64::MAX))
    }
}

/// A record that waits for the time of the next one.
struct Waiting {
    micros: u64,
    frame: Vec<u8>,
}

/// Turns records into inputs.
struct Inputs<'a, 's> {
    own: Address,
    timeline: Timeline,
    waiting: Option<Waiting>,
    latest: Stamp<HostClock>,
    of_station: u64,
    failure: Option<anyhow::Error>,
    sink: &'a mut Sink<'s>,
}

impl Inputs<'_, '_> {
    fn take(&mut self, record: &Record<'_, ()>) {
        self.hand_on(Some(record.micros));
        self.waiting = Some(Waiting {
            micros: record.micros,
            frame: record.frame.to_vec(),
        });
    }

    /// Gives the record that waited, if there is one.
    fn hand_on(&mut self, next_micros: Option<u64>) {
        let Some(Waiting { micros, frame }) = self.waiting.take() else {
            return;
        };
        let mut at = self.timeline.stamp(micros, next_micros);
        let is_own = verified_before(&frame).is_some_and(|frame| frame.source == self.own);
        let input = if is_own {
            self.of_station += 1;
            let Some(asked) = own_request(&frame, self.own) else {
                return;
            };
            // The stamp has nanoseconds, the record's time has not.
            if (at - asked).as_secs_f64().abs() < 1e-3 {
                at = asked;
            }
            Input::Tick
        } else {
            Input::Bytes {
                link: LINK,
                peer: PeerId(0),
                bytes: frame,
            }
        };
        self.give(at, input);
    }

    /// Gives an input, and ticks in the silence before it.
    fn give(&mut self, at: Stamp<HostClock>, input: Input) {
        let at = at.max(self.latest);
        for _ in 0..MOST_TICKS {
            if at - self.latest <= TICK {
                break;
            }
            self.latest = self.latest + TICK;
            self.pass(Input::Tick);
        }
        self.latest = at;
        self.pass(input);
    }

    fn pass(&mut self, input: Input) {
        if self.failure.is_none() {
            self.failure = (self.sink)(self.latest, input).err();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The instants of times in seconds, in milliseconds.
    fn stamps(times_s: &[u64]) -> (Vec<i64>, u64, u64) {
        let zero = times_s.first().copied().unwrap_or_default() * 1_000_000;
        let mut timeline = Timeline::new(zero);
        let mut next = times_s.iter().skip(1).map(|time| time * 1_000_000);
        let stamps = times_s.iter().map(|time| {
            let stamp = timeline.stamp(time * 1_000_000, next.next());
            stamp.as_micros() / 1_000_000
        });
        (stamps.collect(), timeline.damaged, timeline.steps)
    }

    #[test]
    fn a_time_that_leaps_alone_is_damage_and_a_long_silence_is_none() {
        assert_eq!(stamps(&[10, 11, 99_999, 12]), (vec![0, 1, 1, 2], 1, 0));
        assert_eq!(
            stamps(&[10, 11, 5_000, 5_001]),
            (vec![0, 1, 4_990, 4_991], 0, 0)
        );
    }

    #[test]
    fn a_date_that_is_set_back_goes_on_where_it_was_and_disorder_waits() {
        assert_eq!(
            stamps(&[5_000, 5_001, 1_401, 1_402]),
            (vec![0, 1, 1, 2], 0, 1)
        );
        assert_eq!(stamps(&[10, 12, 11, 13]), (vec![0, 2, 2, 3], 0, 0));
    }
}
