//! Telemetry whose every number is known, four kinds of damage to it, and the books of what was sent whole and what came of it.

use std::collections::VecDeque;

use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{Heartbeat, Message, Odometry, OdometryPose, PlanarImu, WireStamp};
use posebridge_telemetry::{
    Address, BrickClock, Event, Heading, LinkHealth, Meters, MetersPerSecond, Observation, ObservationKind, Pose,
    RadiansPerSecond, ReceiveError, Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

pub(crate) const BRICK: Address = Address::new(1, 1);
/// Numbers of two neighbouring messages differ by a hundred times this; the wire keeps them better.
const TOLERANCE: f64 = 1e-5;

/// What an observation says, as numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExpectedObservation {
    kind: &'static str,
    stamp: Timestamp<BrickClock>,
    values: [f64; 2],
}

impl ExpectedObservation {
    fn by(observation: &Observation, wheel_radius_m: f64) -> Self {
        let values = match observation.measurement {
            ObservationKind::WheelAngles { left, right } => [left.0, right.0].map(|rad| rad * wheel_radius_m),
            ObservationKind::TurnRate(rate) => [rate.0, 0.0],
            ObservationKind::OdometerPose(pose) => [pose.x.0, pose.y.0],
            other => panic!("nobody has sent {other:?}"),
        };
        Self { kind: observation.measurement.kind(), stamp: observation.stamp, values }
    }

    fn is(&self, other: &Self) -> bool {
        let near = |(a, b): (&f64, &f64)| (a - b).abs() <= TOLERANCE;
        self.kind == other.kind && self.stamp == other.stamp && self.values.iter().zip(&other.values).all(near)
    }
}

/// Round robin a heartbeat (21 bytes), SCALED_IMU (36), WHEEL_DISTANCE (149) and ODOMETRY (245), with numbers that no other
/// message near them has; `millis` is what the brick's clock shows.
pub(crate) fn message(number: i64, millis: i64) -> (Message, Option<ExpectedObservation>) {
    let stamp = WireStamp::Micros64(millis as u64 * 1_000);
    let expected = |kind, values| {
        let stamp = Timestamp::from_millis(millis);
        Some(ExpectedObservation { kind, stamp, values })
    };
    let step = number as f64;
    match number % 4 {
        0 => (HEARTBEAT, None),
        1 => {
            let rate_rad_per_s = 1e-3 * (number % 1_000 - 500) as f64;
            let imu = PlanarImu {
                stamp: WireStamp::Millis32(millis as u32),
                turn_rate: Some(RadiansPerSecond(rate_rad_per_s)),
                forward_acceleration: None,
            };
            let expected = expected("turn_rate", [rate_rad_per_s, 0.0]);
            (Message::ScaledImu(imu), expected)
        }
        2 => {
            let (left_m, right_m) = (1e-3 * step, 1.1e-3 * step);
            let expected = expected("wheel_angles", [left_m, right_m]);
            let (left, right) = (Meters(left_m), Meters(right_m));
            (Message::WheelDistance { stamp, left, right }, expected)
        }
        _ => {
            // Steps that 32 bits hold to a micrometre.
            let (x_m, y_m) = (1e-3 * (number % 10_000) as f64, -1e-3 * (number % 7_000) as f64);
            let pose = Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(0.3));
            let odometry = Odometry {
                stamp,
                pose: OdometryPose::Odom(pose),
                forward_speed: MetersPerSecond(0.2),
                turn_rate: RadiansPerSecond(0.0),
                covariance: Some([1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-3]),
                reset_counter: 0,
                quality: 90,
            };
            (Message::Odometry(odometry), expected("odometer_pose", [x_m, y_m]))
        }
    }
}

const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });

/// One kind of damage.
pub(crate) struct DamageKind {
    pub(crate) name: &'static str,
    seed: u64,
    damage: DamageFn,
    /// Frames come to an early end.
    pub(crate) tears: bool,
}

/// The four kinds for which parsers are compared, and none.
pub(crate) const DAMAGE_KINDS: [DamageKind; 5] = [
    kind("no damage", 1, none),
    DamageKind { tears: true, ..kind("one byte lost in 2 % of frames", 1, one_byte_lost) },
    kind("bit flips, 2e-4 per byte", 2, bits_flipped),
    DamageKind { tears: true, ..kind("frame tail lost in 2 %", 3, tail_lost) },
    kind("1-39 noise bytes before 5 %", 4, noise_before),
];

const fn kind(name: &'static str, seed: u64, damage: DamageFn) -> DamageKind {
    DamageKind { name, seed, damage, tears: false }
}

/// A brick behind a line that damages.
pub(crate) struct DamagedBrick {
    rng: Pcg64,
    encoder: Encoder,
    damage: DamageFn,
}

impl DamagedBrick {
    pub(crate) fn new(kind: &DamageKind) -> Self {
        Self { rng: Pcg64::seed_from_u64(kind.seed), encoder: Encoder::new(WireVersion::V2), damage: kind.damage }
    }

    /// What arrives of the message of this number; the books learn whether it is whole.
    pub(crate) fn send(&mut self, number: i64, millis: i64, ledger: &mut ObservationLedger) -> Vec<u8> {
        let (message, expected) = message(number, millis);
        let (mut frame, mut bytes) = (Vec::new(), Vec::new());
        self.encoder.encode(BRICK, &message, &mut frame);
        let condition = (self.damage)(&mut self.rng, &mut bytes, &mut frame);
        ledger.sent(expected, condition);
        bytes.extend_from_slice(&frame);
        bytes
    }
}

/// What became of a frame.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Condition {
    Whole,
    Damaged,
}

/// Damages a frame in place, or not; may put noise before it.
type DamageFn = fn(&mut Pcg64, &mut Vec<u8>, &mut Vec<u8>) -> Condition;

fn none(_rng: &mut Pcg64, _noise: &mut Vec<u8>, _frame: &mut Vec<u8>) -> Condition {
    Condition::Whole
}

fn one_byte_lost(rng: &mut Pcg64, _noise: &mut Vec<u8>, frame: &mut Vec<u8>) -> Condition {
    if !rng.random_bool(0.02) {
        return Condition::Whole;
    }
    frame.remove(rng.random_range(0..frame.len()));
    Condition::Damaged
}

fn bits_flipped(rng: &mut Pcg64, _noise: &mut Vec<u8>, frame: &mut Vec<u8>) -> Condition {
    let mut condition = Condition::Whole;
    for byte in frame {
        if rng.random_bool(2e-4) {
            *byte ^= 1 << rng.random_range(0..8);
            condition = Condition::Damaged;
        }
    }
    condition
}

fn tail_lost(rng: &mut Pcg64, _noise: &mut Vec<u8>, frame: &mut Vec<u8>) -> Condition {
    if !rng.random_bool(0.02) {
        return Condition::Whole;
    }
    frame.truncate(rng.random_range(1..frame.len()));
    Condition::Damaged
}

fn noise_before(rng: &mut Pcg64, noise: &mut Vec<u8>, _frame: &mut Vec<u8>) -> Condition {
    if rng.random_bool(0.05) {
        let length = rng.random_range(1..40);
        noise.extend((0..length).map(|_| rng.random::<u8>()));
    }
    Condition::Whole
}

/// What was sent whole, and what came of it.
pub(crate) struct ObservationLedger {
    wheel_radius_m: f64,
    intact: u64,
    /// Damaged frames behind which a whole one came: those that the sequence numbers can tell of.
    noticeable: u64,
    damaged_since: u64,
    /// What has still to be observed.
    pub(crate) pending: VecDeque<ExpectedObservation>,
    observed: u64,
    fused: u64,
    lost: u64,
    pub(crate) health: LinkHealth,
}

impl ObservationLedger {
    /// Empty ones, about a robot with wheels of this radius.
    pub(crate) fn new(wheel_radius_m: f64) -> Self {
        Self {
            wheel_radius_m,
            intact: 0,
            noticeable: 0,
            damaged_since: 0,
            pending: VecDeque::new(),
            observed: 0,
            fused: 0,
            lost: 0,
            health: LinkHealth::default(),
        }
    }

    pub(crate) fn sent(&mut self, expected: Option<ExpectedObservation>, condition: Condition) {
        if condition == Condition::Whole {
            if self.intact > 0 {
                self.noticeable += self.damaged_since;
            }
            self.damaged_since = 0;
            self.intact += 1;
            self.pending.extend(expected);
        } else {
            self.damaged_since += 1;
        }
    }

    /// What the station tells: every observation is the next one that it owes.
    pub(crate) fn on_event(&mut self, event: &Event) {
        match event {
            Event::ObservationAligned { observation, .. } => {
                let found = ExpectedObservation::by(observation, self.wheel_radius_m);
                let expected = self.pending.pop_front().expect("more came than was sent");
                assert!(found.is(&expected), "{found:?} is not {expected:?}");
                self.observed += 1;
            }
            Event::ObservationFused { .. } => self.fused += 1,
            Event::ReceiveError { defect: ReceiveError::SequenceGap { frames, .. }, .. } => {
                self.lost += u64::from(*frames);
            }
            Event::BrickRestarted { .. } => panic!("the clock runs on"),
            Event::Health { health, .. } => self.health = *health,
            _ => {}
        }
    }

    /// Prints what came, and holds it against what must be; the last health must have been told after the last frame.
    pub(crate) fn check(&self, name: &str, sent: i64) {
        let Self { intact, noticeable, observed, lost, health, .. } = self;
        println!(
            "{name:31} sent {sent}, intact {intact}, accepted {}, observed {observed}, counted as lost {lost} of {noticeable}, \
             stalls {}, checksum errors {}, unknown {}, garbage {} bytes",
            health.frames_in, health.timeouts, health.checksum_errors, health.unknown_ids, health.garbage_bytes
        );
        assert_eq!(health.frames_in, *intact, "{name}: accepted");
        assert_eq!(self.pending.len(), 0, "{name}: missing");
        assert_eq!(self.fused, *observed, "{name}: the estimator got them");
        assert_eq!(lost, noticeable, "{name}: lost");
        assert_eq!(health.frames_lost, *lost, "{name}: by the link's health");
        let is_damaged = name != "no damage";
        assert_eq!(health.garbage_bytes > 0, is_damaged, "{name}");
        // A flipped bit in a message's id makes a message that nobody knows: passed on, but not believed.
        let is_flipped = name.starts_with("bit flips");
        assert_eq!(health.unknown_ids > 0, is_flipped, "{name}");
    }
}
