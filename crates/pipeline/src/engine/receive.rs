//! Messages to observations: what came on a link, as far as the filter.

use posebridge_estimator::gate::chi_square_quantile;
use posebridge_estimator::{Adjustment, StartPose, filter_named};
use posebridge_protocol::message::{Message, RobotDescription, WireStamp};
use posebridge_protocol::routing::Occurrence;
use posebridge_telemetry::{
    Address, BrickClock, Defect, DriveGeometry, Event, HostClock, LinkId, Observation, Observed, Radians,
    RadiansPerSecond, RobotId, Span, Stamp, SystemId, Verdict,
};

use super::intake::{Arrival, Arrived};
use super::{Pipeline, SEVERITY_WARNING};
use crate::clock::unwrap::Unwrapped;
use crate::config::DescriptionPolicy;
use crate::interpret::{Reading, StampedBy};

/// An integral of the gyro over a longer gap than this says nothing about the rate.
const LONGEST_GYRO_GAP: Span = Span::from_millis(1_000);
/// The integral on the wire has 32 bits of microradians.
const GYRO_TURN_PERIOD_RAD: f64 = 4_294.967_296;

impl Pipeline {
    pub(super) fn handle_message(&mut self, arrival: Arrival, arrived: &Arrived) {
        let Arrived { source, occurrence, ref message } = *arrived;
        // Redundant links are one: the robot, its clock and its observations know only the first of them.
        let id = self.router.first_of_group(arrival.way.link);
        self.converse(arrival, robot_at(id, source), arrived);
        if occurrence == Occurrence::Redundant {
            self.note_copy(arrival, robot_at(id, source), message);
            return;
        }
        if let (Message::StatusText { severity, text, .. }, Occurrence::First) = (message, occurrence) {
            self.tell(Event::Text { source, severity: *severity, text: text.clone() });
        }
        self.note_camera(id, source, message);
        if let Message::RobotDescription(description) = message {
            self.handle_description(id, source, description);
        }
        if self.robot == Some(robot_at(id, source)) {
            self.robot_heard = Some((arrival.way, self.now));
        }
        self.handle_temperature(arrival, id, arrived);
        for reading in self.interpreter.readings(message).iter().flatten() {
            // What went round a loop is news only from the robot, whose telemetry counts on its own link alone.
            if occurrence == Occurrence::First || self.is_of_robot(id, source, reading) {
                self.handle_reading(arrival, id, source, reading);
            }
        }
    }

    /// What came before by another link of the group says nothing new, but by this link it is one more bound of its sender's clock.
    fn note_copy(&mut self, arrival: Arrival, from: RobotId, message: &Message) {
        if let Message::Thermometer { stamp, .. } = *message {
            self.note_copied_stamp(arrival, from, stamp);
        }
        for reading in self.interpreter.readings(message).into_iter().flatten() {
            if self.robot == Some(from) && reading.stamped_by == StampedBy::Brick {
                let clock = &mut self.brick_clock;
                clock.copied(arrival.way, reading.stamp, arrival.at);
            } else if let Some(clock) = self.observers.get_mut(&(from.link, from.address)) {
                clock.copied(arrival.way, reading.stamp, arrival.at);
            }
        }
    }

    fn note_copied_stamp(&mut self, arrival: Arrival, from: RobotId, stamp: WireStamp) {
        if self.robot == Some(from) {
            self.brick_clock.copied(arrival.way, stamp, arrival.at);
        } else if let Some(clock) = self.observers.get_mut(&(from.link, from.address)) {
            clock.copied(arrival.way, stamp, arrival.at);
        }
    }

    /// `id` is the first link of the group by which it came.
    fn handle_reading(&mut self, arrival: Arrival, id: LinkId, source: Address, reading: &Reading) {
        let from_robot = self.robot == Some(robot_at(id, source));
        match reading.stamped_by {
            StampedBy::Brick => {
                if let Some(robot) = self.adopt_robot(id, source) {
                    self.handle_brick_reading(arrival, robot, reading);
                }
            }
            StampedBy::Observer if from_robot => {
                self.handle_relayed_reading(arrival, source, reading);
            }
            StampedBy::Observer => self.handle_observer_reading(arrival, id, source, reading),
        }
    }

    /// Whether a reading can be the robot's own word and nobody else's.
    fn is_of_robot(&self, id: LinkId, source: Address, reading: &Reading) -> bool {
        reading.stamped_by == StampedBy::Brick || self.robot == Some(robot_at(id, source))
    }

    /// The robot that a sender of odometry is: the first of the configured system, and nobody else after it.
    pub(super) fn adopt_robot(&mut self, link: LinkId, address: Address) -> Option<RobotId> {
        if self.config.robot_system.is_some_and(|wanted: SystemId| wanted != address.system) {
            return None;
        }
        let candidate = RobotId { link, address };
        if self.robot.is_none() {
            self.robot = Some(candidate);
            // Its answers to time requests may have come before its telemetry.
            if let Some(clock) = self.observers.remove(&(link, address)) {
                self.brick_clock = clock.renamed();
            }
            self.show_robot();
        }
        (self.robot == Some(candidate)).then_some(candidate)
    }

    fn handle_brick_reading(&mut self, arrival: Arrival, robot: RobotId, reading: &Reading) {
        let Some((stamp, stamp_sigma)) = self.brick_instant(arrival, robot, reading.stamp) else {
            return;
        };
        let observed = self.whole_turn_rate(stamp, reading);
        let observation = Observation { sensor: reading.sensor, stamp, stamp_sigma, observed };
        self.observe(robot, robot.address, arrival.at, observation);
    }

    /// The brick instant of something that the brick looked up between question and answer, and its sigma: it may lie anywhere between.
    fn asked_instant(&self, sent: Stamp<HostClock>, answered: Stamp<HostClock>) -> Option<(Stamp<BrickClock>, Span)> {
        let half = Span::from_nanos((answered - sent).as_nanos() / 2);
        let (stamp, uncertainty) = self.brick_clock.remote_at(sent + half)?;
        Some((stamp, sigma_of(half + uncertainty)))
    }

    /// The instant of a stamp by the robot's own clock, and its sigma; `None` if it is from before a restart, or an answer to a
    /// question while nothing is known of that clock.
    pub(super) fn brick_instant(
        &mut self,
        arrival: Arrival,
        robot: RobotId,
        stamp: WireStamp,
    ) -> Option<(Stamp<BrickClock>, Span)> {
        let Arrival { way, at } = arrival;
        if let WireStamp::Asked { sent, answered } = stamp {
            let asked = self.asked_instant(sent, answered);
            if asked.is_none() {
                self.tell_unaligned(way.link, robot.address);
            }
            return asked;
        }
        let instant = match self.brick_clock.arrived(way, stamp, at) {
            Unwrapped::Continued(instant) => instant,
            Unwrapped::Restarted(instant) => {
                self.brick_restarted(robot);
                instant
            }
            Unwrapped::Outlived => {
                self.tell_unaligned(way.link, robot.address);
                return None;
            }
        };
        if self.brick_clock.take_contradiction() {
            self.tell_unaligned(way.link, robot.address);
        }
        Some((instant, Span::ZERO))
    }

    /// A fix that the robot passes on, stamped by its own clock: it may be older than any reordering explains.
    fn handle_relayed_reading(&mut self, arrival: Arrival, source: Address, reading: &Reading) {
        let (Some(robot), Some(stamp)) = (self.robot, self.brick_clock.placed(reading.stamp)) else {
            return;
        };
        let observation =
            Observation { sensor: reading.sensor, stamp, stamp_sigma: Span::ZERO, observed: reading.observed };
        self.observe(robot, source, arrival.at, observation);
    }

    /// The mean rate since the sensor's last observation that arrived: from the integral, where the sender has one.
    pub(super) fn whole_turn_rate(&mut self, stamp: Stamp<BrickClock>, reading: &Reading) -> Observed {
        let Some(turn) = reading.gyro_turn else {
            return reading.observed;
        };
        let before = self.last_gyro_turn;
        // One that was overtaken on its way must not become the base of the next.
        if before.is_none_or(|(last, _)| stamp > last) {
            self.last_gyro_turn = Some((stamp, turn));
        }
        let Some((last_stamp, last_turn)) = before else {
            return reading.observed;
        };
        let gap = stamp - last_stamp;
        if gap <= Span::ZERO || gap > LONGEST_GYRO_GAP {
            return reading.observed;
        }
        let turned_rad = (turn.0 - last_turn.0 + 0.5 * GYRO_TURN_PERIOD_RAD).rem_euclid(GYRO_TURN_PERIOD_RAD)
            - 0.5 * GYRO_TURN_PERIOD_RAD;
        Observed::TurnRate(RadiansPerSecond(turned_rad / gap.as_secs_f64()))
    }

    fn handle_observer_reading(&mut self, arrival: Arrival, link: LinkId, source: Address, reading: &Reading) {
        let on_host = match reading.stamp {
            WireStamp::Asked { sent, answered } => {
                let half = Span::from_nanos((answered - sent).as_nanos() / 2);
                Some((sent + half, half))
            }
            WireStamp::Micros32(_) | WireStamp::Millis32(_) | WireStamp::Micros64(_) => {
                self.observer_instant(arrival, (link, source), reading.stamp)
            }
        };
        let on_brick = on_host.and_then(|(host, camera_off)| {
            let (brick, brick_off) = self.brick_clock.remote_at(host)?;
            Some((brick, sigma_of(camera_off + brick_off)))
        });
        match (on_brick, self.robot) {
            (Some((stamp, stamp_sigma)), Some(robot)) => {
                let observation = Observation {
                    sensor: self.camera_sensor(link, source),
                    stamp,
                    stamp_sigma,
                    observed: reading.observed,
                };
                self.observe(robot, source, arrival.at, observation);
            }
            _ => self.tell_unaligned(link, source),
        }
    }

    /// The host instant of a stamp by an observer's own clock, and how far it may be off; `None` while that clock is not aligned.
    fn observer_instant(
        &mut self,
        arrival: Arrival,
        (link, source): (LinkId, Address),
        stamp: WireStamp,
    ) -> Option<(Stamp<HostClock>, Span)> {
        let clock = self.observers.entry((link, source)).or_default();
        let unwrapped = clock.arrived(arrival.way, stamp, arrival.at);
        let (Unwrapped::Continued(stamp) | Unwrapped::Restarted(stamp)) = unwrapped else {
            return None;
        };
        let on_host = clock.host_at(stamp);
        // The caller tells it, because such a clock has no conversion.
        clock.take_contradiction();
        if matches!(unwrapped, Unwrapped::Restarted(_)) {
            self.ask_time_again(link, source);
            self.camera_restarted(link, source);
        }
        on_host
    }

    pub(super) fn tell_unaligned(&mut self, link: LinkId, source: Address) {
        let defect = Defect::Unaligned { source };
        self.tell(Event::Defect { link, defect });
    }

    pub(super) fn observe(
        &mut self,
        robot: RobotId,
        source: Address,
        arrival: Stamp<HostClock>,
        observation: Observation,
    ) {
        self.tell(Event::Observed { robot, source, arrival, observation });
        let left_out = self.left_out(&observation);
        self.is_news |= left_out.is_none();
        let record = left_out.unwrap_or_else(|| self.filter.observe(&observation));
        if matches!(observation.observed, Observed::Fix(_)) && record.degrees_of_freedom > 0 {
            self.fix_ratio = record.nis / self.gate(record.degrees_of_freedom);
        }
        if let Observed::WallRange(range) = observation.observed {
            self.publish_range(range, observation.stamp);
        }
        self.publish_record(&record);
        let slipped = (record.verdict == Verdict::Slip).then_some(record.stamp);
        self.tell(Event::Fused { robot, record });
        if slipped.is_some_and(|stamp| self.slip.begins(stamp)) {
            let text = "wheels slip: gyro and wheels disagree".to_owned();
            self.tell_own(SEVERITY_WARNING, text);
        }
    }

    /// What the normalised innovation of a fix must stay below.
    fn gate(&mut self, degrees_of_freedom: u8) -> f64 {
        let probability = self.config.filter_config.params.gate_probability;
        if let Some((known, of, quantile)) = self.fix_gate
            && (known, of) == (degrees_of_freedom, probability)
        {
            return quantile;
        }
        let quantile = chi_square_quantile(degrees_of_freedom, probability);
        self.fix_gate = Some((degrees_of_freedom, probability, quantile));
        quantile
    }

    /// The brick was switched off and on: it has forgotten what was asked of it.
    pub(super) fn brick_restarted(&mut self, robot: RobotId) {
        let now = self.now;
        self.filter.restart_clock();
        self.restart_thermometers(robot);
        self.last_gyro_turn = None;
        for (id, link) in &mut self.links {
            if self.router.lead_to_one(*id, robot.link) {
                link.session.peer_restarted(now, robot.address);
            }
        }
        self.tell(Event::BrickRestarted { robot });
    }

    fn handle_description(&mut self, link: LinkId, source: Address, said: &RobotDescription) {
        if self.described || self.config.description == DescriptionPolicy::Ignore {
            return;
        }
        let Some(geometry) = geometry_of(said) else {
            return;
        };
        if self.adopt_robot(link, source).is_none() {
            return;
        }
        self.described = true;
        if geometry != self.config.filter_config.geometry {
            self.config.filter_config.geometry = geometry;
            self.interpreter.geometry = geometry;
            self.rebuild_filter();
        }
    }

    /// A filter of the new geometry goes on where the old one was, if that knew where it was.
    fn rebuild_filter(&mut self) {
        let mut filter_config = self.config.filter_config.clone();
        let estimate = self
            .filter
            .latest()
            .and_then(|latest| self.filter.estimate_at(latest))
            .filter(|estimate| estimate.validity.position && estimate.validity.heading);
        if let Some(estimate) = estimate {
            filter_config.start = Some(StartPose {
                pose: estimate.pose,
                position_sigma_m: estimate.x_sigma_m().max(estimate.y_sigma_m()),
                heading_sigma_rad: estimate.heading_sigma_rad(),
            });
        }
        if let Some(entry) = filter_named(&self.config.filter) {
            self.filter = (entry.build)(&filter_config);
            // What is frozen stays so; a filter that does not learn has nothing to say to this.
            let _ = self.filter.adjust(&Adjustment::Learning(self.standing.learning));
        }
    }
}

/// The geometry that a robot says it has, if every length of it can be one.
fn geometry_of(said: &RobotDescription) -> Option<DriveGeometry> {
    let geometry = DriveGeometry {
        left_wheel_radius: said.left_wheel_radius,
        right_wheel_radius: said.right_wheel_radius,
        track_width: said.track_width,
        tick: Radians(std::f64::consts::TAU / said.ticks_per_turn),
    };
    let lengths =
        [geometry.left_wheel_radius.0, geometry.right_wheel_radius.0, geometry.track_width.0, geometry.tick.0];
    lengths.iter().all(|length| length.is_finite() && *length > 0.0).then_some(geometry)
}

const fn robot_at(link: LinkId, address: Address) -> RobotId {
    RobotId { link, address }
}

/// Standard deviation of an instant that lies anywhere within plus or minus `bound`: uniform.
fn sigma_of(bound: Span) -> Span {
    Span::from_secs_f64(bound.as_secs_f64() / 3.0_f64.sqrt())
}
