//! A recording played as a robot that sends MAVLink.
//!
//! Converts observations in SI units to the messages of a brick, runs its session and answers its time requests. It
//! uses the standard messages with full precision, so that a recording loses nothing; counts are sent as counts. All
//! timestamps, those of fixes included, are of the recording's one clock, so everything has one address.

use posebridge_telemetry::{
    Address, Body, BrickClock, ChannelName, DriveGeometry, EncoderTicks, Heading, HostClock, Meters, MetersPerSecond,
    Observation, ObservationKind, Odom, Pose, RadiansPerSecond, TimeDelta, Timestamp, Transform2,
};

use crate::dialect::{Encoder, decode};
use crate::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use crate::message::{
    CommandResult, Heartbeat, ImuMessage, Message, Odometry, OdometryPose, PlanarImu, RobotDescription, VisionFix,
    WheelTicks, WireStamp,
};
use crate::session::{RequestedMessages, Session, SessionConfig, SessionOutput};

/// The player's address: a robot's own component.
pub const ADDRESS: Address = Address::new(1, 1);
/// The simulated brick's period: a station that connects later needs the geometry.
const DESCRIPTION_PERIOD: TimeDelta = TimeDelta::from_millis(5_000);
const HEARTBEAT_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);
/// Longer than any recording, so that no peer is lost while it plays.
const PEER_TIMEOUT: TimeDelta = TimeDelta::from_millis(3_600_000);
/// The channel of a recorded thermometer. A named value keeps the digits that SCALED_PRESSURE would round.
const THERMOMETER: &[u8] = b"temp";
/// Angles this close to a whole number of counts are sent as counts.
const COUNT_TOLERANCE: f64 = 1e-6;

/// The brick of a recording: sends its observations as MAVLink.
pub struct RecordedRobot {
    start: Timestamp<BrickClock>,
    geometry: DriveGeometry,
    session: Session<BrickClock>,
    framer: Framer,
    encoder: Encoder,
    bytes: Vec<u8>,
    now: Timestamp<BrickClock>,
    /// The integral of commanded speeds: no message has commanded speeds, but ODOMETRY has a pose.
    commanded_motion: Option<CommandedMotion>,
    description: RobotDescription,
    last_description: Timestamp<BrickClock>,
}

#[derive(Clone, Copy, Debug)]
struct CommandedMotion {
    since: Timestamp<BrickClock>,
    pose: Pose<Odom>,
    forward: MetersPerSecond,
    turn: RadiansPerSecond,
}

impl RecordedRobot {
    /// `start` is the brick's clock at the start of the playback.
    pub fn new(start: Timestamp<BrickClock>, geometry: DriveGeometry, name: &str) -> Self {
        let config = SessionConfig {
            own: ADDRESS,
            heartbeat: Heartbeat::ROVER,
            heartbeat_period: HEARTBEAT_PERIOD,
            timesync_period: None,
            peer_timeout: PEER_TIMEOUT,
            requested_messages: RequestedMessages::default(),
            offered_messages: vec![],
        };
        let description = RobotDescription {
            name: name.chars().filter(char::is_ascii).take(16).collect(),
            left_wheel_radius: geometry.left_wheel_radius,
            right_wheel_radius: geometry.right_wheel_radius,
            track_width: geometry.track_width,
            ticks_per_turn: std::f64::consts::TAU / geometry.tick.0,
            gyro_sigma: RadiansPerSecond(0.0),
            gyro_resolution: RadiansPerSecond(0.0),
        };
        Self {
            start,
            geometry,
            session: Session::new(config, start),
            framer: Framer::new(FramerConfig::default()),
            encoder: Encoder::new(WireVersion::V2),
            bytes: Vec::new(),
            now: start,
            commanded_motion: None,
            description,
            last_description: start,
        }
    }

    /// Sends the heartbeat, for a station that replies only to known senders, or that has just connected.
    pub fn send_heartbeat_now(&mut self) {
        self.last_description = self.now;
        self.encode(&Message::Heartbeat(Heartbeat::ROVER));
        let description = self.description.clone();
        self.encode(&Message::RobotDescription(description));
    }

    /// Sets the brick's clock to `elapsed` after the start.
    pub fn advance_clock(&mut self, elapsed: TimeDelta) {
        self.now = self.now.max(self.start + elapsed);
        self.session.tick(self.now);
        self.drain_session();
        if self.now - self.last_description >= DESCRIPTION_PERIOD {
            self.send_heartbeat_now();
        }
    }

    pub fn receive(&mut self, bytes: &[u8]) {
        let mut received = Vec::new();
        // The framer only measures silence with its clock: any clock will do.
        let now = Timestamp::<HostClock>::from_nanos(self.now.as_nanos());
        self.framer.push(now, bytes, &mut |scanned| {
            if let FramerOutput::Frame(frame) = scanned
                && let Ok(Some(message)) = decode(&frame)
            {
                received.push((frame.source, message));
            }
        });
        for (source, message) in received {
            self.session.handle(self.now, source, &message);
        }
        self.drain_session();
    }

    /// Sends an observation; `false` if its kind has no message.
    pub fn send(&mut self, observation: &Observation) -> bool {
        let stamp = WireStamp::Micros64(observation.stamp.as_micros().unsigned_abs());
        match self.message(observation, stamp) {
            Some(message) => {
                self.encode(&message);
                true
            }
            None => false,
        }
    }

    pub fn take_bytes(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }

    fn message(&mut self, observation: &Observation, stamp: WireStamp) -> Option<Message> {
        match observation.measurement {
            ObservationKind::WheelAngles { left, right } => Some(self.wheels(stamp, left.0, right.0)),
            ObservationKind::OdometerPose(pose) => {
                Some(odometry_message(stamp, pose, MetersPerSecond(0.0), RadiansPerSecond(0.0)))
            }
            ObservationKind::BodyVelocity { forward, turn } => {
                Some(self.integrate_commanded(observation.stamp, stamp, forward, turn))
            }
            ObservationKind::TurnRate(rate) => {
                let message = ImuMessage::Highres;
                Some(Message::Imu(PlanarImu { message, stamp, turn_rate: Some(rate), forward_acceleration: None }))
            }
            ObservationKind::Fix(fix) => Some(Message::VisionPosition(VisionFix {
                stamp,
                x: fix.position.x,
                y: fix.position.y,
                heading: fix.heading,
                covariance: fix.covariance.map(|own| [own.xx_m2, own.xy_m2, own.yy_m2, own.heading_rad2]),
                reset_counter: fix.reset_counter,
                tag: None,
            })),
            ObservationKind::Temperature(temperature) => {
                Some(Message::Thermometer { stamp, channel: ChannelName::from_bytes(THERMOMETER), temperature })
            }
            ObservationKind::WallRange(range) => Some(Message::DistanceSensor { stamp, range, sigma: None }),
            ObservationKind::WheelAccelerations { .. }
            | ObservationKind::Landmark { .. }
            | ObservationKind::BeaconRange { .. }
            | ObservationKind::CompassHeading(_) => None,
        }
    }

    /// Counts where the recording has counts, distances otherwise.
    fn wheels(&self, stamp: WireStamp, left_rad: f64, right_rad: f64) -> Message {
        let counts = [left_rad, right_rad].map(|angle_rad| angle_rad / self.geometry.tick.0);
        let [left, right] = counts.map(f64::round);
        let are_integers = (counts[0] - left).abs() < COUNT_TOLERANCE && (counts[1] - right).abs() < COUNT_TOLERANCE;
        let fits = left.abs() < f64::from(i32::MAX) && right.abs() < f64::from(i32::MAX);
        match (are_integers && fits, stamp) {
            (true, WireStamp::Micros64(micros)) => Message::WheelTicks(WheelTicks {
                stamp: WireStamp::Micros32(micros as u32),
                left: EncoderTicks(left as i64),
                right: EncoderTicks(right as i64),
            }),
            _ => Message::WheelDistance {
                stamp,
                left: Meters(left_rad * self.geometry.left_wheel_radius.0),
                right: Meters(right_rad * self.geometry.right_wheel_radius.0),
            },
        }
    }

    fn integrate_commanded(
        &mut self,
        at: Timestamp<BrickClock>,
        stamp: WireStamp,
        forward: MetersPerSecond,
        turn: RadiansPerSecond,
    ) -> Message {
        let pose = match self.commanded_motion {
            None => Pose::default(),
            Some(held) => {
                let secs = (at - held.since).as_secs_f64();
                let turned_rad = held.turn.0 * secs;
                let half = Heading::from_rad(0.5 * turned_rad);
                let middle = Transform2::<Body, Body>::new(Meters(0.0), Meters(0.0), half);
                let along = Transform2::new(Meters(held.forward.0 * secs), Meters(0.0), half);
                held.pose * middle * along
            }
        };
        self.commanded_motion = Some(CommandedMotion { since: at, pose, forward, turn });
        odometry_message(stamp, pose, forward, turn)
    }

    fn drain_session(&mut self) {
        while let Some(output) = self.session.poll() {
            match output {
                SessionOutput::Send(message) => self.encode(&message),
                SessionOutput::CommandReceived { by, command, .. } => {
                    let result = CommandResult::Unsupported;
                    self.session.acknowledge_command(by, command.command, result);
                }
                SessionOutput::PeerSeen { .. }
                | SessionOutput::PeerLost { .. }
                | SessionOutput::TimeExchanged { .. }
                | SessionOutput::IntervalRequested { .. }
                | SessionOutput::PlanReceived { .. }
                // Of parameters it offers none.
                | SessionOutput::ParameterSetRequested { .. }
                | SessionOutput::ParameterUnsupported { .. }
                | SessionOutput::ParameterUnknown { .. } => {}
            }
        }
    }

    fn encode(&mut self, message: &Message) {
        self.encoder.encode(ADDRESS, message, &mut self.bytes);
    }
}

fn odometry_message(
    stamp: WireStamp,
    pose: Pose<Odom>,
    forward_speed: MetersPerSecond,
    turn_rate: RadiansPerSecond,
) -> Message {
    Message::Odometry(Odometry {
        stamp,
        pose: OdometryPose::Odom(pose),
        forward_speed,
        turn_rate,
        covariance: None,
        reset_counter: 0,
        quality: 0,
    })
}
