//! Path follower: rests, turns in place, drives legs. Uses the estimated pose and the path, never the truth.
//!
//! # Model
//! ```text
//! turn rate = v (curvature - a heading error - b lateral error)      along a leg, v the commanded speed
//! ```
//! With a = 8/m and b = 16/m² both errors are critically damped over a length of 0.25 m. A robot far from its path approaches it at an
//! angle of at most one radian; one with a larger heading error first turns in place, as after being carried.

use posebridge_telemetry::{Arena, BrickClock, Heading, Point2, Pose, TimeDelta, Timestamp};

use super::speed_control::PERIOD_S;
use crate::path::{Path, PathLeg};
use crate::scenario::{DriveEnd, DriveSettings};

const HEADING_PER_M: f64 = 8.0;
const LATERAL_PER_M2: f64 = 16.0;
const ACCELERATION_M_PER_S2: f64 = 0.5;
const ACCELERATION_RAD_PER_S2: f64 = 6.0;
/// Planned deceleration; below the limit because the motors follow with a lag of a tenth of a second.
const BRAKING_M_PER_S2: f64 = 0.3;
const BRAKING_RAD_PER_S2: f64 = 2.0;
/// Lowest speed commands before a goal, so that the robot reaches it.
const CREEP_M_PER_S: f64 = 0.02;
const CREEP_RAD_PER_S: f64 = 0.15;
/// A leg ends this far before its end; a turn this far from its heading.
const LEG_END_M: f64 = 0.002;
const TURN_END_RAD: f64 = 0.017;
/// A goal is reached this near: nearer, its direction changes faster than the robot turns.
const GOAL_END_M: f64 = 0.02;

/// Limit of the approach angle: beyond it the robot would turn back rather than approach.
const STEEPEST_APPROACH_RAD: f64 = 1.0;
/// Heading error above which the robot turns in place first. Beyond the steepest approach, so that an approach continues.
const TURN_FIRST_RAD: f64 = 1.3;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Twist {
    pub(crate) forward_m_per_s: f64,
    pub(crate) turn_rad_per_s: f64,
}

#[derive(Clone, Copy, Debug)]
enum Manoeuvre {
    Rest(TimeDelta),
    Turn(Heading),
    Drive { leg: usize },
}

/// What a person asks for in place of the path.
#[derive(Clone, Copy, Debug)]
enum ManualCommand {
    Twist { twist: Twist, until: Timestamp<BrickClock> },
    Goal(Point2<Arena>),
}

#[derive(Clone, Debug)]
pub(crate) struct Follower {
    settings: DriveSettings,
    path: Path,
    program: Vec<Manoeuvre>,
    next: usize,
    begun: Option<Timestamp<BrickClock>>,
    /// Distance along the current leg; never decreases.
    along_m: f64,
    completed_m: f64,
    pub(crate) laps_done: u64,
    command: Twist,
    /// After it the robot stands until it is sent back to its path.
    manual_command: Option<ManualCommand>,
}

impl Follower {
    pub(crate) fn new(settings: DriveSettings, path: Path) -> Self {
        let program = program(&settings, &path);
        Self {
            settings,
            path,
            program,
            next: 0,
            begun: None,
            along_m: 0.0,
            completed_m: 0.0,
            laps_done: 0,
            command: Twist::default(),
            manual_command: None,
        }
    }

    /// The motion for the next control period, given the brick's own estimate.
    pub(crate) fn command(&mut self, now: Timestamp<BrickClock>, estimate: Pose<Arena>) -> Twist {
        let requested = match self.manual_command {
            Some(ManualCommand::Twist { twist, until }) if now < until => twist,
            Some(ManualCommand::Twist { .. }) => Twist::default(),
            Some(ManualCommand::Goal(goal)) => self.approach(goal, estimate),
            None => self.follow(now, estimate),
        };
        let Twist { forward_m_per_s, turn_rad_per_s } = self.command;
        self.command = Twist {
            forward_m_per_s: slew(forward_m_per_s, requested.forward_m_per_s, ACCELERATION_M_PER_S2 * PERIOD_S),
            turn_rad_per_s: slew(turn_rad_per_s, requested.turn_rad_per_s, ACCELERATION_RAD_PER_S2 * PERIOD_S),
        };
        self.command
    }

    pub(crate) const fn drive_manually(&mut self, requested: Twist, until: Timestamp<BrickClock>) {
        self.manual_command = Some(ManualCommand::Twist { twist: requested, until });
    }

    /// Drives straight to a point and stands there.
    pub(crate) const fn go_to(&mut self, goal: Point2<Arena>) {
        self.manual_command = Some(ManualCommand::Goal(goal));
    }

    /// The speeds of full sticks.
    pub(crate) const fn full_speed(&self) -> Twist {
        Twist { forward_m_per_s: self.settings.speed_m_per_s, turn_rad_per_s: self.settings.turn_rate_rad_per_s }
    }

    /// Ends manual driving: continues at the point of the present lap that is nearest to the brick's own estimate.
    pub(crate) fn rejoin(&mut self, estimate: Pose<Arena>) {
        self.manual_command = None;
        let in_hand = self.program.iter().skip(self.next).find_map(leg_of);
        let Some(in_hand) = in_hand.or(self.program.iter().rev().find_map(leg_of)) else {
            return;
        };
        let (leg, along_m) = self.path.nearest(in_hand, estimate.origin());
        let index = self.program.iter().position(|one| leg_of(one) == Some(leg));
        // A path without a stop has all of its laps on one leg: on in the current lap.
        let lap_m = self.path.lap_length_m();
        let laps = if self.path.legs.len() == 1 { (self.along_m / lap_m).floor() } else { 0.0 };
        self.next = index.unwrap_or(self.next);
        self.begun = None;
        self.completed_m = self.path.legs.iter().take(leg).map(PathLeg::length_m).sum();
        self.along_m = along_m + laps * lap_m;
    }

    /// Also requires that no manual command is active.
    pub(crate) fn is_finished(&self) -> bool {
        self.next >= self.program.len() && self.command == Twist::default()
    }

    /// Driven share of the path, 0 to 1; of the current lap in an endless drive.
    pub(crate) fn progress(&self) -> f64 {
        let total_m = match self.settings.end {
            DriveEnd::LastLap => self.path.length_m(),
            DriveEnd::Never => self.path.lap_length_m(),
        };
        // Without a path there is nothing to drive.
        if total_m > 0.0 { ((self.completed_m + self.along_m) / total_m).clamp(0.0, 1.0) } else { 1.0 }
    }

    pub(crate) fn clock_restarted(&mut self) {
        self.begun = None;
        self.command = Twist::default();
        // The instant until which the hand held is one of the clock of before.
        if let Some(ManualCommand::Twist { until, .. }) = &mut self.manual_command {
            *until = Timestamp::ZERO;
        }
    }

    fn follow(&mut self, now: Timestamp<BrickClock>, estimate: Pose<Arena>) -> Twist {
        match self.program.get(self.next).copied() {
            Some(Manoeuvre::Rest(duration)) => {
                if now - *self.begun.get_or_insert(now) >= duration {
                    self.advance();
                }
                Twist::default()
            }
            Some(Manoeuvre::Turn(heading)) => {
                let error_rad = (heading - estimate.heading).0;
                if error_rad.abs() < TURN_END_RAD {
                    self.advance();
                    return Twist::default();
                }
                self.turn(error_rad)
            }
            Some(Manoeuvre::Drive { leg }) => self.drive(leg, estimate),
            None => Twist::default(),
        }
    }

    fn approach(&self, goal: Point2<Arena>, estimate: Pose<Arena>) -> Twist {
        let (x_m, y_m) = (goal.x.0 - estimate.x.0, goal.y.0 - estimate.y.0);
        let remaining_m = x_m.hypot(y_m);
        if remaining_m < GOAL_END_M {
            return Twist::default();
        }
        let error_rad = (Heading::from_rad(y_m.atan2(x_m)) - estimate.heading).0;
        if error_rad.abs() > STEEPEST_APPROACH_RAD {
            return self.turn(error_rad);
        }
        let braking = (2.0 * BRAKING_M_PER_S2 * remaining_m).sqrt();
        let speed = braking.min(self.settings.speed_m_per_s * error_rad.cos()).max(CREEP_M_PER_S);
        let limit = self.settings.turn_rate_rad_per_s;
        Twist { forward_m_per_s: speed, turn_rad_per_s: (speed * HEADING_PER_M * error_rad).clamp(-limit, limit) }
    }

    fn turn(&self, error_rad: f64) -> Twist {
        let braking = (2.0 * BRAKING_RAD_PER_S2 * error_rad.abs()).sqrt();
        let rate = braking.min(self.settings.turn_rate_rad_per_s).max(CREEP_RAD_PER_S);
        Twist { forward_m_per_s: 0.0, turn_rad_per_s: rate.copysign(error_rad) }
    }

    fn drive(&mut self, leg: usize, estimate: Pose<Arena>) -> Twist {
        let near_m = self.along_m;
        let Some(leg) = self.path.legs.get(leg) else {
            self.advance();
            return Twist::default();
        };
        let (length_m, here) = (leg.length_m(), leg.project(estimate.origin(), near_m));
        self.along_m = self.along_m.max(here.along_m);
        self.restart_lap();
        let remaining_m = length_m - self.along_m;
        if remaining_m < LEG_END_M {
            self.completed_m += length_m;
            self.advance();
            return Twist::default();
        }
        let heading_error_rad = (estimate.heading - here.heading).0;
        if heading_error_rad.abs() > TURN_FIRST_RAD {
            return self.turn(-heading_error_rad);
        }
        let braking = (2.0 * BRAKING_M_PER_S2 * remaining_m).sqrt();
        let speed = braking.min(self.settings.speed_m_per_s * heading_error_rad.cos().max(0.0)).max(CREEP_M_PER_S);
        let steepest_per_m = HEADING_PER_M * STEEPEST_APPROACH_RAD;
        let lateral_per_m = (LATERAL_PER_M2 * here.left_m).clamp(-steepest_per_m, steepest_per_m);
        let bend_per_m = here.curvature_per_m - HEADING_PER_M * heading_error_rad - lateral_per_m;
        let limit = self.settings.turn_rate_rad_per_s;
        Twist { forward_m_per_s: speed, turn_rad_per_s: (speed * bend_per_m).max(-limit).min(limit) }
    }

    /// Moves an endless path without a stop back by one lap after its first.
    fn restart_lap(&mut self) {
        let lap_m = self.path.lap_length_m();
        let is_endless = self.settings.end == DriveEnd::Never && self.path.legs.len() == 1;
        if is_endless && self.path.length_m() > lap_m && self.along_m > lap_m + WELL_INTO_M {
            self.along_m -= lap_m;
            self.laps_done += 1;
        }
    }

    fn advance(&mut self) {
        self.next += 1;
        self.begun = None;
        self.along_m = 0.0;
        if self.settings.end == DriveEnd::Never && self.next >= self.program.len() {
            // The first rest is for receivers that listen at the beginning.
            self.next = FIRST_LEG;
            self.completed_m = 0.0;
            self.laps_done += 1;
        }
    }
}

const FIRST_LEG: usize = 1;
/// Restarts a smooth lap only this far into the next: the projection searches a little backwards.
const WELL_INTO_M: f64 = 0.1;

const fn leg_of(manoeuvre: &Manoeuvre) -> Option<usize> {
    match manoeuvre {
        Manoeuvre::Drive { leg } => Some(*leg),
        Manoeuvre::Rest(_) | Manoeuvre::Turn(_) => None,
    }
}

/// Rests, legs and the turns between them; a closed path ends as it began.
fn program(settings: &DriveSettings, path: &Path) -> Vec<Manoeuvre> {
    let [pause, rest_after_lap] =
        [settings.pause_s, settings.rest_after_lap_s].map(|rest_s| Manoeuvre::Rest(TimeDelta::from_secs_f64(rest_s)));
    let mut program = vec![Manoeuvre::Rest(TimeDelta::from_secs_f64(settings.rest_s))];
    let legs = &path.legs;
    for (index, _) in legs.iter().enumerate() {
        program.extend([Manoeuvre::Drive { leg: index }, pause]);
        let next = legs.get(index + 1).or(legs.first().filter(|_| path.is_closed));
        let turns = legs.len() > 1;
        if let Some(heading) = next.filter(|_| turns).map(|leg: &PathLeg| leg.start().heading) {
            program.extend([Manoeuvre::Turn(heading), pause]);
        }
        let driven = index + 1;
        let ends_lap = driven == legs.len() || driven.is_multiple_of(path.lap_legs.max(1));
        if ends_lap && settings.rest_after_lap_s > 0.0 {
            program.push(rest_after_lap);
        }
    }
    program
}

fn slew(from: f64, to: f64, step: f64) -> f64 {
    from + (to - from).max(-step).min(step)
}

#[cfg(test)]
mod tests {
    use crate::scenario::{Course, Direction, Scenario};
    use posebridge_telemetry::{Meters, Transform2};

    use super::*;

    fn straight(length_m: f64) -> Follower {
        let scenario =
            Scenario { path: Course::Waypoints { points_m: vec![[0.0, 0.0], [length_m, 0.0]] }, ..Scenario::default() };
        Follower::new(scenario.drive, Path::new(&scenario))
    }

    #[test]
    fn a_robot_beside_its_path_comes_back_without_overshoot_and_stops_at_its_end() {
        let mut follower = straight(3.0);
        let mut pose = Pose::new(Meters(0.0), Meters(0.05), Heading::default());
        for step in 0..2_000 {
            // Driven as commanded without any lag.
            let twist = follower.command(Timestamp::from_millis(step * 10), pose);
            let turn = Heading::from_rad(twist.turn_rad_per_s * PERIOD_S);
            pose = pose * Transform2::new(Meters(twist.forward_m_per_s * PERIOD_S), Meters(0.0), turn);
            // 1.5 m after the rest of 2 s: six times the length over which errors die out.
            let bound_m = if pose.x.0 < 1.5 { 0.05 } else { 0.003 };
            assert!((-0.003..=bound_m).contains(&pose.y.0), "{pose:?}");
        }
        assert!(follower.is_finished());
        assert!((follower.progress() - 1.0).abs() < 1e-12);
        assert!((pose.x.0 - 3.0).abs() < 0.01, "{pose:?}");
    }

    #[test]
    fn a_robot_that_is_sent_behind_itself_turns_and_stands_at_the_goal() {
        let mut follower = straight(3.0);
        let goal = Point2::new(Meters(-0.5), Meters(0.3));
        follower.go_to(goal);
        let mut pose = Pose::default();
        for step in 0..2_000 {
            let twist = follower.command(Timestamp::from_millis(step * 10), pose);
            let turn = Heading::from_rad(twist.turn_rad_per_s * PERIOD_S);
            pose = pose * Transform2::new(Meters(twist.forward_m_per_s * PERIOD_S), Meters(0.0), turn);
        }
        assert!((pose.x.0 - goal.x.0).hypot(pose.y.0 - goal.y.0) < 0.03, "{pose:?}");
        assert_eq!(follower.command, Twist::default());
        // Back to its path, which it has not begun.
        follower.rejoin(pose);
        assert!(!follower.is_finished());
    }

    #[test]
    fn the_robot_rests_at_the_end_of_each_lap() {
        let drive = DriveSettings { laps: 2, rest_after_lap_s: 7.0, ..DriveSettings::default() };
        let long = |program: &[Manoeuvre]| {
            let is_long = |one: &&Manoeuvre| matches!(one, Manoeuvre::Rest(rest) if rest.as_secs_f64() == 7.0);
            program.iter().filter(is_long).count()
        };
        for path in [Course::default(), Course::Waypoints { points_m: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]] }] {
            let scenario = Scenario { path, drive, ..Scenario::default() };
            let follower = Follower::new(drive, Path::new(&scenario));
            assert_eq!(long(&follower.program), 2, "{:?}", scenario.path);
            assert!(matches!(follower.program.last(), Some(Manoeuvre::Rest(rest)) if rest.as_secs_f64() == 7.0));
        }
        let circles = Scenario {
            drive,
            path: Course::Circle { radius_m: 0.5, direction: Direction::Left },
            ..Scenario::default()
        };
        assert_eq!(long(&Follower::new(drive, Path::new(&circles)).program), 1);
    }

    #[test]
    fn commands_never_change_faster_than_allowed() {
        let mut follower = straight(0.5);
        let mut last = Twist::default();
        for step in 0..1_000 {
            // An estimated pose that jumps about.
            let y_m = if step % 7 == 0 { 0.2 } else { -0.1 };
            let twist = follower
                .command(Timestamp::from_millis(step * 10), Pose::new(Meters(0.0), Meters(y_m), Heading::default()));
            let change = (twist.turn_rad_per_s - last.turn_rad_per_s).abs();
            assert!(change <= ACCELERATION_RAD_PER_S2 * PERIOD_S + 1e-12);
            assert!(twist.forward_m_per_s - last.forward_m_per_s <= 0.005 + 1e-12);
            last = twist;
        }
    }
}
