//! Whether a robot is set up, from an open link to an estimate that it acknowledges: each step with its state, its figure and what to
//! do. The page, the terminal view and `posebridge doctor --robot` show the same list.
//!
//! The input is the station's events of one robot and of all links; times are instants of the host's clock.

use std::collections::BTreeMap;

use posebridge_telemetry::{
    BrickClock, Event, HostClock, LinkHealth, LinkId, LinkState, ObservationKind, Radians, RobotId, TimeDelta,
    Timestamp,
};

/// What was not heard for so long does not come any more. The health of links comes once per second.
const MAX_SILENCE: TimeDelta = TimeDelta::from_millis(2_500);
/// A wheel that turned less may only have trembled.
const MIN_ROTATION_RAD: f64 = 0.2;
/// A larger step between two readings is a restart of the counters.
const MAX_STEP_RAD: f64 = 20.0;
/// After so much driving the wiring monitor has decided.
const ENOUGH_TRAVEL_M: f64 = 2.0;
const ENOUGH_TURN_RAD: f64 = 4.0 * std::f64::consts::PI;
/// A slower motion may be noise.
const MIN_SPEED_M_PER_S: f64 = 0.02;
const MIN_TURN_RAD_PER_S: f64 = 0.1;
/// Of a link that only keeps itself alive fewer frames leave.
const MIN_SENT_PER_S: f64 = 3.0;
/// Two estimates further apart are not joined by one motion.
const MAX_ESTIMATE_GAP: TimeDelta = TimeDelta::from_millis(500);
/// A larger share of damaged frames loses information that a robot steers by.
const MAX_DAMAGED_SHARE: f64 = 0.05;
/// A larger uncertainty of the clock shifts a robot at 0.3 m/s by 6 mm.
const MAX_CLOCK_UNCERTAINTY: TimeDelta = TimeDelta::from_millis(20);

/// The steps in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupStep {
    Link,
    Bytes,
    Frames,
    Wheels,
    Clock,
    Wiring,
    Camera,
    Estimate,
    Answer,
}

impl SetupStep {
    pub const fn as_text(self) -> &'static str {
        match self {
            Self::Link => "link open",
            Self::Bytes => "bytes come",
            Self::Frames => "frames decode",
            Self::Wheels => "wheel counts move",
            Self::Clock => "clock aligned",
            Self::Wiring => "gyro and units",
            Self::Camera => "camera",
            Self::Estimate => "estimate sent back",
            Self::Answer => "robot acknowledges",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepState {
    Done,
    /// Missing, and not necessary.
    Optional,
    /// Something has to happen first.
    Waiting,
    Problem,
}

impl StepState {
    pub const fn as_text(self) -> &'static str {
        match self {
            Self::Done => "ok",
            Self::Optional => "optional",
            Self::Waiting => "waiting",
            Self::Problem => "problem",
        }
    }
}

/// A line of the list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChecklistItem {
    pub step: SetupStep,
    pub state: StepState,
    pub figure: String,
    /// What to do; empty if nothing.
    pub advice: &'static str,
}

/// Whether nothing is left to do.
pub fn is_complete(items: &[ChecklistItem]) -> bool {
    items.iter().all(|item| matches!(item.state, StepState::Done | StepState::Optional))
}

#[derive(Clone, Copy, Debug, Default)]
struct LinkActivity {
    state: Option<LinkState>,
    /// The last two reports.
    reports: [Option<(Timestamp<HostClock>, LinkHealth)>; 2],
}

impl LinkActivity {
    fn latest(&self) -> LinkHealth {
        self.reports[1].map(|(_, health)| health).unwrap_or_default()
    }

    /// Per second, between the last two reports; zero without them.
    fn rate(&self, count: fn(&LinkHealth) -> u64) -> f64 {
        let [Some((from, before)), Some((to, after))] = self.reports else { return 0.0 };
        let passed_s = (to - from).as_secs_f64();
        if passed_s > 0.0 { count(&after).saturating_sub(count(&before)) as f64 / passed_s } else { 0.0 }
    }
}

/// When something came, and how often.
#[derive(Clone, Copy, Debug, Default)]
struct Arrivals {
    count: u64,
    first: Option<Timestamp<HostClock>>,
    last: Option<Timestamp<HostClock>>,
}

impl Arrivals {
    fn add(&mut self, now: Timestamp<HostClock>) {
        self.count += 1;
        self.first.get_or_insert(now);
        self.last = Some(now);
    }

    fn is_recent(&self, now: Timestamp<HostClock>) -> bool {
        self.last.is_some_and(|last| now - last <= MAX_SILENCE)
    }

    fn rate_hz(&self) -> f64 {
        let span = self.first.zip(self.last).map_or(TimeDelta::ZERO, |(first, last)| last - first);
        if span > TimeDelta::ZERO { (self.count - 1) as f64 / span.as_secs_f64() } else { 0.0 }
    }
}

/// What was heard of one robot and of the links.
#[derive(Clone, Debug, Default)]
pub struct SetupChecklist {
    robot: Option<RobotId>,
    links: BTreeMap<LinkId, LinkActivity>,
    wheels: Arrivals,
    last_angles: Option<[Radians; 2]>,
    rotation_rad: [f64; 2],
    gyro: Arrivals,
    fixes: Arrivals,
    /// Of the last fix, behind the filter's time.
    fix_lag: TimeDelta,
    clock_uncertainty: Option<TimeDelta>,
    answers: Arrivals,
    estimates: Arrivals,
    last_estimate: Option<Timestamp<BrickClock>>,
    travel_m: f64,
    turn_rad: f64,
}

impl SetupChecklist {
    #[expect(clippy::wildcard_enum_match_arm, reason = "the other events change nothing here")]
    pub fn observe(&mut self, now: Timestamp<HostClock>, event: &Event) {
        match event {
            Event::Link { link, state } => self.links.entry(*link).or_default().state = Some(*state),
            Event::Health { link, health, .. } => {
                let activity = self.links.entry(*link).or_default();
                activity.reports = [activity.reports[1], Some((now, *health))];
            }
            Event::ObservationAligned { robot, observation, .. } => {
                self.robot = Some(*robot);
                self.on_observation(now, &observation.measurement);
            }
            Event::ObservationFused { record, .. } if record.kind == "fix" => self.fix_lag = record.lag,
            // A codec of a board without a clock answers for it, in no time.
            Event::BrickClockAligned { uncertainty, round_trip: Some(round_trip), .. }
                if *round_trip > TimeDelta::ZERO =>
            {
                self.clock_uncertainty = Some(*uncertainty);
                self.answers.add(now);
            }
            // Counters and clock begin anew.
            Event::BrickRestarted { .. } => {
                self.last_angles = None;
                self.last_estimate = None;
                self.clock_uncertainty = None;
            }
            Event::EstimateUpdated { estimate, .. } => {
                self.estimates.add(now);
                let step = self.last_estimate.map(|last| estimate.stamp - last);
                if let Some(step) = step.filter(|step| *step > TimeDelta::ZERO && *step <= MAX_ESTIMATE_GAP) {
                    self.travel_m += motion_above(MIN_SPEED_M_PER_S, estimate.forward_speed.0) * step.as_secs_f64();
                    self.turn_rad += motion_above(MIN_TURN_RAD_PER_S, estimate.turn_rate.0) * step.as_secs_f64();
                }
                self.last_estimate = Some(estimate.stamp);
            }
            _ => {}
        }
    }

    #[expect(clippy::wildcard_enum_match_arm, reason = "the other observations are of no step")]
    fn on_observation(&mut self, now: Timestamp<HostClock>, measurement: &ObservationKind) {
        match *measurement {
            ObservationKind::WheelAngles { left, right } => {
                self.wheels.add(now);
                if let Some(last) = self.last_angles.replace([left, right]) {
                    for (sum, (before, after)) in self.rotation_rad.iter_mut().zip(last.into_iter().zip([left, right]))
                    {
                        let step_rad = (after.0 - before.0).abs();
                        *sum += if step_rad <= MAX_STEP_RAD { step_rad } else { 0.0 };
                    }
                }
            }
            ObservationKind::OdometerPose(_) | ObservationKind::BodyVelocity { .. } => self.wheels.add(now),
            ObservationKind::TurnRate(_) => self.gyro.add(now),
            ObservationKind::Fix(_) => self.fixes.add(now),
            _ => {}
        }
    }

    /// Every step. `wiring` is what was found to be connected, counted or configured wrongly.
    pub fn items(&self, now: Timestamp<HostClock>, wiring: Option<String>) -> Vec<ChecklistItem> {
        let link = self.link();
        let mut items = vec![link_item(link.as_ref()), self.bytes_item(link.as_ref()), frames_item(link.as_ref())];
        items.extend([self.wheels_item(now), self.clock_item(), self.wiring_item(now, wiring), self.camera_item(now)]);
        items.extend([self.estimate_item(now, link.as_ref()), self.answer_item(now)]);
        items
    }

    /// The robot's link; before it was heard the one that is most active.
    fn link(&self) -> Option<LinkActivity> {
        let of_robot = self.robot.and_then(|robot| self.links.get(&robot.link));
        let busiest =
            || self.links.values().max_by_key(|link| (link.state == Some(LinkState::Up), link.latest().bytes_in));
        of_robot.or_else(busiest).copied()
    }

    fn bytes_item(&self, link: Option<&LinkActivity>) -> ChecklistItem {
        let received = link.map_or(0, |link| link.latest().bytes_in);
        let rate = link.map_or(0.0, |link| link.rate(|health| health.bytes_in));
        if rate > 0.0 || (received > 0 && link.is_some_and(|link| link.reports[0].is_none())) {
            return item(SetupStep::Bytes, StepState::Done, format!("{rate:.0} B/s"), "");
        }
        let figure = if received > 0 { format!("none now; {received} before") } else { "none yet".to_owned() };
        let advice = "switch the robot on and start its program; check plug, crossed wires (TX to RX) and baud rate";
        let state = if self.robot.is_some() { StepState::Problem } else { StepState::Waiting };
        item(SetupStep::Bytes, state, figure, advice)
    }

    fn wheels_item(&self, now: Timestamp<HostClock>) -> ChecklistItem {
        let [left_rad, right_rad] = self.rotation_rad;
        let has_moved = match self.last_angles {
            Some(_) => left_rad.min(right_rad) >= MIN_ROTATION_RAD,
            None => self.travel_m > 0.05 || self.turn_rad > 0.5,
        };
        if self.wheels.count == 0 {
            let advice = "let the robot send its wheel counts: PB_WHEEL_TICKS, WHEEL_DISTANCE or a line of text";
            return item(SetupStep::Wheels, StepState::Waiting, "no counts yet", advice);
        }
        if !self.wheels.is_recent(now) {
            let advice = "look why the robot stopped sending wheel counts: its program, its battery, the link";
            return item(SetupStep::Wheels, StepState::Problem, "no counts any more", advice);
        }
        let rate_hz = self.wheels.rate_hz();
        if has_moved {
            let figure = if self.last_angles.is_some() {
                format!("left {left_rad:.1} rad, right {right_rad:.1} rad, {rate_hz:.0} Hz")
            } else {
                format!("{:.2} m, {rate_hz:.0} Hz", self.travel_m)
            };
            return item(SetupStep::Wheels, StepState::Done, figure, "");
        }
        let still = match (left_rad >= MIN_ROTATION_RAD, right_rad >= MIN_ROTATION_RAD) {
            (true, false) => "the right one has not turned",
            (false, true) => "the left one has not turned",
            (false, false) | (true, true) => "neither has turned",
        };
        item(
            SetupStep::Wheels,
            StepState::Waiting,
            format!("{rate_hz:.0} Hz, {still}"),
            "drive, or turn both wheels by hand",
        )
    }

    fn clock_item(&self) -> ChecklistItem {
        let Some(uncertainty) = self.clock_uncertainty else {
            if self.wheels.count > 0 {
                let advice = "let the robot answer TIMESYNC, which bounds its clock from both sides";
                return item(SetupStep::Clock, StepState::Optional, "by the arrival of what it sends", advice);
            }
            return item(
                SetupStep::Clock,
                StepState::Waiting,
                "not yet",
                "let the robot stamp what it sends with its own clock",
            );
        };
        let figure = format!("± {:.1} ms", uncertainty.as_millis_f64());
        if uncertainty <= MAX_CLOCK_UNCERTAINTY {
            return item(SetupStep::Clock, StepState::Done, figure, "");
        }
        item(
            SetupStep::Clock,
            StepState::Optional,
            figure,
            "let the robot answer TIMESYNC, which bounds its clock from both sides",
        )
    }

    fn wiring_item(&self, now: Timestamp<HostClock>, wiring: Option<String>) -> ChecklistItem {
        if let Some(finding) = wiring {
            return item(
                SetupStep::Wiring,
                StepState::Problem,
                finding,
                "`--fix-wiring` prints the lines of the configuration; then start the station again",
            );
        }
        if !self.gyro.is_recent(now) && !self.fixes.is_recent(now) {
            let advice = "add a gyro or a camera: without one nothing tells whether ticks, radius and track are right";
            return item(SetupStep::Wiring, StepState::Optional, "no gyro and no camera to compare with", advice);
        }
        let turns = self.turn_rad / std::f64::consts::TAU;
        let figure = format!("after {:.1} m and {turns:.1} turns", self.travel_m);
        if self.travel_m >= ENOUGH_TRAVEL_M || self.turn_rad >= ENOUGH_TURN_RAD {
            return item(SetupStep::Wiring, StepState::Done, format!("plausible {figure}"), "");
        }
        item(
            SetupStep::Wiring,
            StepState::Waiting,
            format!("too little motion {figure}"),
            "drive 2 m or turn twice on the spot",
        )
    }

    fn camera_item(&self, now: Timestamp<HostClock>) -> ChecklistItem {
        if self.fixes.count == 0 {
            let advice = "without a camera the pose is relative to where the robot started, and drifts";
            return item(SetupStep::Camera, StepState::Optional, "no fix yet", advice);
        }
        let figure = format!("{:.1} Hz, {:.0} ms behind", self.fixes.rate_hz(), self.fix_lag.as_millis_f64());
        if self.fixes.is_recent(now) {
            return item(SetupStep::Camera, StepState::Done, figure, "");
        }
        item(
            SetupStep::Camera,
            StepState::Problem,
            "no fix any more",
            "look whether the camera still sees the robot's tag",
        )
    }

    fn estimate_item(&self, now: Timestamp<HostClock>, link: Option<&LinkActivity>) -> ChecklistItem {
        if !self.estimates.is_recent(now) {
            return item(SetupStep::Estimate, StepState::Waiting, "no estimate", "it follows the first wheel counts");
        }
        // Heartbeats and requests for the time are fewer.
        let rate = link.map_or(0.0, |link| link.rate(|health| health.frames_out));
        if rate >= MIN_SENT_PER_S {
            let figure = format!("{:.0} estimates/s, the link sends {rate:.0} frames/s", self.estimates.rate_hz());
            return item(SetupStep::Estimate, StepState::Done, figure, "");
        }
        let figure = format!("{:.0} estimates/s, none sent", self.estimates.rate_hz());
        item(
            SetupStep::Estimate,
            StepState::Optional,
            figure,
            "`outputs` of the link send it, to a board with lines of text `estimate_interval_ms`",
        )
    }

    fn answer_item(&self, now: Timestamp<HostClock>) -> ChecklistItem {
        let silence = self.answers.last.map(|last| now - last);
        match silence {
            Some(silence) if silence <= TimeDelta::from_millis(10_000) => {
                item(SetupStep::Answer, StepState::Done, format!("{} answers", self.answers.count), "")
            }
            Some(silence) => {
                let figure = format!("no answer for {:.0} s", silence.as_secs_f64());
                item(
                    SetupStep::Answer,
                    StepState::Problem,
                    figure,
                    "look whether the robot still reads what it is sent",
                )
            }
            None => {
                let advice = "a robot that answers TIMESYNC shows that it reads what it is sent";
                item(SetupStep::Answer, StepState::Optional, "none yet", advice)
            }
        }
    }
}

fn motion_above(least: f64, speed: f64) -> f64 {
    Some(speed.abs()).filter(|speed| *speed >= least).unwrap_or(0.0)
}

fn item(step: SetupStep, state: StepState, figure: impl Into<String>, advice: &'static str) -> ChecklistItem {
    ChecklistItem { step, state, figure: figure.into(), advice }
}

fn link_item(link: Option<&LinkActivity>) -> ChecklistItem {
    let advice = "look for the port, its permissions and programs that hold it: `posebridge doctor`";
    let is_reported = link.is_some_and(|link| link.latest().bytes_in > 0);
    match link.and_then(|link| link.state) {
        Some(LinkState::Down) => item(SetupStep::Link, StepState::Problem, "down", advice),
        Some(LinkState::Up) => item(SetupStep::Link, StepState::Done, "up", ""),
        None if is_reported => item(SetupStep::Link, StepState::Done, "up", ""),
        None => item(SetupStep::Link, StepState::Waiting, "not open yet", advice),
    }
}

fn frames_item(link: Option<&LinkActivity>) -> ChecklistItem {
    let health = link.map(LinkActivity::latest).unwrap_or_default();
    if health.frames_in == 0 {
        if health.bytes_in == 0 {
            return item(SetupStep::Frames, StepState::Waiting, "none yet", "first bytes have to come");
        }
        let figure = format!("none in {} bytes", health.bytes_in);
        let advice = "another baud rate or protocol: `posebridge doctor URL` names it, `--brick` sets it";
        return item(SetupStep::Frames, StepState::Problem, figure, advice);
    }
    let now = |count| link.map_or(0.0, |link| link.rate(count));
    let (rate, damaged) = (now(|health| health.frames_in), now(|health| health.checksum_errors));
    if rate <= 0.0 && now(|health| health.bytes_in) > 0.0 {
        let advice = "the bytes that come now are no frames: has the robot changed its baud rate or its program?";
        return item(SetupStep::Frames, StepState::Problem, "none any more", advice);
    }
    let damaged = if rate + damaged > 0.0 { damaged / (rate + damaged) } else { 0.0 };
    let figure = format!("{rate:.0} frames/s, {:.1} % damaged", damaged * 100.0);
    if damaged > MAX_DAMAGED_SHARE {
        let advice = "a shorter cable, a lower baud rate, or less noise near the radio";
        return item(SetupStep::Frames, StepState::Problem, figure, advice);
    }
    item(SetupStep::Frames, StepState::Done, figure, "")
}
