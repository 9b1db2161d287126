//! Cameras: their fixes on the way to a robot's estimator, their clocks, and requests for more.

use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{
    Address, Estimate, Event, FusionOutcome, FusionRecord, HostClock, LinkId, Observation, ObservationKind, Output,
    OutsideFix, Priority, Request, RobotId, SensorId, TimeDelta, Timestamp, severity,
};

use crate::camera_table::{CameraIdentity, FixAdmission, Newcomers};
use crate::clock::align::Alignment;
use crate::config::OwnershipPolicy;
use crate::fix_requests::fix_request;
use crate::observation_extractor::UnalignedObservation;
use crate::observations::MessageSender;
use crate::observers::ObserverAddress;
use crate::receive::{ReceiveInfo, TimeExchange};
use crate::sender_identity::{ContestedMessage, MessageOrigin, RobotIndex};
use crate::sender_pins::SenderPins;
use crate::station::Station;

/// Who sent a fix, and when it came.
#[derive(Clone, Copy, Debug)]
struct FixSender {
    arrival: Timestamp<HostClock>,
    source: Address,
    /// The first link of its group, and where it was received; `None` if it came over no link.
    link: Option<(LinkId, Endpoint)>,
}

impl Station {
    /// A fix that a robot relays, stamped by its own clock: it may be older than any reordering explains.
    pub(crate) fn handle_relayed_fix(
        &mut self,
        received: ReceiveInfo,
        index: RobotIndex,
        observation: &UnalignedObservation,
    ) {
        let robot = self.robots.get(index);
        let source = robot.id.address;
        let Some(time) = robot.clocks.aligner.nearest_instant(observation.stamp) else {
            return;
        };
        let aligned = Observation {
            sensor: observation.sensor,
            stamp: time,
            stamp_sigma: TimeDelta::ZERO,
            measurement: observation.observed,
        };
        if self.observe(index, source, received.host_time, aligned) == FusionOutcome::Accepted {
            self.robots.get_mut(index).cameras.record_accepted(self.time.now, None);
        }
    }

    /// Converts the fix of an observer with its own clock: to the host's clock, then to that of the robot to which it
    /// belongs.
    pub(crate) fn handle_observer_fix(&mut self, sender: &MessageSender, observation: &UnalignedObservation) {
        let (link, source) = (sender.origin.home, sender.origin.address);
        let observer = ObserverAddress { home: link, address: source };
        if self.observers.is_contested(observer, sender.received) {
            let fix = ContestedMessage::Fix(sender.received, *observation);
            self.robots.contested.push(sender.origin.endpoint, source, fix);
            return;
        }
        self.handle_contested_observer(sender);
        let host = self.observers.host_time(observer, sender.received, observation.stamp);
        if self.observers.take_namesake() {
            self.request_time_burst(observer);
        }
        if host.has_restarted {
            self.request_time_burst(observer);
            self.observers.fix_requests.reset_camera((link, source));
        }
        if let (Some((time, uncertainty)), Some(tag)) = (host.time, observation.tag) {
            self.share_fix(tag, source, time, uncertainty, observation.observed);
        }
        let camera = CameraIdentity { observer: host.observer, address: source };
        let watched = self.robots.only_seen_by(self.time.now, camera);
        let robot = self.robots.of_fix(&self.config, sender.received.endpoint, source, observation.tag, watched);
        let aligned = host.time.zip(robot).and_then(|((time, uncertainty), index)| {
            Some((index, self.robots.get(index).clocks.at_host_time(time, uncertainty)?))
        });
        let Some((index, (time, sigma))) = aligned else {
            self.report_unaligned(link, source);
            return;
        };
        let fix = Observation {
            sensor: observation.sensor,
            stamp: time,
            stamp_sigma: sigma,
            measurement: observation.observed,
        };
        let from =
            FixSender { arrival: sender.received.host_time, source, link: Some((link, sender.received.endpoint)) };
        self.observe_fix(index, from, camera, fix);
    }

    /// A fix from another station or program, whose time is on the host's clock. The error of that time is part of the fix.
    pub(crate) fn handle_outside_fix(&mut self, robot: RobotId, outside: &OutsideFix) {
        let Some(index) = self.robots.find(robot) else {
            return;
        };
        let (now, source) = (self.time.now, outside.source);
        let camera = CameraIdentity { observer: self.observers.outside(source, now), address: source };
        let clocks = &self.robots.get(index).clocks;
        let Some((stamp, stamp_sigma)) = clocks.at_host_time(outside.time, outside.uncertainty) else {
            return;
        };
        let measurement = ObservationKind::Fix(outside.fix);
        let observation = Observation { sensor: SensorId::CAMERA, stamp, stamp_sigma, measurement };
        self.observe_fix(index, FixSender { arrival: now, source, link: None }, camera, observation);
    }

    /// In a fleet the robot with the tag may be another station's.
    fn share_fix(
        &mut self,
        tag: u32,
        source: Address,
        time: Timestamp<HostClock>,
        uncertainty: TimeDelta,
        observed: ObservationKind,
    ) {
        if let (OwnershipPolicy::Fleet, ObservationKind::Fix(fix)) = (self.config.ownership, observed) {
            let fix = OutsideFix { source, time, uncertainty, fix };
            self.outputs.push(Output::Request(Request::ShareFix { tag, fix }));
        }
    }

    /// Gives a robot's filter the fix of a camera, unless that has to agree with the others first.
    fn observe_fix(
        &mut self,
        index: RobotIndex,
        sender: FixSender,
        camera: CameraIdentity,
        mut observation: Observation,
    ) {
        let now = self.time.now;
        let FixSender { arrival, source, link } = sender;
        if let ObservationKind::Fix(fix) = &mut observation.measurement {
            let pins = link.and_then(|(_, endpoint)| self.links.get(&endpoint.link)?.pins.as_ref());
            let has_pins = pins.is_some_and(SenderPins::keeps_first_camera);
            let newcomers = if has_pins { Newcomers::Refused } else { Newcomers::OnProbation };
            match self.robots.get_mut(index).admit_fix(now, camera, fix, observation.stamp, newcomers) {
                FixAdmission::Use { sensor, reset_counter } => {
                    observation.sensor = sensor;
                    fix.reset_counter = reset_counter;
                }
                FixAdmission::HoldBack { sensor, named_distance_m } => {
                    observation.sensor = sensor;
                    self.hold_back(index, source, arrival, observation);
                    if let Some(distance_m) = named_distance_m {
                        let place = link.map_or_else(|| "outside".to_owned(), |(home, _)| format!("on link {home}"));
                        let text = format!(
                            "camera {source} {place} sees it {distance_m:.1} m from where the others do: not used until it agrees"
                        );
                        self.report_own_text(severity::WARNING, self.robots.labelled(index, &text));
                    }
                    return;
                }
            }
        }
        let outcome = self.observe(index, source, arrival, observation);
        if matches!(outcome, FusionOutcome::Accepted | FusionOutcome::PoseReset) {
            self.robots.get_mut(index).cameras.record_accepted(now, Some(camera));
        }
    }

    /// Reports a fix that the filter is not given.
    fn hold_back(
        &mut self,
        index: RobotIndex,
        source: Address,
        arrival: Timestamp<HostClock>,
        observation: Observation,
    ) {
        let robot = self.robots.get(index).id;
        self.emit(Event::ObservationAligned { robot, source, arrival, observation });
        let kind = observation.measurement.kind();
        let record = FusionRecord::new(observation.sensor, kind, observation.stamp, FusionOutcome::Unused);
        self.emit(Event::ObservationFused { robot, record });
    }

    /// Handles the kept messages of a camera that is now identified.
    pub(crate) fn handle_contested_observer(&mut self, sender: &MessageSender) {
        let MessageOrigin { endpoint, address, .. } = sender.origin;
        for earlier in self.robots.contested.take(endpoint, address) {
            match earlier {
                ContestedMessage::TimeExchange(exchange) => self.handle_time_exchange(address, &exchange),
                ContestedMessage::Fix(received, fix) => {
                    let sender = MessageSender { received, ..*sender };
                    self.handle_observer_fix(&sender, &fix);
                }
                ContestedMessage::Message(..) => {}
            }
        }
    }

    /// A robot was distinguished from others with its ids, and with it the cameras that share its connection.
    pub(crate) fn distinguish_cameras(&mut self, sender: &MessageSender, index: RobotIndex) {
        let MessageOrigin { endpoint, home, .. } = sender.origin;
        let namesakes = self.robots.namesake_peers(index, endpoint.link);
        for address in self.observers.distinguish(sender.received, home, &namesakes) {
            let origin = MessageOrigin { address, is_telemetry: false, ..sender.origin };
            self.handle_contested_observer(&MessageSender { origin, robot: None, ..*sender });
        }
    }

    pub(crate) fn align_observer_clock(&mut self, observer: ObserverAddress, exchange: &TimeExchange) {
        let Some(outcome) = self.observers.observe_exchange(observer, exchange) else {
            let contested = ContestedMessage::TimeExchange(*exchange);
            self.robots.contested.push(exchange.answer.endpoint, observer.address, contested);
            return;
        };
        if outcome.is_contradicted {
            self.report_unaligned(exchange.answer.endpoint.link, observer.address);
        }
        if outcome.has_restarted {
            self.request_time_burst(observer);
        }
        if let Some(Alignment { remote, host, offset, uncertainty, .. }) = outcome.alignment {
            self.emit(Event::CameraClockAligned { camera: observer.address, offset, uncertainty, stamp: remote, host });
        }
    }

    /// Requests fixes from cameras if an estimate is too uncertain; `None` is no estimate.
    pub(crate) fn request_fixes(&mut self, estimate: Option<&Estimate>) {
        let due = self.observers.fix_requests.due(self.time.now, &self.config.fix_requests, estimate);
        for (link, camera) in due {
            self.transmitter().send(link, &fix_request(camera), Priority::Command);
        }
    }
}
