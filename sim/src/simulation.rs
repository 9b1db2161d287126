//! The simulated world as one value: robot, sensors, brick and camera behind their links, and the truth beside it.
//!
//! A brick that speaks MAVLink shares one link with the camera. The others have a link of their own, since their protocols have no place for
//! a second speaker; the camera then speaks MAVLink on another one.
//!
//! It advances only when [`Simulation::step`] is called and knows no other time. Bytes go in and come out; how they
//! travel, and how fast the steps follow each other, is the caller's business.

mod faults;

use std::collections::VecDeque;

use posebridge_protocol::dialect;
use posebridge_protocol::framing::{ScanCounters, Scanned, Scanner, ScannerConfig};
use posebridge_protocol::message::Message;
use posebridge_telemetry::{
    Address, Arena, BrickClock, DriveGeometry, HostClock, MetersPerSecond, Point2, Pose, RadiansPerSecond, SensorNoise,
    Span, Stamp,
};

pub use self::faults::Doer;
use crate::camera::{Camera, CameraFix};
use crate::clock::SkewedClock;
use crate::path::Path;
use crate::personality::{Brick, When};
use crate::scenario::{DriveEnd, Scenario, Steering};
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

/// A drive without an end remembers this much of what has been, and at most [`FORGOTTEN_AT_ONCE`] more.
pub const REMEMBERED: Span = Span::from_millis(600_000);
/// So much is forgotten at once: to move what stays for each item would cost more than it saves.
pub const FORGOTTEN_AT_ONCE: Span = Span::from_millis(20_000);
/// No list grows beyond so many items, however fast they come: more than come in that time at 200 per second, as often as a
/// scenario can ask for.
const MOST_ITEMS: usize = 130_000;

/// Forgets the oldest items of a list that is in the order of the world's time.
pub(crate) fn forget_oldest<T>(history: History, world: Span, list: &mut Vec<T>, world_of: fn(&T) -> Span) {
    if history != History::Recent {
        return;
    }
    let begins = world - REMEMBERED;
    let oldest = list.first().map(world_of);
    if oldest.is_some_and(|oldest| oldest < begins - FORGOTTEN_AT_ONCE) {
        list.drain(..list.partition_point(|item| world_of(item) < begins));
    }
    if list.len() >= MOST_ITEMS {
        list.drain(..MOST_ITEMS / 16);
    }
}

/// Whether a simulation remembers what has been.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum History {
    /// All of it.
    Kept,
    /// The last of it: [`REMEMBERED`].
    Recent,
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
    brick: Brick,
    /// What the motors run on until the brick says something else.
    duty: Pair<f64>,
    camera: Option<Camera>,
    scanner: Scanner,
    /// Finds messages on the camera's own link.
    camera_scanner: Scanner,
    outgoing: VecDeque<Vec<u8>>,
    camera_outgoing: VecDeque<Vec<u8>>,
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
        let brick = Brick::new(&scenario, path.clone(), brick_clock.reading(Span::ZERO));
        let camera = scenario.camera.is_present.then(|| Camera::new(scenario.camera.clone(), scenario.seed));
        let history = match scenario.drive.end {
            DriveEnd::LastLap => History::Kept,
            DriveEnd::Never => History::Recent,
        };
        let mut simulation = Self {
            world: Span::ZERO,
            polyline: path.polyline(),
            body: Body::new(&scenario, path.start()),
            board: SensorBoard::new(&scenario),
            brick_clock,
            brick,
            duty: Pair::default(),
            camera,
            scanner: Scanner::new(ScannerConfig::default()),
            camera_scanner: Scanner::new(ScannerConfig::default()),
            outgoing: VecDeque::new(),
            camera_outgoing: VecDeque::new(),
            history,
            samples: 0,
            truth: Vec::new(),
            received: Vec::new(),
            path,
            scenario,
        };
        simulation.remember(history);
        simulation.log_truth();
        simulation
    }

    const fn remember(&mut self, history: History) {
        self.history = history;
        if let Some(camera) = &mut self.camera {
            camera.remember(history);
        }
    }

    /// The same world, which keeps neither truth nor estimates nor camera fixes from here on: for runs without end.
    #[must_use]
    pub fn without_history(mut self) -> Self {
        self.remember(History::Forgotten);
        self
    }

    /// Advances the world by [`STEP`](crate::STEP). Call [`Self::poll`] and [`Self::poll_camera`] until they are empty afterwards.
    pub fn step(&mut self) {
        self.world += STEP;
        let when = self.when();
        self.body.step(self.duty);
        self.board.sense(&self.body);
        self.duty = self.brick.step(when, &mut self.board, &self.body);
        for (instant, pose) in self.brick.take_estimates() {
            self.log_estimate(instant, pose);
        }
        if let Some(camera) = &mut self.camera {
            camera.step(self.world, self.body.pose());
        }
        self.collect();
        self.log_truth();
    }

    /// The next bytes on the way to the station: one or more whole frames of one sender, or one telegram of a LEGO brick.
    pub fn poll(&mut self) -> Option<Vec<u8>> {
        self.outgoing.pop_front()
    }

    /// The next bytes on the camera's own link: one or more whole frames. Always `None` if brick and camera share a link
    /// ([`Personality::shares_link_with_camera`](crate::scenario::Personality::shares_link_with_camera)).
    pub fn poll_camera(&mut self) -> Option<Vec<u8>> {
        self.camera_outgoing.pop_front()
    }

    /// The same world, whose camera is only the eye of another program: it sends nothing, and what it sees is [`Self::poll_image`]'s.
    #[must_use]
    pub fn with_images(mut self) -> Self {
        if let Some(camera) = &mut self.camera {
            camera.show_images();
        }
        self
    }

    /// The next image that the camera has taken, as a line of JSON without its end; `None` unless [`Self::with_images`].
    pub fn poll_image(&mut self) -> Option<String> {
        self.camera.as_mut()?.take_image()
    }

    /// Takes bytes that arrive from the station at this moment on the brick's link, in any pieces; damage is skipped.
    ///
    /// One call is one write of the station where that matters, as it does for an NXT behind a socket.
    pub fn receive(&mut self, bytes: &[u8]) {
        if self.shares_link() {
            let messages = heard_in(&mut self.scanner, self.world, bytes);
            for (from, message) in messages {
                let now = self.brick_clock.reading(self.world);
                if let Some((instant, pose)) = self.brick.handle(now, from, &message) {
                    self.log_estimate(instant, pose);
                }
                self.tell_camera(from, &message);
            }
        } else {
            self.brick.receive(self.world, bytes);
        }
        self.collect();
    }

    /// Takes bytes that arrive from the station at this moment on the camera's own link, in any pieces; damage is skipped.
    /// Nothing happens if brick and camera share a link.
    pub fn receive_camera(&mut self, bytes: &[u8]) {
        if self.shares_link() {
            return;
        }
        for (from, message) in heard_in(&mut self.camera_scanner, self.world, bytes) {
            self.tell_camera(from, &message);
        }
        self.collect();
    }

    /// Tells the brick that from here on somebody else is at the other end of its link: what was begun is forgotten, and what comes first may
    /// say anew in which form they speak.
    pub fn reopen_link(&mut self) {
        self.brick.reopen();
    }

    /// Switches the brick off and on: its clock and counters begin at zero, its session and message intervals anew, and
    /// its biases change. Its place on the path and its odometry are kept, as by a program that stores its progress.
    pub fn restart_brick(&mut self) {
        self.brick_clock.restart(self.world);
        self.board.restart();
        let when = self.when();
        self.brick.restart(when, &mut self.board, self.body.battery_v());
        self.duty = Pair::default();
    }

    /// What brick and camera have found in the bytes that came: their counterpart to the station's link health. The firmware of a LEGO
    /// brick counts nothing.
    pub const fn heard(&self) -> &ScanCounters {
        self.scanner.counters()
    }

    /// World time since the beginning.
    pub const fn elapsed(&self) -> Span {
        self.world
    }

    /// Whether the path is driven to its end and the robot stands.
    pub fn is_finished(&self) -> bool {
        self.brick.is_finished() && self.body.is_at_rest()
    }

    /// Laps that are done, where the drive has no end ([`DriveEnd::Never`](crate::scenario::DriveEnd::Never)).
    pub fn laps_done(&self) -> u64 {
        self.brick.laps_done()
    }

    /// How much of the path is driven, 0 to 1; of the lap in hand, where the drive has no end.
    pub fn progress(&self) -> f64 {
        self.brick.progress()
    }

    /// The truth at the beginning and after each telemetry period of world time; of a drive without an end the last of it
    /// ([`REMEMBERED`]).
    pub fn truth(&self) -> &[TruthSample] {
        &self.truth
    }

    /// How many samples of the truth there were so far, those that are forgotten included.
    pub const fn truth_samples(&self) -> u64 {
        self.samples
    }

    /// The usable estimates that reached the brick, in the order of their arrival; of a drive without an end the last of them.
    pub fn received_estimates(&self) -> &[ReceivedEstimate] {
        &self.received
    }

    /// The ideal path of one lap as points.
    pub fn path(&self) -> &[Point2<Arena>] {
        &self.polyline
    }

    /// Everything that the camera sent so far, outliers marked; of a drive without an end the last of it.
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

    const fn shares_link(&self) -> bool {
        self.scenario.brick.personality.shares_link_with_camera()
    }

    fn when(&self) -> When {
        When { world: self.world, now: self.brick_clock.reading(self.world) }
    }

    fn tell_camera(&mut self, from: Address, message: &Message) {
        if let Some(camera) = &mut self.camera {
            camera.handle(self.world, from, message);
        }
    }

    fn log_estimate(&mut self, instant: Stamp<BrickClock>, pose: Pose<Arena>) {
        if self.history != History::Forgotten {
            forget_oldest(self.history, self.world, &mut self.received, |heard| heard.world);
            self.received.push(ReceivedEstimate {
                world: self.world,
                arrival: self.brick_clock.exact(self.world),
                instant,
                pose,
            });
        }
    }

    fn collect(&mut self) {
        while let Some(bytes) = self.brick.take() {
            self.outgoing.push_back(bytes);
        }
        let seen = self.camera.as_mut().and_then(Camera::take);
        if self.shares_link() {
            self.outgoing.extend(seen);
        } else {
            self.camera_outgoing.extend(seen);
        }
    }

    fn log_truth(&mut self) {
        let period_s = 1.0 / self.scenario.brick.telemetry_hz;
        let due = Span::from_secs_f64(self.samples as f64 * period_s);
        if self.history == History::Forgotten || self.world < due {
            return;
        }
        self.samples += 1;
        forget_oldest(self.history, self.world, &mut self.truth, |sample| sample.world);
        let pose = self.body.pose();
        self.truth.push(TruthSample {
            world: self.world,
            brick: self.brick_clock.exact(self.world),
            pose,
            forward_speed: MetersPerSecond(self.body.forward_m_per_s()),
            turn_rate: RadiansPerSecond(self.body.turn_rad_per_s()),
            odometry: self.brick.odometry(self.path.start()),
            belief: self.brick.belief(),
            cross_track_m: self.path.distance_m(pose.origin()),
            steering: self.brick.steering(self.brick_clock.reading(self.world)),
        });
    }
}

/// The messages that a scanner finds complete when these bytes have come.
fn heard_in(scanner: &mut Scanner, world: Span, bytes: &[u8]) -> Vec<(Address, Message)> {
    let now = Stamp::<HostClock>::from_nanos(world.as_nanos());
    let mut messages = Vec::new();
    let mut sink = |scanned: Scanned<'_>| messages.extend(understood(&scanned));
    scanner.tick(now, &mut sink);
    scanner.push(now, bytes, &mut sink);
    messages
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
