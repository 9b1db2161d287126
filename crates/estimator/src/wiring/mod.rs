//! Finds what is connected, counted or configured wrongly on a robot, from the ratio between gyro, wheels and fixes.
//!
//! It gets the observations of one robot as they come, and gives a [`WiringFinding`] once when one fault explains what the
//! sensors disagree about, within two turns or two metres. It corrects nothing and changes no estimate. See `evidence` for
//! the decision, `windows` for the comparisons.

mod evidence;
mod fault;
mod finding;
mod motion_log;
mod settings;
mod windows;

use posebridge_telemetry::{
    BrickClock, DriveGeometry, Fix, Observation, ObservationKind, SensorId, TimeDelta, Timestamp,
};
use serde::{Deserialize, Serialize};

use self::evidence::{Evidence, SavedEvidence, WindowKind};
use self::motion_log::{MotionLog, SavedLog};
use self::settings::Settings;
use self::windows::{FixPoint, PreviousSegment, Segment, TurnWindow};
use crate::filter::FilterConfig;
use crate::motion::{MotionReading, MotionSource};
use crate::saved::RestoreError;

pub use self::fault::WiringFault;
pub use self::finding::{DecidingObservation, RatioKind, WiringFinding, WiringRatio};

/// A smaller rotation of both wheels needs no sample of its own: 4 mm of a wheel of 56 mm.
const WHEEL_SPACING_RAD: f64 = 0.15;
/// Fine enough for a gyro whose radians are taken for degrees.
const GYRO_SPACING_RAD: f64 = 0.0005;
/// Rotation of both wheels together in a window for gyro and wheels: half a radian of a LEGO robot on the spot.
const TURN_WINDOW_RAD: f64 = 2.0;
const MIN_TURN_WINDOW: TimeDelta = TimeDelta::from_millis(300);
/// Over a longer time the gyro's bias counts too much.
const MAX_TURN_WINDOW: TimeDelta = TimeDelta::from_millis(5_000);
/// Rotation of both wheels together between two fixes: 11 cm of a LEGO robot straight ahead, or 115 degrees on the spot.
const SEGMENT_RAD: f64 = 8.0;
/// A segment is so many times longer than the position's noise.
const SEGMENT_SIGMAS: f64 = 8.0;
const MIN_SEGMENT: TimeDelta = TimeDelta::from_millis(1_000);
const MAX_SEGMENT: TimeDelta = TimeDelta::from_millis(120_000);
/// Motion between two observations that are farther apart is unknown.
const MAX_GAP: TimeDelta = TimeDelta::from_millis(1_500);
/// How long a fix waits for the gyro's observation of its instant.
const GYRO_PATIENCE: TimeDelta = TimeDelta::from_millis(500);
/// The wheel for an odometer that reports metres: that of a LEGO robot.
const ODOMETER_RADIUS_M: f64 = 0.028;

/// The detector of one robot.
#[derive(Clone, Debug)]
pub struct WiringMonitor {
    settings: Settings,
    source: Option<MotionSource>,
    last_reading: Option<(Timestamp<BrickClock>, MotionReading)>,
    /// Rotation of the left and of the right wheel, rad.
    wheels: MotionLog<2>,
    /// The gyro's turn, rad.
    gyro: MotionLog<1>,
    turn_start: Option<Timestamp<BrickClock>>,
    anchor: Option<FixPoint>,
    pending: Option<FixPoint>,
    previous: Option<PreviousSegment>,
    evidence: Evidence,
}

/// A detector without its settings.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SavedMonitor {
    source: Option<MotionSource>,
    last_reading: Option<(Timestamp<BrickClock>, MotionReading)>,
    wheels: SavedLog<2>,
    gyro: SavedLog<1>,
    turn_start: Option<Timestamp<BrickClock>>,
    anchor: Option<FixPoint>,
    pending: Option<FixPoint>,
    previous: Option<PreviousSegment>,
    evidence: SavedEvidence,
}

impl WiringMonitor {
    pub fn new(config: &FilterConfig) -> Self {
        Self {
            settings: Settings::new(config),
            source: None,
            last_reading: None,
            wheels: MotionLog::new(WHEEL_SPACING_RAD),
            gyro: MotionLog::new(GYRO_SPACING_RAD),
            turn_start: None,
            anchor: None,
            pending: None,
            previous: None,
            evidence: Evidence::new(),
        }
    }

    pub fn save(&self) -> SavedMonitor {
        let Self { settings: _, source, last_reading, wheels, gyro, turn_start, anchor, pending, previous, evidence } =
            self;
        SavedMonitor {
            source: *source,
            last_reading: *last_reading,
            wheels: wheels.save(),
            gyro: gyro.save(),
            turn_start: *turn_start,
            anchor: *anchor,
            pending: *pending,
            previous: *previous,
            evidence: evidence.save(),
        }
    }

    /// This detector with what another one of the same configuration has found.
    pub fn with_saved(&self, saved: &SavedMonitor) -> Result<Self, RestoreError> {
        Ok(Self {
            settings: self.settings,
            source: saved.source,
            last_reading: saved.last_reading,
            wheels: MotionLog::new(WHEEL_SPACING_RAD).with_saved(&saved.wheels)?,
            gyro: MotionLog::new(GYRO_SPACING_RAD).with_saved(&saved.gyro)?,
            turn_start: saved.turn_start,
            anchor: saved.anchor,
            pending: saved.pending,
            previous: saved.previous,
            evidence: Evidence::restored(&saved.evidence),
        })
    }

    /// Uses an observation, corrected by the wiring that is configured. An observation that is older than another one of its
    /// sensor is not used, except for fixes.
    pub fn observe(&mut self, observation: &Observation) -> Option<WiringFinding> {
        match observation.measurement {
            ObservationKind::WheelAngles { .. }
            | ObservationKind::OdometerPose(_)
            | ObservationKind::BodyVelocity { .. } => {
                let reading = MotionReading::from_observation(&observation.measurement)?;
                self.push_reading(observation.stamp, reading);
            }
            ObservationKind::TurnRate(rate) if rate.0.is_finite() => self.push_rate(observation.stamp, rate.0),
            ObservationKind::Fix(ref fix) => self.push_fix(observation.stamp, observation.sensor, fix),
            ObservationKind::TurnRate(_)
            | ObservationKind::WheelAccelerations { .. }
            | ObservationKind::Landmark { .. }
            | ObservationKind::BeaconRange { .. }
            | ObservationKind::WallRange(_)
            | ObservationKind::CompassHeading(_)
            | ObservationKind::Temperature(_) => return None,
        }
        let has_evidence = self.close_turn_window() | self.close_segment();
        if has_evidence { self.evidence.take_finding() } else { None }
    }

    /// The geometry that a robot has described: what was observed so far says nothing of it.
    pub fn set_geometry(&mut self, geometry: DriveGeometry) {
        self.settings.geometry = geometry;
        self.evidence = Evidence::new();
        self.forget_motion();
    }

    /// After a restart of the brick's clock no stamp holds; the evidence does.
    pub fn restart_clock(&mut self) {
        self.forget_motion();
    }

    fn forget_motion(&mut self) {
        self.forget_wheels();
        self.gyro.clear();
    }

    /// The motion until now is unknown.
    fn forget_wheels(&mut self) {
        self.last_reading = None;
        self.wheels.clear();
        self.turn_start = None;
        self.anchor = None;
        self.pending = None;
        self.previous = None;
    }

    fn push_reading(&mut self, time: Timestamp<BrickClock>, reading: MotionReading) {
        if self.source.is_some_and(|source| reading.source() < source) {
            return;
        }
        if self.source != Some(reading.source()) {
            self.source = Some(reading.source());
            self.forget_wheels();
        }
        let Some((last_time, last)) = self.last_reading else {
            self.wheels.push(time, [0.0, 0.0]);
            self.last_reading = Some((time, reading));
            return;
        };
        if time <= last_time {
            return;
        }
        let dt = time - last_time;
        let radii_m = self.radii_m();
        let travel = last.travel_to(&reading, dt.as_secs_f64(), &self.settings.geometry);
        let step_rad = travel.map(|travel| [travel.left_m / radii_m[0], travel.right_m / radii_m[1]]);
        let limit_rad = self.settings.max_wheel_rad_per_s * dt.as_secs_f64() + 2.0 * self.settings.geometry.tick.0;
        let Some(step_rad) = step_rad.filter(|step| dt <= MAX_GAP && step.iter().all(|step| step.abs() <= limit_rad))
        else {
            self.forget_wheels();
            self.wheels.push(time, [0.0, 0.0]);
            self.last_reading = Some((time, reading));
            return;
        };
        self.last_reading = Some((time, reading));
        let before = self.wheels.last().map_or([0.0, 0.0], |sample| sample.totals);
        self.wheels.push(time, [before[0] + step_rad[0], before[1] + step_rad[1]]);
    }

    fn push_rate(&mut self, time: Timestamp<BrickClock>, rate_rad_per_s: f64) {
        let Some(last) = self.gyro.last() else {
            self.gyro.push(time, [0.0]);
            return;
        };
        let (dt, mut before_rad) = (time - last.time, last.totals[0]);
        if dt <= TimeDelta::ZERO {
            return;
        }
        if dt > MAX_GAP {
            self.gyro.clear();
            self.turn_start = None;
            before_rad = 0.0;
        }
        self.gyro.push(time, [before_rad + rate_rad_per_s * dt.as_secs_f64()]);
    }

    fn push_fix(&mut self, time: Timestamp<BrickClock>, sensor: SensorId, fix: &Fix) {
        let point = FixPoint::new(time, sensor, fix, [self.settings.fix_sigma_m, self.settings.heading_sigma_rad]);
        let Some(point) = point else {
            return;
        };
        let Some(anchor) = self.anchor else {
            self.anchor = Some(point);
            return;
        };
        let age = time - anchor.time;
        if age > MAX_SEGMENT || (anchor.sensor == sensor && anchor.reset_counter != fix.reset_counter) {
            self.anchor = Some(point);
            self.pending = None;
            self.previous = None;
        } else if anchor.sensor == sensor
            && age >= MIN_SEGMENT
            && self.pending.is_none_or(|pending| time > pending.time + MAX_GAP)
        {
            self.pending = Some(point);
        }
    }

    /// Radii for rotations: those of the wheels, or nominal ones for an odometer that reports metres.
    fn radii_m(&self) -> [f64; 2] {
        match self.source {
            Some(MotionSource::Wheels) => {
                let DriveGeometry { left_wheel_radius, right_wheel_radius, .. } = self.settings.geometry;
                [left_wheel_radius.0, right_wheel_radius.0]
            }
            Some(MotionSource::Odometer | MotionSource::Velocity) | None => [ODOMETER_RADIUS_M; 2],
        }
    }

    /// Compares gyro and wheels if both have observed enough since the last time.
    fn close_turn_window(&mut self) -> bool {
        let (Some(wheels), Some(gyro)) = (self.wheels.last(), self.gyro.last()) else {
            return false;
        };
        let end = wheels.time.min(gyro.time);
        let Some(start) = self.turn_start else {
            let firsts = self.wheels.first().zip(self.gyro.first());
            self.turn_start = firsts.map(|(wheels, gyro)| wheels.time.max(gyro.time));
            return false;
        };
        if end - start < MIN_TURN_WINDOW {
            return false;
        }
        let totals = (self.wheels.at(start).zip(self.wheels.at(end))).zip(self.gyro.at(start).zip(self.gyro.at(end)));
        let Some(((from, to), ([gyro_from], [gyro_to]))) = totals else {
            self.turn_start = Some(end);
            return false;
        };
        let rotation_rad = [to[0] - from[0], to[1] - from[1]];
        if rotation_rad[0].abs() + rotation_rad[1].abs() < TURN_WINDOW_RAD {
            if end - start > MAX_TURN_WINDOW {
                self.turn_start = Some(end);
            }
            return false;
        }
        self.turn_start = Some(end);
        let window = TurnWindow::new(rotation_rad, gyro_to - gyro_from, (end - start).as_secs_f64(), self.radii_m());
        let settings = self.settings;
        self.evidence.add(WindowKind::Gyro, |_, hypothesis| window.compare(hypothesis, &settings));
        true
    }

    /// Compares fixes with the wheels, and with the gyro, if the motion up to the last fix is known and long enough.
    fn close_segment(&mut self) -> bool {
        let (Some(anchor), Some(pending), Some(wheels)) = (self.anchor, self.pending, self.wheels.last()) else {
            return false;
        };
        let needed = if self.gyro.last().is_some_and(|gyro| gyro.time < pending.time) {
            pending.time + GYRO_PATIENCE
        } else {
            pending.time
        };
        if wheels.time < needed {
            return false;
        }
        self.pending = None;
        let Some((from, to)) = self.wheels.at(anchor.time).zip(self.wheels.at(pending.time)) else {
            self.anchor = Some(pending);
            self.previous = None;
            return false;
        };
        let radii_m = self.radii_m();
        let length_rad = (to[0] - from[0]).abs() + (to[1] - from[1]).abs();
        let radius_m = (0.5 * (radii_m[0] + radii_m[1])).clamp(0.005, 0.5);
        let noise_rad = SEGMENT_SIGMAS * 2.0 * anchor.sigma_m.max(pending.sigma_m) / radius_m;
        if length_rad < SEGMENT_RAD.max(noise_rad) {
            return false;
        }
        let gyro_rad = self.gyro.at(anchor.time).zip(self.gyro.at(pending.time)).map(|([from], [to])| to - from);
        let segment = Segment { from: anchor, to: pending, gyro_rad, radii_m };
        let path = segment.path(&self.wheels);
        let previous = self.previous.take();
        let mut next = PreviousSegment::new(&segment);
        let settings = self.settings;
        self.evidence.add(WindowKind::Fixes, |index, hypothesis| {
            let motion = segment.motion(path.clone(), hypothesis, &settings);
            next.set(index, motion);
            segment.compare(motion, previous.as_ref().map(|one| one.with(index)), hypothesis, &settings)
        });
        self.previous = Some(next);
        self.anchor = Some(pending);
        true
    }
}
