//! How many observations came from each source, were gated and were late: every one of them, however much the lines are thinned.

use std::collections::BTreeMap;

use posebridge_telemetry::{Event, FusionRecord, HostClock, RobotId, SensorId, Span, Stamp, Verdict};

use super::trail::{MOST_ROBOTS, Trails, Weight};
use super::{Keep, Pace, Setting, Told, View, robot_name};
use crate::limits::SECOND;
use crate::model::{Frame, TallyPoint, seconds_of};

/// What comes this far behind the filter's time counts as late: three readings of a brick at 20 Hz. The page's marks have the same
/// (`web/model/marks.js`).
const LATE_FROM: Span = Span::from_millis(150);
/// So many sources are counted; a robot has about four.
const MOST_SOURCES: usize = 4 * MOST_ROBOTS;
/// The share of a recording's points that the counts of one source have: one a second of more than half an hour, then fewer.
const SHARE: usize = 10;

/// Of which robot, and from where.
type Source = (RobotId, (SensorId, &'static str));

/// Counts since the beginning.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    seen: u64,
    gated: u64,
    late: u64,
}

/// The counts of each source.
pub(super) struct Tallies {
    counted: BTreeMap<Source, Tally>,
    /// Each second of a recording; of a live session only the counts themselves are of use.
    seconds: Trails<(SensorId, &'static str), TallyPoint>,
    next_second: Stamp<HostClock>,
    last: Stamp<HostClock>,
    ignored: u64,
}

impl Tallies {
    pub(super) fn new(setting: &Setting) -> Self {
        let keep = match setting.keep {
            Keep::Latest { span, .. } => Keep::Latest { span, most: 0 },
            Keep::Whole { most } => Keep::Whole { most: most / SHARE },
        };
        Self {
            counted: BTreeMap::new(),
            seconds: Trails::new(keep, MOST_SOURCES),
            next_second: Stamp::ZERO,
            last: Stamp::ZERO,
            ignored: 0,
        }
    }

    fn count(&mut self, source: Source, record: &FusionRecord) {
        if !self.counted.contains_key(&source) && self.counted.len() >= MOST_SOURCES {
            self.ignored += 1;
            return;
        }
        let tally = self.counted.entry(source).or_default();
        tally.seen += 1;
        tally.gated += u64::from(record.verdict == Verdict::Gated);
        tally.late += u64::from(record.lag >= LATE_FROM);
    }

    fn note_second(&mut self) {
        for (source, tally) in &self.counted {
            let point = point_of(self.last, source.1, *tally);
            self.seconds.push(self.last, *source, (point, Weight::Usual));
        }
        // What is told are the counts as they stand.
        drop(self.seconds.take_news());
    }

    fn add_now(&self, frame: &mut Frame) {
        for ((robot, source), tally) in &self.counted {
            let point = point_of(self.last, *source, *tally);
            frame.robot(&robot_name(*robot)).tallies.push(point);
        }
    }
}

impl View for Tallies {
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        let Told::Event(Event::Fused { robot, record }) = told else {
            return;
        };
        if now >= self.next_second {
            self.note_second();
            self.next_second = now + SECOND;
        }
        self.last = self.last.max(now);
        self.count((*robot, (record.sensor, record.kind)), record);
    }

    fn add_news(&mut self, frame: &mut Frame, pace: Pace) {
        if pace == Pace::Second {
            self.add_now(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.seconds.kept() {
            history.robot(&robot_name(robot)).tallies.extend(points);
        }
        self.add_now(history);
    }

    fn dropped(&self) -> u64 {
        self.ignored
    }
}

fn point_of(at: Stamp<HostClock>, (sensor, kind): (SensorId, &'static str), tally: Tally) -> TallyPoint {
    TallyPoint {
        t_s: seconds_of(at),
        sensor: sensor.name().to_owned(),
        kind: kind.to_owned(),
        seen: tally.seen,
        gated: tally.gated,
        late: tally.late,
    }
}
