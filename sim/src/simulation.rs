//! The simulated world: robot, sensors, brick and camera behind their links, and the ground truth.
//!
//! A brick that sends MAVLink shares one link with the camera. Other protocols have no address for a second sender; the camera then sends
//! MAVLink on a link of its own. The caller transports the bytes and paces the steps.

use std::collections::VecDeque;

use posebridge_protocol::dialect;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerCounters, FramerOutput};
use posebridge_protocol::message::Message;
use posebridge_telemetry::{
    Address, Arena, BrickClock, HostClock, MetersPerSecond, Point2, Pose, RadiansPerSecond, SensorSwitch,
    SimulatorCommand, SteeringSource, TimeDelta, Timestamp,
};

use crate::camera::{CAMERA, Camera, CameraFix};
use crate::clock::{STEP, SkewedClock};
use crate::firmware::Twist;
use crate::hand::HandMover;
use crate::history::{HistoryPolicy, trim_history};
use crate::path::Path;
use crate::personality::{Brick, BrickTime};
use crate::rendered_camera::{Exposure, ExposureRecorder, FrameTimes, LensState, RenderedCamera, RenderedFrame};
use crate::robot_body::{Displacement, RobotBody};
use crate::scenario::{Course, DriveEnd, Scenario, ScenarioError, Steering};
use crate::sensors::SensorBoard;
use crate::wheels::PerWheel;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    pub sim_time: TimeDelta,
    /// The brick's clock at that instant, without rounding or register wraps.
    pub brick_time: Timestamp<BrickClock>,
    pub pose: Pose<Arena>,
    /// Along the body's x axis, without slip.
    pub forward_speed: MetersPerSecond,
    /// About the vertical, without slip.
    pub turn_rate: RadiansPerSecond,
    /// The brick's dead reckoning from the start pose.
    pub odometry: Pose<Arena>,
    /// The brick's own estimate: the last estimate that it used, extrapolated by its odometry. A brick that steers by odometry alone
    /// uses none.
    pub onboard_estimate: Pose<Arena>,
    /// Distance of the true position from the ideal path.
    pub cross_track_m: f64,
    pub steering: Steering,
}

/// A usable estimate at its arrival on the brick, whether the brick used it or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceivedEstimate {
    pub sim_time: TimeDelta,
    /// The brick's clock on arrival, without rounding or register wraps.
    pub arrival: Timestamp<BrickClock>,
    pub estimate_time: Timestamp<BrickClock>,
    /// The estimated pose at `stamp`, past or future.
    pub pose: Pose<Arena>,
}

impl ReceivedEstimate {
    /// Age on arrival, in brick time; negative if the timestamp lies in the future.
    pub fn age(&self) -> TimeDelta {
        self.arrival - self.estimate_time
    }
}

/// Who executes the rest of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandExecutor {
    Simulation,
    /// The owner of the brick's link: it changes the profile or disconnects the cable.
    Link,
}

#[derive(Debug)]
pub struct Simulation {
    scenario: Scenario,
    world: TimeDelta,
    path: Path,
    polyline: Vec<Point2<Arena>>,
    body: RobotBody,
    /// Moves the robot instead of its motors.
    hand: Option<HandMover>,
    board: SensorBoard,
    brick_clock: SkewedClock,
    brick: Brick,
    /// Held until the brick changes it.
    duty: PerWheel<f64>,
    camera: Option<Camera>,
    pictures: Option<ExposureRecorder>,
    /// Made for the first frame that [`Simulation::take_due_frames`] renders.
    rendered_camera: Option<Box<RenderedCamera>>,
    framer: Framer,
    camera_scanner: Framer,
    outgoing: VecDeque<Vec<u8>>,
    camera_outgoing: VecDeque<Vec<u8>>,
    history: HistoryPolicy,
    samples: u64,
    truth: Vec<TruthSample>,
    received: Vec<ReceivedEstimate>,
}

impl Simulation {
    /// The world of a scenario at time 0, the robot at rest at the start pose.
    pub fn new(scenario: Scenario) -> Self {
        let path = Path::new(&scenario);
        let brick = &scenario.brick;
        let brick_clock = SkewedClock::new(brick.clock_start_micros, brick.clock_skew_ppm, brick.clock_tick_micros);
        let brick = Brick::new(&scenario, path.clone(), brick_clock.reading(TimeDelta::ZERO));
        let camera = scenario
            .camera
            .is_present
            .then(|| Camera::new(scenario.camera.clone(), scenario.brick.address_of(CAMERA), scenario.seed));
        let history = match scenario.drive.end {
            DriveEnd::LastLap => HistoryPolicy::All,
            DriveEnd::Never => HistoryPolicy::Recent,
        };
        let body = RobotBody::new(&scenario, path.start());
        let hand = if let Course::ByHand(motions) = &scenario.path {
            Some(HandMover::new(scenario.seed, *motions, &scenario.drive, body.radius_m, body.track_m))
        } else {
            None
        };
        let mut simulation = Self {
            world: TimeDelta::ZERO,
            polyline: path.polyline(),
            body,
            hand,
            board: SensorBoard::new(&scenario),
            brick_clock,
            brick,
            duty: PerWheel::default(),
            camera,
            pictures: ExposureRecorder::new(&scenario.camera, scenario.seed, path.start()),
            rendered_camera: None,
            framer: Framer::new(FramerConfig::default()),
            camera_scanner: Framer::new(FramerConfig::default()),
            outgoing: VecDeque::new(),
            camera_outgoing: VecDeque::new(),
            history,
            samples: 0,
            truth: Vec::new(),
            received: Vec::new(),
            path,
            scenario,
        };
        simulation.set_history(history);
        simulation.log_truth();
        simulation
    }

    const fn set_history(&mut self, history: HistoryPolicy) {
        self.history = history;
        if let Some(camera) = &mut self.camera {
            camera.history = history;
        }
    }

    /// Keeps no truth, estimates or camera fixes from here on: for endless runs.
    pub fn without_history(mut self) -> Self {
        self.set_history(HistoryPolicy::Nothing);
        self
    }

    /// Advances the world by [`STEP`](crate::STEP). Call [`Self::poll`] and [`Self::poll_camera`] until they are empty afterwards.
    pub fn step(&mut self) {
        self.world += STEP;
        let when = self.brick_time();
        match &mut self.hand {
            Some(hand) => {
                let (rotation, contact) = hand.step();
                self.body.step_by_hand(rotation, contact);
            }
            None => self.body.step(self.duty),
        }
        self.board.sample(&self.body);
        self.duty = self.brick.step(when, &mut self.board, &self.body);
        for (instant, pose) in std::mem::take(&mut self.brick.estimates) {
            self.log_estimate(instant, pose);
        }
        if let Some(camera) = &mut self.camera {
            camera.step(self.world, self.body.pose);
        }
        if let Some(pictures) = &mut self.pictures {
            pictures.step(self.world, self.body.pose);
        }
        self.collect_output();
        self.log_truth();
    }

    /// The next bytes for the station: one or more whole frames of one sender, or one telegram of a LEGO brick.
    pub fn poll(&mut self) -> Option<Vec<u8>> {
        self.outgoing.pop_front()
    }

    /// The next bytes on the camera's own link: one or more whole frames. Always `None` if brick and camera share a link
    /// ([`Personality::shares_link_with_camera`](crate::scenario::Personality::shares_link_with_camera)).
    pub fn poll_camera(&mut self) -> Option<Vec<u8>> {
        self.camera_outgoing.pop_front()
    }

    /// The camera sends no fixes; its images go to another program through [`Self::poll_image`].
    pub fn with_images(mut self) -> Self {
        if let Some(camera) = &mut self.camera {
            camera.images = Some(VecDeque::new());
        }
        self
    }

    /// The next camera image as a line of JSON without its end; `None` unless [`Self::with_images`].
    pub fn poll_image(&mut self) -> Option<String> {
        self.camera.as_mut()?.images.as_mut()?.pop_front()
    }

    /// When the camera takes its next picture; `None` if the scenario has no `[camera.pictures]`.
    pub fn next_picture(&self) -> Option<FrameTimes> {
        self.pictures.as_ref().map(ExposureRecorder::next_exposure)
    }

    /// The next picture that is exposed and not yet taken, before it is rendered. [`RenderedCamera::take_picture`] renders it, in a thread
    /// of its own if need be; it is delivered at [`FrameTimes::due`].
    pub fn take_exposure(&mut self) -> Option<Exposure> {
        self.pictures.as_mut()?.take_finished()
    }

    /// Renders the pictures that are due and not yet taken. The first call with one renders what stands still, too.
    ///
    /// # Errors
    /// Settings of a scenario that no file was read from may contradict each other.
    pub fn take_due_frames(&mut self) -> Result<Vec<RenderedFrame>, ScenarioError> {
        let (Some(pictures), Some(settings)) = (&mut self.pictures, &self.scenario.camera.pictures) else {
            return Ok(Vec::new());
        };
        let mut frames = Vec::new();
        while let Some(exposure) = pictures.take_due(self.world) {
            let camera = match &mut self.rendered_camera {
                Some(camera) => camera,
                none => none.insert(Box::new(RenderedCamera::new(settings, self.scenario.seed)?)),
            };
            frames.push(camera.take_picture(&exposure));
        }
        Ok(frames)
    }

    /// Receives bytes from the station now on the brick's link, in pieces of any size; damaged bytes are skipped.
    ///
    /// One call is one write of the station where boundaries matter, as for an NXT behind a socket.
    pub fn receive(&mut self, bytes: &[u8]) {
        if self.shares_link() {
            let messages = decode_messages(&mut self.framer, self.world, bytes);
            for (from, message) in messages {
                let now = self.brick_clock.reading(self.world);
                if let Some((instant, pose)) = self.brick.handle(now, from, &message) {
                    self.log_estimate(instant, pose);
                }
                self.send_to_camera(from, &message);
            }
        } else {
            self.brick.receive(self.world, bytes);
        }
        self.collect_output();
    }

    /// Receives bytes from the station now on the camera's own link, in pieces of any size; damaged bytes are skipped. Does nothing if
    /// brick and camera share a link.
    pub fn receive_camera(&mut self, bytes: &[u8]) {
        if self.shares_link() {
            return;
        }
        for (from, message) in decode_messages(&mut self.camera_scanner, self.world, bytes) {
            self.send_to_camera(from, &message);
        }
        self.collect_output();
    }

    /// A new peer is connected to the brick's link: partial data is dropped, and the first bytes select the protocol again.
    pub fn reopen_link(&mut self) {
        self.brick.reopen();
    }

    /// Power cycle of the brick: its clock and counters begin at zero, its session and message intervals are reset, and its biases
    /// change. Progress on the path and odometry are kept, as by a program that stores them.
    pub fn restart_brick(&mut self) {
        self.brick_clock.restart(self.world);
        self.board.restart();
        let when = self.brick_time();
        self.brick.restart(when, &mut self.board, self.body.battery_v);
        self.duty = PerWheel::default();
    }

    /// Receive statistics of brick and camera: their counterpart to the station's link health. The firmware of a LEGO brick counts
    /// nothing.
    pub const fn receive_counters(&self) -> &FramerCounters {
        self.framer.counters()
    }

    pub const fn elapsed(&self) -> TimeDelta {
        self.world
    }

    /// Whether the path is complete and the robot stands; by hand, whether all motions are done.
    pub fn is_finished(&self) -> bool {
        match &self.hand {
            Some(hand) => hand.is_finished(),
            None => self.brick.program.follower.is_finished() && self.body.is_at_rest(),
        }
    }

    /// Completed laps of an endless drive ([`DriveEnd::Never`](crate::scenario::DriveEnd::Never)).
    pub fn laps_done(&self) -> u64 {
        self.brick.program.follower.laps_done
    }

    /// Driven share of the path, 0 to 1; of the current lap in an endless drive.
    pub fn progress(&self) -> f64 {
        self.brick.program.follower.progress()
    }

    /// The truth at the beginning and after each telemetry period of world time; an endless drive keeps only the last
    /// [`HISTORY_DURATION`](crate::HISTORY_DURATION).
    pub fn truth(&self) -> &[TruthSample] {
        &self.truth
    }

    /// Number of truth samples so far, dropped ones included.
    pub const fn truth_samples(&self) -> u64 {
        self.samples
    }

    /// In the order of arrival; an endless drive keeps only the last ones.
    pub fn received_estimates(&self) -> &[ReceivedEstimate] {
        &self.received
    }

    /// Number of estimates that the brick has dropped because a station with a higher epoch has sent one before.
    pub const fn outdated_estimates(&self) -> u64 {
        self.brick.outdated_estimates()
    }

    /// Points of the ideal path of one lap.
    pub fn path(&self) -> &[Point2<Arena>] {
        &self.polyline
    }

    /// All sent fixes; an endless drive keeps only the last ones.
    pub fn camera_fixes(&self) -> &[CameraFix] {
        self.camera.as_ref().map_or(&[], |camera| &camera.log)
    }

    /// The true radii of the left and of the right wheel, and the true track width, in metres: the geometry that a calibration should
    /// find.
    pub const fn true_geometry_m(&self) -> [f64; 3] {
        [self.body.radius_m.left, self.body.radius_m.right, self.body.track_m]
    }

    pub fn start_pose(&self) -> Pose<Arena> {
        self.path.start()
    }

    pub const fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    const fn shares_link(&self) -> bool {
        self.scenario.brick.personality.shares_link_with_camera()
    }

    fn brick_time(&self) -> BrickTime {
        BrickTime { sim_time: self.world, now: self.brick_clock.reading(self.world) }
    }

    fn send_to_camera(&mut self, from: Address, message: &Message) {
        if let Some(camera) = &mut self.camera {
            camera.handle(self.world, from, message);
        }
    }

    fn log_estimate(&mut self, instant: Timestamp<BrickClock>, pose: Pose<Arena>) {
        if self.history != HistoryPolicy::Nothing {
            trim_history(self.history, self.world, &mut self.received, |message| message.sim_time);
            self.received.push(ReceivedEstimate {
                sim_time: self.world,
                arrival: self.brick_clock.exact(self.world),
                estimate_time: instant,
                pose,
            });
        }
    }

    fn collect_output(&mut self) {
        while let Some(bytes) = self.brick.next_bytes() {
            self.outgoing.push_back(bytes);
        }
        let camera_frame = self.camera.as_mut().and_then(Camera::next_frame);
        if self.shares_link() {
            self.outgoing.extend(camera_frame);
        } else {
            self.camera_outgoing.extend(camera_frame);
        }
    }

    fn log_truth(&mut self) {
        let period_s = 1.0 / self.scenario.brick.telemetry_hz;
        let due = TimeDelta::from_secs_f64(self.samples as f64 * period_s);
        if self.history == HistoryPolicy::Nothing || self.world < due {
            return;
        }
        self.samples += 1;
        trim_history(self.history, self.world, &mut self.truth, |sample| sample.sim_time);
        let pose = self.body.pose;
        self.truth.push(TruthSample {
            sim_time: self.world,
            brick_time: self.brick_clock.exact(self.world),
            pose,
            forward_speed: MetersPerSecond(self.body.forward_m_per_s()),
            turn_rate: RadiansPerSecond(self.body.turn_rad_per_s()),
            odometry: self.brick.program.odometry(self.path.start()),
            onboard_estimate: self.brick.program.onboard.pose(),
            cross_track_m: self.path.distance_m(pose.origin()),
            steering: self.brick.program.onboard.steering(self.brick_clock.reading(self.world)),
        });
    }

    /// Executes a user's command from the next step on. The caller validates it with [`SimulatorCommand::validate`].
    ///
    /// The same commands before the same steps give the same bytes.
    pub fn execute(&mut self, command: &SimulatorCommand) -> CommandExecutor {
        match *command {
            SimulatorCommand::Kidnap { forward_m, left_m, turn_rad } => {
                self.body.lift(Displacement { forward_m, left_m, turn_rad });
            }
            SimulatorCommand::Slip { wheel, factor, duration } => self.body.reduce_grip(wheel, factor, duration),
            SimulatorCommand::Camera(to) => {
                if let Some(camera) = &mut self.camera {
                    camera.is_covered = to == SensorSwitch::Off;
                }
                if let Some(pictures) = &mut self.pictures {
                    pictures.set_lens(match to {
                        SensorSwitch::On => LensState::Open,
                        SensorSwitch::Off => LensState::Covered,
                    });
                }
            }
            SimulatorCommand::CameraDelay { delay } => {
                if let Some(camera) = &mut self.camera {
                    camera.settings.latency_ms = delay.as_millis_f64();
                }
                if let Some(pictures) = &mut self.pictures {
                    pictures.set_latency(delay);
                }
            }
            SimulatorCommand::GyroBiasStep { rad_per_s } => {
                self.board.gyro.step_bias(rad_per_s);
                self.brick.step_gyro_bias(rad_per_s);
            }
            SimulatorCommand::Steering(source) => {
                self.brick.program.onboard.set_steering(match source {
                    SteeringSource::Odometry => Steering::Odometry,
                    SteeringSource::Estimate => Steering::Estimate,
                });
            }
            SimulatorCommand::Drive { forward_m_per_s, turn_rad_per_s } => {
                let now = self.brick_clock.reading(self.world);
                let twist = Twist { forward_m_per_s, turn_rad_per_s };
                self.brick.program.drive_manually(now, twist);
            }
            SimulatorCommand::Path => self.brick.program.rejoin(),
            SimulatorCommand::LinkProfile(_) | SimulatorCommand::PullCable { .. } => {
                return CommandExecutor::Link;
            }
        }
        CommandExecutor::Simulation
    }
}

/// The messages that become complete with these bytes. A brick has no way to report an invalid or unknown one.
fn decode_messages(framer: &mut Framer, world: TimeDelta, bytes: &[u8]) -> Vec<(Address, Message)> {
    let now = Timestamp::<HostClock>::from_nanos(world.as_nanos());
    let mut messages = Vec::new();
    let mut sink = |scanned: FramerOutput<'_>| {
        if let FramerOutput::Frame(frame) = scanned
            && let Ok(Some(message)) = dialect::decode(&frame)
        {
            messages.push((frame.source, message));
        }
    };
    framer.tick(now, &mut sink);
    framer.push(now, bytes, &mut sink);
    messages
}
