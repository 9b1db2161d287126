//! Merges the recordings of several stations into one: their inputs in the order of one clock, with links of their own.
//!
//! It gets inputs with their times and gives the same back; reading and writing files is its caller's. It interprets no input.

mod clocks;

use posebridge_telemetry::{
    HostClock, Input, LinkId, OutsideFix, Ownership, RobotId, StationInput, TimeDelta, Timestamp,
};

pub use clocks::{AlignedClock, AlignmentSource, MeasuredOffset, MergedClock, align_clocks};

use crate::container::TruthSample;

/// Where a recording stands in the merged one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RecordingPlace {
    /// From 0.
    pub station: u16,
    /// What its first link becomes.
    pub first_link: u16,
    /// Host clock of its station minus that of the merged recording.
    pub clock_ahead: TimeDelta,
}

/// An input that has no place in a merged recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MergeError {
    /// Nothing says which station it is of.
    #[error(
        "it holds observations without a link, of data of another program: only recordings of stations can be merged"
    )]
    Observation,
    #[error("it is a merged recording itself: merge the recordings that it was made of, together with the others")]
    Merged,
    #[error("link {link} is one too many: a recording has at most 65536")]
    TooManyLinks { link: LinkId },
}

impl RecordingPlace {
    pub fn time(&self, own: Timestamp<HostClock>) -> Timestamp<HostClock> {
        own - self.clock_ahead
    }

    pub fn link(&self, own: LinkId) -> Result<LinkId, MergeError> {
        let link = self.first_link.checked_add(own.0).map(LinkId);
        link.ok_or(MergeError::TooManyLinks { link: own })
    }

    pub fn robot(&self, own: RobotId) -> Result<RobotId, MergeError> {
        Ok(RobotId { link: self.link(own.link)?, ..own })
    }

    /// A sample of a robot's truth. One without a robot is of the only robot there was, whose id is `only`.
    pub fn truth(&self, sample: TruthSample, only: Option<RobotId>) -> Result<TruthSample, MergeError> {
        let robot = sample.robot.map(|own| self.robot(own)).transpose()?;
        Ok(TruthSample { robot: robot.or(only), ..sample })
    }

    /// The input as the merged recording holds it.
    pub fn input(&self, input: Input) -> Result<Input, MergeError> {
        Ok(match input {
            Input::Bytes { link, peer, bytes } => Input::Bytes { link: self.link(link)?, peer, bytes },
            Input::Link { link, state } => Input::Link { link: self.link(link)?, state },
            Input::PeerAddress { link, peer, host } => Input::PeerAddress { link: self.link(link)?, peer, host },
            Input::Port { link, counts } => Input::Port { link: self.link(link)?, counts },
            Input::RobotCommand { robot, command } => Input::RobotCommand { robot: self.robot(robot)?, command },
            Input::Ownership { robot, mut ownership } => {
                if let Ownership::Owner { state: Some(state), .. } = &mut ownership {
                    state.clock_offset += self.clock_ahead;
                }
                Input::Ownership { robot: self.robot(robot)?, ownership }
            }
            Input::OutsideFix { robot, fix } => {
                Input::OutsideFix { robot: self.robot(robot)?, fix: OutsideFix { time: self.time(fix.time), ..fix } }
            }
            Input::Command(command) => self.without_link(Input::Command(command), StationInput::Command(command)),
            Input::Report { severity, text } => {
                let of_station = StationInput::Report { severity, text: text.clone() };
                self.without_link(Input::Report { severity, text }, of_station)
            }
            Input::Tick => self.without_link(Input::Tick, StationInput::Tick),
            Input::Observation(_) => return Err(MergeError::Observation),
            Input::OfStation { .. } => return Err(MergeError::Merged),
        })
    }

    fn without_link(&self, of_first: Input, input: StationInput) -> Input {
        match self.station {
            0 => of_first,
            station => Input::OfStation { station, input },
        }
    }
}

/// The inputs of several recordings in the order of the merged clock; of equal times that of an earlier recording is first. The inputs of
/// one recording keep their order, also where bytes arrived before an input that stands before them.
pub struct MergedInputs<I> {
    sources: Vec<Source<I>>,
}

struct Source<I> {
    place: RecordingPlace,
    inputs: I,
    next: Option<(Timestamp<HostClock>, Input)>,
    /// The latest time so far, the next one included.
    latest: Timestamp<HostClock>,
}

/// An input of a merged recording.
#[derive(Clone, Debug, PartialEq)]
pub struct MergedInput {
    /// Index of the recording that it is from.
    pub source: usize,
    pub time: Timestamp<HostClock>,
    pub input: Input,
}

impl<I: Iterator<Item = (Timestamp<HostClock>, Input)>> MergedInputs<I> {
    pub fn new(recordings: impl IntoIterator<Item = (RecordingPlace, I)>) -> Self {
        let sources = recordings.into_iter().map(|(place, inputs)| {
            let mut source = Source { place, inputs, next: None, latest: Timestamp::from_nanos(i64::MIN) };
            source.advance();
            source
        });
        Self { sources: sources.collect() }
    }
}

impl<I: Iterator<Item = (Timestamp<HostClock>, Input)>> Source<I> {
    fn advance(&mut self) {
        self.next = self.inputs.next().map(|(own, input)| (self.place.time(own), input));
        if let Some((time, _)) = &self.next {
            self.latest = self.latest.max(*time);
        }
    }
}

impl<I: Iterator<Item = (Timestamp<HostClock>, Input)>> Iterator for MergedInputs<I> {
    type Item = Result<MergedInput, MergeError>;

    fn next(&mut self) -> Option<Self::Item> {
        let waiting = self.sources.iter_mut().enumerate().filter(|(_, source)| source.next.is_some());
        let (index, source) = waiting.min_by_key(|(_, source)| source.latest)?;
        let (time, input) = source.next.take()?;
        source.advance();
        Some(source.place.input(input).map(|input| MergedInput { source: index, time, input }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, Command, Fix, LinkState, Meters, PeerId, Point2, RobotSnapshot};

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    fn bytes(link: u16, content: u8) -> Input {
        Input::Bytes { link: LinkId(link), peer: PeerId(3), bytes: vec![content] }
    }

    fn place(station: u16, first_link: u16, ahead_ms: i64) -> RecordingPlace {
        RecordingPlace { station, first_link, clock_ahead: TimeDelta::from_millis(ahead_ms) }
    }

    #[test]
    fn inputs_are_in_the_order_of_one_clock_and_a_recording_keeps_its_own_order() {
        // The third of the first was queued: it arrived before the second.
        let first = vec![(at(0), Input::Tick), (at(30), Input::Tick), (at(10), bytes(0, 1)), (at(40), Input::Tick)];
        let second = vec![(at(115), bytes(0, 2)), (at(130), Input::Tick), (at(131), Input::Tick)];
        let merged = MergedInputs::new([(place(0, 0, 0), first.into_iter()), (place(1, 2, 100), second.into_iter())]);
        let merged: Vec<(usize, i64)> =
            merged.map(Result::unwrap).map(|one| (one.source, one.time.as_nanos() / 1_000_000)).collect();
        assert_eq!(merged, [(0, 0), (1, 15), (0, 30), (0, 10), (1, 30), (1, 31), (0, 40)]);
    }

    #[test]
    fn links_are_renumbered_and_what_has_none_says_its_station() {
        let second = place(1, 2, 100);
        let robot = |link| RobotId { link: LinkId(link), address: Address::new(7, 1) };
        let owned = |link, offset_ms| {
            let state = Some(RobotSnapshot { bytes: vec![1], clock_offset: TimeDelta::from_millis(offset_ms) });
            Input::Ownership { robot: robot(link), ownership: Ownership::Owner { epoch: 4, state } }
        };
        let seen = |link, time_ms| Input::OutsideFix {
            robot: robot(link),
            fix: OutsideFix {
                source: Address::new(1, 100),
                time: Timestamp::from_millis(time_ms),
                uncertainty: TimeDelta::from_millis(1),
                fix: Fix {
                    position: Point2::new(Meters(1.0), Meters(2.0)),
                    heading: None,
                    covariance: None,
                    tag_in_body: Point2::new(Meters(0.0), Meters(0.0)),
                    reset_counter: 0,
                },
            },
        };
        let command = Command::ResetPose;
        let up = |link| Input::Link { link: LinkId(link), state: LinkState::Up };
        let of_second = |input| Input::OfStation { station: 1, input };
        for (input, expected) in [
            (bytes(1, 5), bytes(3, 5)),
            (up(0), up(2)),
            (Input::RobotCommand { robot: robot(1), command }, Input::RobotCommand { robot: robot(3), command }),
            (owned(0, 20), owned(2, 120)),
            (seen(1, 500), seen(3, 400)),
            (Input::Command(command), of_second(StationInput::Command(command))),
            (Input::Tick, of_second(StationInput::Tick)),
        ] {
            assert_eq!(second.input(input), Ok(expected));
        }
        for input in [Input::Tick, Input::Command(command), Input::Report { severity: 6, text: "saved".to_owned() }] {
            assert_eq!(place(0, 0, 0).input(input.clone()), Ok(input));
        }
        assert_eq!(second.input(of_second(StationInput::Tick)), Err(MergeError::Merged));
        let last = LinkId(u16::MAX);
        assert_eq!(second.input(bytes(u16::MAX, 0)), Err(MergeError::TooManyLinks { link: last }));
    }
}
