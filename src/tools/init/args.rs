//! Flags of `init --guide`: every question has one.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use posebridge_estimator::hand_motions::{GuideSettings, GuideStep};
use posebridge_telemetry::TimeDelta;

use super::robot_source::RobotSource;
use crate::flags::positive;

/// A motion by hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MotionName {
    /// The left wheel, turned forward, with the robot lifted.
    Wheel,
    /// Both wheels, straight on.
    Straight,
    /// On the spot, to the left.
    Turn,
}

impl MotionName {
    pub(super) const fn step(self) -> GuideStep {
        match self {
            Self::Wheel => GuideStep::WheelTurn,
            Self::Straight => GuideStep::Straight,
            Self::Turn => GuideStep::SpotTurn,
        }
    }
}

/// When a motion happened in a recording, in seconds after its first reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionRange {
    pub motion: MotionName,
    pub from_s: f64,
    pub to_s: f64,
}

/// Flags of the guide.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Options of --guide and --from")]
pub struct GuideFlags {
    /// Listen on the link, find out what the robot speaks, ask for three motions by hand, and write what they show.
    #[arg(long)]
    pub guide: bool,
    /// Find the motions in this file instead of a live robot: a recording (*.mcap), a telemetry log (*.tlog) or a table (*.csv).
    #[arg(long, value_name = "FILE", conflicts_with_all = ["guide", "listen", "probe"])]
    pub from: Option<PathBuf>,
    /// What the robot speaks: mavlink, nxt, nxt-push, ev3, line or columns. Default: what the link carries.
    #[arg(long, value_name = "NAME")]
    pub brick: Option<String>,
    /// Ask a silent link whether a LEGO NXT or EV3 is there. Without it the program asks first.
    #[arg(long)]
    pub probe: bool,
    /// What each column of a text is, e.g. time_ms,left_ticks,right_ticks,ignore (docs/protocols/boards.md). Default: a guess.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub columns: Vec<String>,
    /// Counts per turn of a wheel, if they are known. Default: what the turned wheel counts.
    #[arg(long, value_name = "N", value_parser = positive)]
    pub ticks_per_turn: Option<f64>,
    /// How many turns the wheel is turned by hand.
    #[arg(long, value_name = "N", default_value_t = 1.0, value_parser = positive)]
    pub wheel_turns: f64,
    /// How far the robot is rolled straight on.
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = positive)]
    pub straight_m: f64,
    /// How many turns the robot is turned on the spot, to the left.
    #[arg(long, value_name = "N", default_value_t = 1.0, value_parser = positive)]
    pub turns: f64,
    /// Leave this motion out; what it shows is then taken from the named robot. Can be repeated.
    #[arg(long, value_name = "MOTION", value_enum)]
    pub skip: Vec<MotionName>,
    /// When each motion happened in the file, in seconds after its first reading, e.g. wheel=2-6,straight=9-14,turn=17-23.
    #[arg(long, value_name = "RANGES", value_delimiter = ',', value_parser = motion_range, requires = "from")]
    pub motions: Vec<MotionRange>,
    /// A motion is over when the wheels did not count for so long.
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = positive)]
    pub rest_s: f64,
    /// How long to listen for what the robot speaks.
    #[arg(long, value_name = "SECONDS", default_value_t = 4.0, value_parser = positive)]
    pub listen_for: f64,
    /// Give up when nothing new was heard of the robot, or no motion was made, for so long.
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0, value_parser = positive)]
    pub wait_s: f64,
    /// Accept every guess; ask nothing.
    #[arg(long)]
    pub yes: bool,
}

impl GuideFlags {
    /// `source` is the robot, whose motors may have a known number of counts.
    pub(super) fn settings(&self, source: &RobotSource) -> GuideSettings {
        let skipped = |step: &GuideStep| self.skip.iter().any(|skipped| skipped.step() == *step);
        GuideSettings {
            steps: GuideStep::ALL.into_iter().filter(|step| !skipped(step)).collect(),
            wheel_turns: self.wheel_turns,
            straight_m: self.straight_m,
            turns: self.turns,
            rest: TimeDelta::from_secs_f64(self.rest_s),
            ticks_per_turn: self.ticks_per_turn.or(source.known_ticks_per_turn()),
        }
    }
}

/// Parses `wheel=2-6`.
fn motion_range(text: &str) -> Result<MotionRange, String> {
    let wrong = || format!("`{text}`: write a motion and its time, such as wheel=2-6");
    let (name, range) = text.split_once('=').ok_or_else(wrong)?;
    let motion = MotionName::from_str(name.trim(), false)
        .map_err(|_unknown| format!("`{name}` is no motion; there are: wheel, straight, turn"))?;
    let (from, to) = range.split_once('-').ok_or_else(wrong)?;
    let second = |text: &str| text.trim().parse().ok().filter(|second: &f64| second.is_finite() && *second >= 0.0);
    match (second(from), second(to)) {
        (Some(from_s), Some(to_s)) if from_s < to_s => Ok(MotionRange { motion, from_s, to_s }),
        _ => Err(wrong()),
    }
}
