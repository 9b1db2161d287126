//! The simulated world as one value: robot, sensors, brick and camera behind one link, and the truth beside it.
//!
//! It advances only when [`Simulation::step`] is called and knows no other time. Bytes go in and come out; how they
//! travel, and how fast the steps follow each other, is the caller's business.

use std::collections::VecDeque;

use posebridge_protocol::dialect;
use posebridge_protocol::framing::{ScanCounters, Scanned, Scanner, ScannerConfig};
use posebridge_protocol::message::Message;
use posebridge_telemetry::{
    Address, Arena, BrickClock, DriveGeometry, HostClock, MetersPerSecond, Point2, Pose,
    RadiansPerSecond, SensorNoise, Span, Stamp,
};

use crate::camera::{Camera, CameraFix};
use crate::clock::SkewedClock;
use crate::firmware::Firmware;
use crate::path::Path;
use crate::scenario::{Scenario, Steering};
use crate::sensors::SensorBoard;
use crate::wheels::Pair;
use crate::world::{Body, STEP};

/// What really happened at one instant. It is never sent to the station.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// World time.
    pub world: Span,
    /// The brick's clock at that instant, as if its ticks were infinitely fine and its register never wrapped.
    pub brick: Stamp<BrickClock>,
    /// Where the robot was.
    pub pose: Pose<Arena>,
    /// Along the body's x axis, slip left out.
    pub forward_speed: MetersPerSecond,
    /// About the vertical, slip left out.
    pub turn_rate: RadiansPerSecond,
    /// Where the brick's own dead reckoning, begun at the start pose, believed the robot to be.
    pub odometry: Pose<Arena>,
    /// Where the brick believed the robot to be: the last estimate that it used, carried forward by its own odometry. A brick that
    /// steers by odometry alone uses none.
    pub belief: Pose<Arena>,
    /// Distance of the true position from the nearest place of the ideal path, in metres.
    pub cross_track_m: f64,
    /// What the brick steered by.
    pub steering: Steering,
}

/// A usable estimate as it reached the brick, whether the brick then used it or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceivedEstimate {
    /// World time of its arrival.
    pub world: Span,
    /// The brick's clock at that instant, as if its ticks were infinitely fine and its register never wrapped.
    pub arrival: Stamp<BrickClock>,
    /// The instant of the brick's clock of which it speaks.
    pub instant: Stamp<BrickClock>,
    /// Where it says the robot was, or will be, at that instant.
    pub pose: Pose<Arena>,
}

impl ReceivedEstimate {
    /// How old it was when it arrived, in brick time; negative if it speaks of an instant yet to come.
    #[must_use]
    pub fn age(&self) -> Span {
        self.arrival - self.instant
    }
}

/// Whether a simulation remembers what has been.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum History {
    /// All of it.
    Kept,
    /// Nothing: a brick that runs for days must not fill the memory.
    Forgotten,
}

/// A simulated robot with its brick and its camera.
#[derive(Debug)]
pub struct Simulation {
    scenario: Scenario,
    world: Span,
    path: Path,
    polyline: Vec<Point2<Arena>>,
    body: Body,
    board: SensorBoard,
    brick_clock: SkewedClock,
    firmware: Firmware,
    /// What the motors run on until the brick says something else.
    duty: Pair<f64>,
    camera: Option<Camera>,
    scanner: Scanner,
    outgoing: VecDeque<Vec<u8>>,
    history: History,
    /// Truth samples that were due so far.
    samples: u64,
    truth: Vec<TruthSample>,
    received: Vec<ReceivedEstimate>,
}

impl Simulation {
    /// The world of a scenario at its beginning, the robot at rest at the start pose.
    #[must_use]
    pub fn new(scenario: Scenario) -> Self {
        let path = Path::new(&scenario);
        let brick_clock = SkewedClock::new(scenario.brick.clock());
        let firmware = Firmware::new(&scenario, path.clone(), brick_clock.reading(Span::ZERO));
        let camera = scenario
            .camera
            .is_present
            .then(|| Camera::new(scenario.camera.clone(), scenario.seed));
        let mut simulation = Self {
            world: Span::ZERO,
            polyline: path.polyline(),
            body: Body::new(&scenario, path.start()),
            board: SensorBoard::new(&scenario),
            brick_clock,
            firmware,
            duty: Pair::default(),
            camera,
            scanner: Scanner::new(ScannerConfig::default()),
            outgoing: VecDeque::new(),
            history: History::Kept,
            samples: 0,
            truth: Vec::new(),
            received: Vec::new(),
            path,
            scenario,
        };
        simulation.log_truth();
        simulation
    }

    /// The same world, which keeps neither truth nor estimates nor camera fixes from here on: for runs without end.
    #[must_use]
    pub fn without_history(mut self) -> Self {
        self.history = History::Forgotten;
        if let Some(camera) = &mut self.camera {
            camera.forget();
        }
        self
    }

    /// Advances the world by [`STEP`](crate::STEP). Call [`Self::poll`] until it is empty afterwards.
    pub fn step(&mut self) {
        self.world += STEP;
        let now = self.brick_clock.reading(self.world);
        self.body.step(self.duty);
        self.board.sense(&self.body);
        self.duty = self.firmware.step(now, &mut self.board);
        if let Some(camera) = &mut self.camera {
            camera.step(self.world, self.body.pose());
        }
        self.collect();
        self.log_truth();
    }

    /// The next bytes on the way to the station: one or more whole frames of one sender.
    pub fn poll(&mut self) -> Option<Vec<u8>> {
        self.outgoing.pop_front()
    }

    /// Takes bytes that arrive from the station at this moment, in any pieces; damage is skipped.
    pub fn receive(&mut self, bytes: &[u8]) {
        let now = Stamp::<HostClock>::from_nanos(self.world.as_nanos());
        let mut messages = Vec::new();
        let mut sink = |scanned: Scanned<'_>| messages.extend(understood(&scanned));
        self.scanner.tick(now, &mut sink);
        self.scanner.push(now, bytes, &mut sink);
        let brick_now = self.brick_clock.reading(self.world);
        for (from, message) in messages {
            let estimate = self.firmware.handle(brick_now, from, &message);
            let received = estimate.map(|(instant, pose)| ReceivedEstimate {
                world: self.world,
                arrival: self.brick_clock.exact(self.world),
                instant,
                pose,
            });
            if self.history == History::Kept {
                self.received.extend(received);
            }
            if let Some(camera) = &mut self.camera {
                camera.handle(self.world, from, &message);
            }
        }
        self.collect();
    }

    /// Switches the brick off and on: its clock and counters begin at zero, its session and message intervals anew, and
    /// its biases change. Its place on the path and its odometry are kept, as by a program that stores its progress.
    pub fn restart_brick(&mut self) {
        self.brick_clock.restart(self.world);
        self.board.restart();
        self.firmware.restart(self.brick_clock.reading(self.world));
        self.duty = Pair::default();
    }

    /// What brick and camera have found in the bytes that came: their counterpart to the station's link health.
    pub const fn heard(&self) -> &ScanCounters {
        self.scanner.counters()
    }

    /// World time since the beginning.
    pub const fn elapsed(&self) -> Span {
        self.world
    }

    /// Whether the path is driven to its end and the robot stands.
    pub fn is_finished(&self) -> bool {
        self.firmware.is_finished() && self.body.is_at_rest()
    }

    /// How much of the path is driven, 0 to 1.
    pub fn progress(&self) -> f64 {
        self.firmware.progress()
    }

    /// The truth at the beginning and after each telemetry period of world time.
    pub fn truth(&self) -> &[TruthSample] {
        &self.truth
    }

    /// The usable estimates that reached the brick, in the order of their arrival.
    pub fn received_estimates(&self) -> &[ReceivedEstimate] {
        &self.received
    }

    /// The ideal path of one lap as points.
    pub fn path(&self) -> &[Point2<Arena>] {
        &self.polyline
    }

    /// Everything that the camera sent so far, outliers marked.
    pub fn camera_fixes(&self) -> &[CameraFix] {
        self.camera.as_ref().map_or(&[], Camera::log)
    }

    /// The nominal geometry and the sensors' noise: what a careful builder could know of this robot.
    pub fn robot_description(&self) -> (DriveGeometry, SensorNoise) {
        (self.scenario.drive_geometry(), self.scenario.sensor_noise())
    }

    /// Where the robot was put down.
    pub fn start_pose(&self) -> Pose<Arena> {
        self.path.start()
    }

    /// The scenario that runs, with its seed.
    pub const fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    fn collect(&mut self) {
        self.outgoing.extend(self.firmware.take());
        self.outgoing
            .extend(self.camera.as_mut().and_then(Camera::take));
    }

    fn log_truth(&mut self) {
        let period_s = 1.0 / self.scenario.brick.telemetry_hz;
        let due = Span::from_secs_f64(self.samples as f64 * period_s);
        if self.history == History::Forgotten || self.world < due {
            return;
        }
        self.samples += 1;
        let pose = self.body.pose();
        self.truth.push(TruthSample {
            world: self.world,
            brick: self.brick_clock.exact(self.world),
            pose,
            forward_speed: MetersPerSecond(self.body.forward_m_per_s()),
            turn_rate: RadiansPerSecond(self.body.turn_rad_per_s()),
            odometry: self.firmware.odometry(self.path.start()),
            belief: self.firmware.belief(),
            cross_track_m: self.path.distance_m(pose.origin()),
            steering: self.firmware.steering(self.brick_clock.reading(self.world)),
        });
    }
}

/// The message of a whole frame, if this end knows it.
fn understood(scanned: &Scanned<'_>) -> Option<(Address, Message)> {
    match scanned {
        Scanned::Frame(frame) => match dialect::decode(frame) {
            Ok(Some(message)) => Some((frame.source, message)),
            // A brick has nobody to complain to about a payload that makes no sense.
            Ok(None) | Err(_) => None,
        },
        Scanned::Unknown(_) | Scanned::Defect(_) => None,
    }
}
