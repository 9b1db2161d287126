//! Observations in messages: from a message to the robot's clock, estimator and publisher.

use std::net::IpAddr;

use posebridge_protocol::bricks::CodecEvent;
use posebridge_protocol::message::{Message, RobotDescription, WireStamp};
use posebridge_protocol::routing::{DuplicateStatus, Endpoint};
use posebridge_protocol::session::most_answers;
use posebridge_telemetry::{
    Address, Event, FusionOutcome, HostClock, LinkId, Observation, ObservationKind, ReceiveError, RobotId, SensorId,
    TimeDelta, Timestamp, severity,
};

use crate::clock::align::Alignment;
use crate::config::DescriptionPolicy;
use crate::estimator::RESET_TEXT;
use crate::observation_extractor::{ClockSource, ObservationExtractor, UnalignedObservation};
use crate::observers::ObserverAddress;
use crate::receive::{ReceiveInfo, ReceivedMessage, TimeExchange, owned};
use crate::robot::described_geometry;
use crate::sender_identity::{ContestedMessage, MessageOrigin, RobotIndex, SenderIdentity};
use crate::sender_pins::{IdentityClaim, PinVerdict};
use crate::sessions::is_request;
use crate::station::Station;
use crate::vehicle_status::battery_of;

/// Whether any of a message's observations is a robot's own.
fn is_telemetry(observations: &[Option<UnalignedObservation>]) -> bool {
    observations.iter().flatten().any(|one| one.clock_source == ClockSource::Robot)
}

/// Whether a robot that was programmed for this station sends it.
const fn is_of_own_dialect(message: &Message) -> bool {
    matches!(message, Message::WheelTicks(_) | Message::Inertial(_) | Message::RobotDescription(_))
}

#[derive(Clone, Copy)]
pub(crate) struct MessageSender {
    pub(crate) received: ReceiveInfo,
    pub(crate) origin: MessageOrigin,
    pub(crate) robot: Option<RobotIndex>,
}

impl Station {
    /// Handles a message: sessions first, then its observations.
    pub(crate) fn handle_message(&mut self, received: ReceiveInfo, message: &ReceivedMessage) {
        let now = self.time.now;
        let ReceivedMessage { source, duplicate_status, is_signed, message: ref content } = *message;
        // Redundant links are one: a robot, its clock and its observations know only the first of them.
        let home = self.router.first_of_group(received.endpoint.link);
        let known = self.robots.identities.find(received.endpoint, home, source);
        let observer = ObserverAddress { home, address: source };
        let extractor = known.map(|index| self.robots.get(index).extractor);
        let extractor =
            extractor.unwrap_or_else(|| self.extractor_for_unknown(received.endpoint, observer, content.fix_tag()));
        let observations = extractor.extract(received.host_time, content);
        let has_observation = observations.iter().flatten().next().is_some();
        let peer = received.endpoint.peer;
        let claim = IdentityClaim { ids: source, has_observation, peer, host: None, is_signed };
        if !self.admit_claim(received.endpoint, claim) {
            return;
        }
        if self.charge_request_budget(received.endpoint, message) {
            self.sessions.handle(now, received.endpoint, message, known);
            self.drain_sessions(received);
        }
        if duplicate_status == DuplicateStatus::Duplicate {
            self.observe_copy(received, observer, known, content, &observations);
            // Robots that are built alike begin with the same bytes: it is no copy if its sender proves to be another one.
            let is_of_robot = matches!(content, Message::RobotDescription(_)) || is_telemetry(&observations);
            if known.is_none() && is_of_robot && self.robots.identities.is_known(source) {
                self.keep_contested(received, source, content);
            }
            return;
        }
        if let (Message::StatusText { severity, text, .. }, DuplicateStatus::New) = (content, duplicate_status) {
            self.emit(Event::Text { source, severity: *severity, text: text.clone() });
        }
        if duplicate_status == DuplicateStatus::New {
            self.observe_steering(received.endpoint.link, known, content);
        }
        if let (Message::SetGlobalOrigin(request), DuplicateStatus::New) = (content, duplicate_status) {
            self.handle_set_origin(received.endpoint, request);
        }
        if let Some(line) =
            self.sensor_inventory.observe(now, (home, source), content, &observations, self.config.origin)
        {
            self.report_own_text(severity::NOTICE, line);
        }
        self.observers.fix_requests.observe_message((home, source), content);
        if let (Message::Heartbeat(heartbeat), DuplicateStatus::New) = (content, duplicate_status)
            && heartbeat.is_ground_station()
            && let Some(link) = self.links.get_mut(&received.endpoint.link)
        {
            let is_served = link.add_ground_station(received.endpoint.peer);
            if !is_served && !std::mem::replace(&mut link.has_named_ground_stations, true) {
                let link = received.endpoint.link;
                let text = format!("link {link} has too many ground stations: those that came last get no broadcasts");
                self.report_own_text(severity::WARNING, text);
            }
        }
        if matches!(
            content,
            Message::ParamRequestList { .. } | Message::ParamRequestRead { .. } | Message::ParamSet { .. }
        ) && let Some(link) = self.links.get_mut(&received.endpoint.link)
        {
            link.add_parameter_client(received.endpoint.peer);
        }
        let origin = MessageOrigin {
            endpoint: received.endpoint,
            home,
            address: source,
            is_new: duplicate_status == DuplicateStatus::New,
            is_telemetry: is_telemetry(&observations),
        };
        let mut sender = MessageSender { received, origin, robot: None };
        match self.robots.identities.identify(now, origin, known) {
            SenderIdentity::Contested => {
                if origin.is_new {
                    self.keep_contested(received, source, content);
                }
                return;
            }
            SenderIdentity::Robot(index) => {
                sender.robot = Some(index);
                self.robots.record_contact(index, received.endpoint, now);
            }
            SenderIdentity::Unknown => {
                // A description identifies no robot: telemetry will, and then it counts.
                if matches!(content, Message::RobotDescription(_)) && self.robots.identities.is_known(source) {
                    self.keep_contested(received, source, content);
                    return;
                }
            }
        }
        let was_robot = sender.robot.is_some();
        if origin.is_telemetry {
            self.handle_contested(&mut sender);
        }
        self.handle_content(&mut sender, content, &observations);
        if let Some(index) = sender.robot.filter(|_| !was_robot) {
            self.distinguish_cameras(&sender, index);
        }
    }

    /// Whether a message asks for nothing, or for no more than its peer may ask for; then the peer is charged.
    fn charge_request_budget(&mut self, endpoint: Endpoint, received: &ReceivedMessage) -> bool {
        let now = self.time.now;
        let message = &received.message;
        // The copy of a request is not carried out again.
        let is_copy = received.duplicate_status != DuplicateStatus::New && is_request(message);
        if is_copy || !self.sessions.are_asked(now, endpoint.link, message) {
            return true;
        }
        let link = self.links.get_mut(&endpoint.link);
        link.is_none_or(|link| link.charge_request(now, endpoint.peer, most_answers(message)))
    }

    /// Whether the sender of a message may use these ids, on a link with pins. A refusal is counted, and told now and then.
    fn admit_claim(&mut self, endpoint: Endpoint, claim: IdentityClaim) -> bool {
        let now = self.time.now;
        let Some(link) = self.links.get_mut(&endpoint.link) else {
            return true;
        };
        let host = link.host(endpoint.peer);
        let Some(pins) = &mut link.pins else {
            return true;
        };
        let PinVerdict::Refused { owner, is_new } = pins.check(now, IdentityClaim { host, ..claim }) else {
            return true;
        };
        link.health.rejected_frames += 1;
        if is_new {
            let name =
                |host: Option<IpAddr>, other: &str| host.map_or_else(|| other.to_owned(), |host| host.to_string());
            let text = format!(
                "link {}: {} is {}: what {} sends with these ids is refused (pin)",
                endpoint.link,
                claim.ids,
                name(owner, "another peer"),
                name(host, "a stranger")
            );
            self.report_own_text(severity::WARNING, text);
        }
        false
    }

    fn keep_contested(&mut self, received: ReceiveInfo, source: Address, content: &Message) {
        self.robots.contested.push(received.endpoint, source, ContestedMessage::Message(received, content.clone()));
    }

    /// Handles the kept messages of a sender that is now identified as a robot.
    fn handle_contested(&mut self, sender: &mut MessageSender) {
        let MessageOrigin { endpoint, address, .. } = sender.origin;
        let received = sender.received;
        for earlier in self.robots.contested.take(endpoint, address) {
            if let ContestedMessage::Message(earlier, message) = earlier {
                sender.received = earlier;
                let extractor = self.extractor_for(sender, message.fix_tag());
                let observations = extractor.extract(earlier.host_time, &message);
                self.handle_content(sender, &message, &observations);
            }
        }
        sender.received = received;
    }

    /// The extractor for a sender: a robot's own, or that for an unknown one.
    fn extractor_for(&self, sender: &MessageSender, tag: Option<u32>) -> ObservationExtractor {
        let MessageOrigin { endpoint, home, address, .. } = sender.origin;
        match sender.robot {
            Some(index) => self.robots.get(index).extractor,
            None => self.extractor_for_unknown(endpoint, ObserverAddress { home, address }, tag),
        }
    }

    fn handle_content(
        &mut self,
        sender: &mut MessageSender,
        content: &Message,
        observations: &[Option<UnalignedObservation>],
    ) {
        let origin = sender.origin;
        if let Message::RobotDescription(description) = content {
            self.handle_description(sender, description);
        }
        if let (Some(index), true) = (sender.robot, is_of_own_dialect(content)) {
            let robot = self.robots.get_mut(index);
            if !std::mem::replace(&mut robot.is_of_own_dialect, true) {
                let system = robot.vehicle_address.system;
                self.sessions.record_own_dialect(system);
            }
        }
        if let (Some(index), Some(battery)) = (sender.robot, battery_of(content)) {
            self.robots.get_mut(index).battery.observe(self.time.now, &battery);
        }
        if let Message::Thermometer { stamp, channel, temperature } = *content {
            self.handle_temperature(sender, stamp, channel, temperature);
        }
        for observation in observations.iter().flatten() {
            // A frame from a loop is new only from a robot, whose telemetry counts on its own link alone.
            if origin.is_new || sender.robot.is_some() || observation.clock_source == ClockSource::Robot {
                self.handle_observation(sender, observation);
            }
        }
    }

    /// Handles the output of a codec, then sends its requests. No router handles its messages: only the station
    /// understands the protocol.
    pub(crate) fn handle_codec_events(&mut self, received: ReceiveInfo, events: Vec<CodecEvent<'static>>) {
        let link = received.endpoint.link;
        for event in events {
            match event {
                CodecEvent::Message { from: source, message } => {
                    let duplicate_status = DuplicateStatus::New;
                    let message = ReceivedMessage { source, duplicate_status, is_signed: false, message };
                    self.handle_message(received, &message);
                }
                CodecEvent::ClockReply { from, sent, peer_nanos } => {
                    self.handle_time_exchange(from, &TimeExchange { sent, answer: received, peer_nanos });
                }
                CodecEvent::StatusText { from: source, severity, text } => {
                    self.emit(Event::Text { source, severity, text });
                }
                CodecEvent::Error(error) => self.emit(Event::ReceiveError { link, defect: error }),
                CodecEvent::ForwardFrame(_) => {}
            }
        }
        self.transmitter().send_codec_output(link);
    }

    /// Runs a codec's due timeouts and requests.
    pub(crate) fn run_codec(&mut self, id: LinkId) {
        let now = self.time.now;
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        let is_due = link.codec_deadline().is_some_and(|due| due <= now);
        let Some(codec) = link.codec.as_mut().filter(|_| is_due) else {
            return;
        };
        let mut events = Vec::new();
        codec.tick(now, &mut |event| events.extend(owned(event)));
        self.handle_codec_events(ReceiveInfo::local(id, now), events);
    }

    /// The extractor for a sender that is no robot yet: with its own geometry, and the tag of the robot to which its
    /// fixes belong.
    fn extractor_for_unknown(
        &self,
        endpoint: Endpoint,
        sender: ObserverAddress,
        tag: Option<u32>,
    ) -> ObservationExtractor {
        let unknown = ObservationExtractor::new(
            self.robots.config_for(&self.config, sender.home, sender.address),
            self.config.origin,
        );
        // A robot that another station has handed over may have described itself to that.
        let prepared = self.robots.find_prepared(RobotId { link: sender.home, address: sender.address });
        let unknown = prepared.map_or(unknown, |robot| robot.extractor);
        let robot = self
            .robots
            .of_fix(&self.config, endpoint, sender.address, tag, None)
            .map(|index| self.robots.get(index).extractor);
        let robot = robot.unwrap_or(unknown);
        ObservationExtractor { tag_in_body: robot.tag_in_body, wiring: robot.wiring, ..unknown }
    }

    /// A duplicate from another link of the group adds only a bound of its sender's clock.
    fn observe_copy(
        &mut self,
        received: ReceiveInfo,
        observer: ObserverAddress,
        robot: Option<RobotIndex>,
        message: &Message,
        observations: &[Option<UnalignedObservation>],
    ) {
        if let Message::Thermometer { stamp, .. } = *message {
            match robot {
                Some(index) => self.robots.get_mut(index).clocks.observe_copy(received, stamp),
                None => self.observers.observe_copy(observer, received, stamp),
            }
        }
        for observation in observations.iter().flatten() {
            match robot {
                Some(index) if observation.clock_source == ClockSource::Robot => {
                    self.robots.get_mut(index).clocks.observe_copy(received, observation.stamp);
                }
                Some(_) | None => self.observers.observe_copy(observer, received, observation.stamp),
            }
        }
    }

    fn handle_observation(&mut self, sender: &mut MessageSender, observation: &UnalignedObservation) {
        match (observation.clock_source, sender.robot) {
            (ClockSource::Robot, _) => {
                // A board with a gyro or a compass alone is no further robot.
                let may_be_robot = sender.robot.is_some() || self.robots.len() == 0 || observation.is_of_wheels();
                if let Some(index) = may_be_robot.then(|| self.adopt_robot(sender)).flatten() {
                    self.handle_robot_observation(sender.received, index, observation);
                }
            }
            (ClockSource::Observer, Some(index)) => self.handle_relayed_fix(sender.received, index, observation),
            (ClockSource::Observer, None) => self.handle_observer_fix(sender, observation),
        }
    }

    /// The robot of a sender of odometry, if it may be one.
    fn adopt_robot(&mut self, sender: &mut MessageSender) -> Option<RobotIndex> {
        if sender.robot.is_none() {
            sender.robot = self.robots.adopt(self.time.now, sender.origin, &self.config, &mut self.observers);
            if self.robots.take_first_refusal() {
                let most = self.config.max_robots;
                let text = format!("more than {most} robots (station.max_robots): those heard last are not followed");
                self.report_own_text(severity::WARNING, text);
            }
            if let Some(index) = sender.robot {
                let robot = self.robots.get(index);
                if let Some(name) = robot.name() {
                    self.emit(Event::RobotNamed { robot: robot.id, name: name.to_owned() });
                }
                self.report_announced_system(index, sender.origin.address);
                self.update_presence();
            }
        }
        sender.robot
    }

    /// Reports that a robot is announced under another system id than its own.
    fn report_announced_system(&mut self, index: RobotIndex, address: Address) {
        let robot = self.robots.get(index);
        let announced = robot.vehicle_address.system;
        if announced != address.system {
            let link = robot.id.link;
            let text = format!(
                "system {} of robot {address} on link {link} is taken: it is announced as {announced}/{}",
                address.system, address.component
            );
            self.report_own_text(severity::WARNING, text);
            // The requests to every new sender were sent to these ids when the other robot appeared.
            self.sessions.handle_peer_restart(self.time.now, link, address);
        }
    }

    fn handle_robot_observation(
        &mut self,
        received: ReceiveInfo,
        index: RobotIndex,
        observation: &UnalignedObservation,
    ) {
        let Some((time, sigma)) = self.align_robot_time(received, index, observation.stamp) else {
            return;
        };
        let robot = self.robots.get_mut(index);
        let is_gyro_off = robot.estimator.switched_off.contains(&SensorId::GYRO);
        if is_gyro_off {
            robot.motion_sources.forget_turn_rate();
        }
        let Some(observation) = &robot.motion_sources.select(received.host_time, observation) else {
            return;
        };
        let measurement = robot.clocks.mean_turn_rate(time, observation);
        let source = robot.id.address;
        let aligned = Observation { sensor: observation.sensor, stamp: time, stamp_sigma: sigma, measurement };
        self.observe(index, source, received.host_time, aligned);
    }

    /// The instant of a robot's timestamp and its sigma; `None` if it has none.
    pub(crate) fn align_robot_time(
        &mut self,
        received: ReceiveInfo,
        index: RobotIndex,
        stamp: WireStamp,
    ) -> Option<(Timestamp<posebridge_telemetry::BrickClock>, TimeDelta)> {
        let robot = self.robots.get_mut(index);
        let id = robot.id;
        let aligned = robot.clocks.align(received, stamp);
        if aligned.has_restarted {
            self.handle_robot_restart(index);
        }
        if aligned.is_unaligned {
            self.report_unaligned(received.endpoint.link, id.address);
        }
        aligned.time
    }

    /// Uses an observation in a robot's estimator and publishes the result.
    pub(crate) fn observe(
        &mut self,
        index: RobotIndex,
        source: Address,
        arrival: Timestamp<HostClock>,
        observation: Observation,
    ) -> FusionOutcome {
        let now = self.time.now;
        let robot = self.robots.get(index).id;
        self.emit(Event::ObservationAligned { robot, source, arrival, observation });
        let report = self.robots.get_mut(index).observe(&observation);
        if report.is_used {
            self.robots.changed.insert(index);
        }
        if let ObservationKind::WallRange(range) = observation.measurement {
            let links = &self.links;
            let is_up =
                |id: LinkId| links.get(&id).is_some_and(|link| link.state == posebridge_telemetry::LinkState::Up);
            let robot = self.robots.get_mut(index);
            let host = robot.clocks.to_host(observation.stamp).unwrap_or(now);
            for message in robot.publisher.publish_range(now, range, host, is_up) {
                self.transmitter().send_published(index, &message);
            }
        }
        let robot_entry = self.robots.get_mut(index);
        robot_entry.sensor_health.observe(now, &observation, report.record.outcome);
        for message in robot_entry.publisher.publish_record(now, &report.record, &robot_entry.clocks) {
            self.transmitter().send_published(index, &message);
        }
        let alarm = self.robots.get_mut(index).alarms.observe(&report.record);
        // A damaged one says nothing of the wiring.
        let is_sound = report.record.outcome != FusionOutcome::Malformed;
        let finding = if is_sound { self.robots.get_mut(index).check_wiring(&observation) } else { None };
        let outcome = report.record.outcome;
        self.emit(Event::ObservationFused { robot, record: report.record });
        let reset = report.is_reset.then(|| RESET_TEXT.to_owned());
        for text in [alarm, finding, reset].into_iter().flatten() {
            self.report_own_text(severity::WARNING, self.robots.labelled(index, &text));
        }
        outcome
    }

    pub(crate) fn handle_time_exchange(&mut self, peer: Address, exchange: &TimeExchange) {
        // No clock of a robot or a camera counts backwards from its power-up: a negative instant is damage.
        if exchange.peer_nanos < 0 {
            return;
        }
        let link = exchange.answer.endpoint.link;
        // Bounds of one clock, whichever of several redundant links they came by.
        let home = self.router.first_of_group(link);
        match self.robots.identities.find(exchange.answer.endpoint, home, peer) {
            Some(index) => self.align_robot_clock(index, exchange),
            None => self.align_observer_clock(ObserverAddress { home, address: peer }, exchange),
        }
    }

    fn align_robot_clock(&mut self, index: RobotIndex, exchange: &TimeExchange) {
        let robot_entry = self.robots.get_mut(index);
        let robot = robot_entry.id;
        let outcome = robot_entry.clocks.observe_exchange(exchange);
        if outcome.is_contradicted {
            self.report_unaligned(exchange.answer.endpoint.link, robot.address);
        }
        if outcome.has_restarted {
            self.handle_robot_restart(index);
        }
        if let Some(Alignment { remote, host, offset, skew_ppm, uncertainty, round_trip, .. }) = outcome.alignment {
            let round_trip = Some(round_trip);
            let brick = remote;
            self.emit(Event::BrickClockAligned { robot, offset, skew_ppm, uncertainty, round_trip, brick, host });
        }
    }

    /// After a restart a robot has forgotten all requests.
    fn handle_robot_restart(&mut self, index: RobotIndex) {
        let now = self.time.now;
        let robot = self.robots.get_mut(index);
        let (id, wire_address) = (robot.id, robot.wire_address);
        robot.restart_clock();
        let system = robot.vehicle_address.system;
        self.sessions.record_restart(system);
        self.restart_thermometers(id);
        self.robots.get_mut(index).clocks.forget_gyro_turn();
        for link in self.links.keys() {
            if self.router.are_redundant(*link, id.link) {
                self.sessions.handle_peer_restart(now, *link, wire_address);
            }
        }
        self.emit(Event::BrickRestarted { robot: id });
    }

    fn handle_description(&mut self, sender: &mut MessageSender, description: &RobotDescription) {
        let is_expected = sender.robot.map_or_else(
            || {
                let robot = self.robots.config_for(&self.config, sender.origin.home, sender.origin.address);
                robot.description == DescriptionPolicy::Adopt
            },
            |index| self.robots.get(index).needs_description(),
        );
        let Some(geometry) = described_geometry(description).filter(|_| is_expected) else {
            return;
        };
        if let Some(index) = self.adopt_robot(sender) {
            self.robots.get_mut(index).set_described_geometry(geometry);
        }
    }

    /// Sends time requests in quick succession, to align a clock that restarted.
    pub(crate) fn request_time_burst(&mut self, observer: ObserverAddress) {
        self.sessions.handle_peer_restart(self.time.now, observer.home, observer.address);
    }

    pub(crate) fn report_unaligned(&mut self, link: LinkId, source: Address) {
        self.emit(Event::ReceiveError { link, defect: ReceiveError::ClockNotAligned { source } });
    }
}
