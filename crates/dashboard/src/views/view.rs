//! The interface of a view.

use posebridge_telemetry::{Address, Event, HostClock, LinkId, RobotId, TimeDelta, Timestamp};

use crate::api::DeadReckoningBuilder;
use crate::feed::{SimulatedTruth, StationStatus};
use crate::model::Frame;

/// Robots that get all the points of the policy each; more robots share as many, so that the history of a full class is a message that
/// a browser can process.
const ROBOTS_WITH_ALL_POINTS: usize = 8;

/// An event, truth sample or status for a view.
#[derive(Clone, Copy, Debug)]
pub enum ViewInput<'a> {
    Event(&'a Event),
    Truth(&'a SimulatedTruth),
    Status(&'a StationStatus),
}

/// The content of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameContent {
    Delta,
    /// Updates and the data that is sent once a second.
    DeltaAndSummary,
}

/// Which points a time series keeps for the history.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RetentionPolicy {
    /// The points of the last `duration`, at most `max_points`, evenly spaced.
    SlidingWindow { duration: TimeDelta, max_points: usize },
    /// The whole session, at most `max_points`: when it is full every second normal point is dropped, and important
    /// ones only if they alone fill it.
    WholeSession { max_points: usize },
}

impl RetentionPolicy {
    pub(super) fn map_points(self, change: impl Fn(usize) -> usize) -> Self {
        match self {
            Self::SlidingWindow { duration, max_points } => {
                Self::SlidingWindow { duration, max_points: change(max_points) }
            }
            Self::WholeSession { max_points } => Self::WholeSession { max_points: change(max_points) },
        }
    }

    /// With a sliding window that is longer by this factor, for a quantity that changes slowly.
    pub(super) fn lasting(self, factor: i64) -> Self {
        match self {
            Self::SlidingWindow { duration, max_points } => {
                Self::SlidingWindow { duration: TimeDelta::from_nanos(duration.as_nanos() * factor), max_points }
            }
            Self::WholeSession { .. } => self,
        }
    }

    /// For a series with one point a second: `live_points` live, one `share`-th of the points for a whole session.
    pub(super) fn for_seconds(self, live_points: usize, share: usize) -> Self {
        self.map_points(|points| match self {
            Self::SlidingWindow { .. } => live_points,
            Self::WholeSession { .. } => points / share,
        })
    }

    pub(super) fn shared_by(self, robots: usize) -> Self {
        self.map_points(|points| shared_points(points, robots))
    }
}

/// The points of one of some robots.
pub(super) fn shared_points(points: usize, robots: usize) -> usize {
    let all = points * ROBOTS_WITH_ALL_POINTS;
    (all / robots.max(ROBOTS_WITH_ALL_POINTS)).max(points.min(1))
}

/// The links, the history length and the program's functions of a view.
#[derive(Clone, Debug)]
pub struct ViewConfig {
    pub links: Vec<String>,
    pub retention: RetentionPolicy,
    pub dead_reckoning: Option<DeadReckoningBuilder>,
}

impl ViewConfig {
    pub(super) fn link_name(&self, link: LinkId) -> String {
        let name = self.links.get(usize::from(link.0));
        name.cloned().unwrap_or_else(|| format!("link {link}"))
    }
}

/// One panel's part of the messages.
pub trait View: Send {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>);

    /// True once after a change.
    fn take_change(&mut self) -> bool {
        false
    }

    /// Adds the updates since the last call: unless a view does better, all that it retains, when it has changed and once a second,
    /// because a reader that was slow may have missed the change.
    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        if self.take_change() || content == FrameContent::DeltaAndSummary {
            self.add_history(frame);
        }
    }

    /// Adds the retained data.
    fn add_history(&self, history: &mut Frame);

    /// Points dropped since the start.
    fn dropped(&self) -> u64 {
        0
    }
}

pub fn robot_name(robot: RobotId) -> String {
    robot.path()
}

pub fn parse_robot_name(name: &str) -> Option<RobotId> {
    let mut parts = name.split('/');
    let link = LinkId(parts.next()?.parse().ok()?);
    let address = Address::new(parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    let robot = RobotId { link, address };
    // Other spellings of the numbers, such as `+1`, are no names.
    (robot_name(robot) == name).then_some(robot)
}
