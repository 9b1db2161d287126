//! The loop that owns a station and its links: bytes in, reply out, in one wake-up.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use posebridge_dashboard::StationStatus;
use posebridge_link::{DeadlineTimer, HostTimer, LinkEvent, LinkSet, OutgoingFrame};
use posebridge_recording::container::TruthSample;
use posebridge_station::Station;
use posebridge_telemetry::severity::WARNING;
use posebridge_telemetry::{
    Arena, Command, Event, HostClock, Input, LinkId, LinkState, Output, PeerId, Pose, Priority, Request, TimeDelta,
    Timestamp,
};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::bag_recorder::BagRecorder;
use super::fleet::{Fleet, FleetEvent};
use super::link_log::LinkLog;
use super::observer::Observer;
use super::page_history::station_status;
use super::recorder::Recorder;
use super::requests::RequestHandler;
use super::ros2::Ros2Publisher;
use super::setup::SetupChecklists;
use super::side_file::{SideFile, SideFileFormat};
use super::signing::SigningStateWriter;
use super::simulator::TruthTap;
use super::tlog_writer::TlogRecorder;
use super::viewers::{DashboardHandle, next_command};
use super::watchdog::{TURN_PERIOD, Watchdog};
use crate::exit::DeferredErrors;

/// Period of the link counters, equal to that of the health reports.
const COUNTS_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// An observation causes three events: received, fused, estimate.
const USUAL_EVENTS: usize = 4;

#[derive(Clone, Debug)]
pub struct StopConditions {
    /// Cancelled on request, or by the end of the simulated brick.
    pub stop: CancellationToken,
    /// Progress of the simulated brick, if there is one; at 1 it disconnects.
    pub progress: Option<watch::Receiver<f64>>,
    pub at: Option<Timestamp<HostClock>>,
    /// Maximum time without a byte, after the first one.
    pub silence: Option<TimeDelta>,
}

pub struct StationLoop {
    pub station: Station,
    pub links: LinkSet,
    pub timer: HostTimer,
    /// The recording, if there is one. It can be removed and replaced while the loop runs; a new one begins after [`Self::input_count`]
    /// inputs.
    pub recorder: Option<Recorder>,
    pub input_count: u64,
    pub tlog: Option<TlogRecorder>,
    pub bag: Option<BagRecorder>,
    pub ros2: Option<Ros2Publisher>,
    pub observer: Observer,
    pub dashboard: Option<DashboardHandle>,
    pub setup: SetupChecklists,
    /// Errors of a recording or telemetry log that ended before the run.
    pub failures: DeferredErrors,
    pub signing: Option<SigningStateWriter>,
    /// The stations that this one shares robots with.
    pub fleet: Option<Fleet>,
    pub requests: RequestHandler,
    pub truth: Vec<TruthTap>,
    /// The pose of the first robot with an estimate, until it is set.
    pub first_pose: Option<Pose<Arena>>,
    pub watchdog: Watchdog,
    pub link_log: LinkLog,
}

impl StationLoop {
    /// Runs until an end condition; recorder and observer then process their queues. A failed recorder is removed with its error: a
    /// full disk must not stop a robot that steers by this station.
    pub async fn run(&mut self, ending: &StopConditions) {
        let mut next_counts = self.timer.now() + COUNTS_PERIOD;
        let mut last_byte: Option<Timestamp<HostClock>> = None;
        let mut finished: BTreeSet<LinkId> = BTreeSet::new();
        let mut states: BTreeMap<LinkId, LinkState> = BTreeMap::new();
        let stopped = ending.stop.cancelled();
        tokio::pin!(stopped);
        let mut deadline_timer = DeadlineTimer::new(self.timer);
        let mut clock_step = ClockStepDetector::default();
        let mut newest_peers = NewestPeers::default();
        while !ending.stop.is_cancelled() && finished.len() < self.links.iter().len() {
            let silent_at = ending.silence.and_then(|limit| last_byte.map(|last| last + limit));
            let end_at = [ending.at, silent_at].into_iter().flatten().min();
            let deadline = self.station.deadline().into_iter().chain(end_at).min();
            let turned = self.timer.now();
            self.report_stall(turned);
            let fleet_deadline = self.fleet.as_ref().and_then(Fleet::deadline);
            let wake_at = deadline.into_iter().chain(fleet_deadline).chain([turned + TURN_PERIOD]).min();
            let (now, input) = tokio::select! {
                // What came goes first; the station sees by its instant what is due, and the loop whether it has to end.
                biased;
                (link, event) = self.links.next_event() => {
                    if matches!(event, LinkEvent::Finished { .. }) {
                        finished.insert(link);
                    }
                    let (at, input) = self.input_of(link, event, ending);
                    if !changes_state(link, &input, &mut states) {
                        continue;
                    }
                    if matches!(input, Input::Bytes { .. }) {
                        last_byte = Some(at);
                    }
                    (at, input)
                }
                event = next_fleet_event(&mut self.fleet) => {
                    self.handle_fleet_event(event);
                    continue;
                }
                command = next_command(&mut self.dashboard) => (self.timer.now(), command),
                request = next_ros2_request(&mut self.ros2) => (self.timer.now(), request),
                report = self.requests.next_report() => (self.timer.now(), report),
                () = deadline_timer.wait_until(wake_at) => {
                    let now = self.timer.now();
                    if deadline.is_none_or(|deadline| now < deadline) {
                        self.advance_fleet();
                        continue;
                    }
                    (now, Input::Tick)
                }
                () = &mut stopped => return,
            };
            if end_at.is_some_and(|end| now >= end) {
                return;
            }
            self.advance_fleet();
            if let Some(address) = newest_peers.address_of_new(&self.links, &input) {
                self.handle(now, address);
            }
            self.handle(now, input);
            if now >= next_counts {
                next_counts = now + COUNTS_PERIOD;
                self.report_counters(now);
                for (link, summary) in self.link_log.take_due(now) {
                    tracing::warn!(link = link.0, "{summary}");
                }
                self.check_clock_step(now, &mut clock_step);
                self.record_calibration(now);
                self.publish_status(now);
                self.record_truth();
            }
        }
    }

    /// Gives the robots of a fleet to other stations.
    pub fn leave_fleet(&mut self) {
        if let Some(mut fleet) = self.fleet.take() {
            fleet.shut_down(&self.station);
        }
    }

    /// Before an input: what the fleet says, and whether this station stood still, counts first.
    fn advance_fleet(&mut self) {
        if let Some(fleet) = &mut self.fleet {
            fleet.advance();
            self.handle_fleet_inputs();
        }
    }

    fn handle_fleet_event(&mut self, event: FleetEvent) {
        if let Some(fleet) = &mut self.fleet {
            fleet.handle(event);
            self.handle_fleet_inputs();
        }
    }

    fn handle_fleet_inputs(&mut self) {
        while let Some(input) = self.fleet.as_mut().and_then(|fleet| fleet.next_input(&self.station)) {
            self.handle(self.timer.now(), input);
        }
    }

    /// Saves the final timestamps of the signed links; no frame may be handled after it.
    pub fn save_signing_state(&mut self) -> anyhow::Result<()> {
        let keeper = self.signing.take();
        keeper.map_or(Ok(()), |keeper| keeper.finish(self.timer.now(), &self.station))
    }

    /// The input of an event, whose change of the link is logged.
    fn input_of(&mut self, link: LinkId, event: LinkEvent, ending: &StopConditions) -> (Timestamp<HostClock>, Input) {
        match event {
            LinkEvent::Bytes { peer, arrival, bytes } => (arrival, Input::Bytes { link, peer, bytes }),
            LinkEvent::Up { at, detail } => {
                if self.link_log.admits(at, link, LinkState::Up) {
                    tracing::info!(link = link.0, detail, "link up");
                }
                (at, Input::Link { link, state: LinkState::Up })
            }
            LinkEvent::Down { at, reason, retry_in } => {
                // At 1 the simulated brick has driven all that it was to drive.
                if ending.progress.as_ref().is_some_and(|progress| *progress.borrow() >= 1.0) {
                    tracing::info!(link = link.0, reason, "link down at the end of the drive");
                } else if self.link_log.admits(at, link, LinkState::Down) {
                    let retry_ms = retry_in.as_millis_f64().round();
                    tracing::warn!(link = link.0, reason, retry_ms, "link down");
                } else {
                    // The summary of the minute has it.
                }
                (at, Input::Link { link, state: LinkState::Down })
            }
            LinkEvent::Finished { at } => (at, Input::Link { link, state: LinkState::Down }),
        }
    }

    fn report_stall(&mut self, now: Timestamp<HostClock>) {
        if let Some(stall) = self.watchdog.turn(now) {
            let text = format!("the station stood still for {:.1} s: robots got no estimates", stall.as_secs_f64());
            self.handle(now, warning(text));
        }
    }

    fn report_counters(&mut self, now: Timestamp<HostClock>) {
        let counts: Vec<_> = self.links.iter().map(|port| (port.id(), port.port_counts())).collect();
        for (link, counts) in counts {
            self.handle(now, Input::Port { link, counts });
        }
    }

    /// Reports a change of the computer's date: the recording continues with the date at its start.
    fn check_clock_step(&mut self, now: Timestamp<HostClock>, clock_step: &mut ClockStepDetector) {
        let Some(leap) = clock_step.detect(self.timer.utc_drift()) else {
            return;
        };
        let text = format!(
            "the computer's date was set by {:+.1} s; the session goes on by its own clock, its recording by the date at its start",
            leap.as_secs_f64()
        );
        tracing::warn!("{text}");
        if let Some(recorder) = &mut self.recorder {
            recorder.record_message(now, 4, &text);
        }
    }

    fn record_calibration(&mut self, now: Timestamp<HostClock>) {
        let Some(recorder) = &mut self.recorder else {
            return;
        };
        for robot in self.station.robots() {
            if let Some(learned) = robot.calibration() {
                recorder.record_calibration(now, robot.id(), learned);
            }
        }
    }

    fn publish_status(&self, now: Timestamp<HostClock>) {
        if let Some(dashboard) = &self.dashboard {
            let setup = self.setup.rows(now, &self.station);
            let loop_stalls = self.watchdog.stalls();
            let status = StationStatus { setup, loop_stalls, ..station_status(&self.station, self.recorder.as_ref()) };
            dashboard.publish_status(now, status, self.requests.overrides());
        }
    }

    pub fn record_truth(&mut self) {
        for tap in &mut self.truth {
            let missed = tap.missed();
            let robot = tap.robot();
            let samples = tap.drain().into_iter().map(|live| TruthSample {
                robot,
                time: live.sample.brick_time,
                pose: live.sample.pose,
                odometry: Some(live.sample.odometry),
            });
            if let Some(recorder) = &mut self.recorder {
                recorder.record_truth(samples.collect());
            }
            if tap.missed() > missed {
                let samples = tap.missed() - missed;
                tracing::warn!(samples, "the truth has a hole in the recording: the station was too slow");
            }
        }
    }

    fn handle(&mut self, now: Timestamp<HostClock>, input: Input) {
        self.station.handle(now, &input);
        self.input_count += 1;
        if let Input::Bytes { link, peer, .. } = input
            && self.station.understands(link, peer)
            && let Some(port) = self.links.get_mut(link)
        {
            port.admit(peer);
        }
        // The reply first: to wake the threads that watch and record must not delay it.
        let mut events = Vec::with_capacity(USUAL_EVENTS);
        let mut sent = Vec::new();
        let mut requests = Vec::new();
        while let Some(output) = self.station.poll() {
            match output {
                Output::Transmit { link, to, priority, bytes } => {
                    if self.fleet.as_ref().is_some_and(|fleet| !fleet.may_send()) {
                        // It stood still in the middle of this; its robots may be another station's by now.
                        continue;
                    }
                    if let Some(port) = self.links.get_mut(link) {
                        let frame = &bytes;
                        port.send_outgoing(&OutgoingFrame { to, priority, frame });
                    }
                    if self.tlog.is_some() {
                        sent.push((link, priority, bytes));
                    }
                }
                Output::Event(event) => events.push(event),
                Output::Request(Request::ShareFix { tag, fix }) => {
                    if let Some(fleet) = &mut self.fleet {
                        fleet.share_fix(tag, &fix);
                    }
                }
                Output::Request(request) => requests.push(request),
            }
        }
        // One copy for all that watch and record: what a stall has held back comes at once, and waits for each of them.
        let events: Arc<[Event]> = events.into();
        if let Some(dashboard) = &self.dashboard {
            dashboard.publish_events(now, &events);
        }
        if let Some(fleet) = &mut self.fleet {
            fleet.observe(&self.station, now, &input, &events);
        }
        let is_command = matches!(input, Input::Command(_) | Input::RobotCommand { .. });
        let logged = self.log_traffic(now, &input, &sent);
        self.requests.on_input(&input);
        let recorded = self.record(now, input, &events);
        let bagged = self.record_bag(now, &events);
        if let Some(ros2) = &self.ros2 {
            ros2.publish(&self.station, now, &events);
        }
        let watched = self.observer.push(now, &events);
        self.setup.observe(now, &events);
        let placed = self.place_first_robot(&events);
        if let Some(keeper) = &mut self.signing {
            keeper.save_if_due(now, &self.station);
        }
        if let Some(placed) = placed {
            self.handle(now, placed);
        }
        if let Some(report) = recorded {
            self.handle(now, report);
        }
        for report in [logged, bagged].into_iter().flatten() {
            self.handle(now, report);
        }
        if let Err(error) = watched {
            tracing::error!(error = format!("{error:#}"), "the event file ends here");
            let report = warning(format!("no more events in the file: {error:#}"));
            self.failures.record::<()>(Err(error));
            self.handle(now, report);
        }
        // After the input that led to it: a recording that it ends holds it.
        for request in requests {
            let report = self.requests.execute(now, self.input_count, &request, &mut self.recorder);
            if let Some(report) = report {
                self.handle(now, report);
            }
        }
        if is_command {
            self.publish_status(now);
        }
        self.handle_fleet_inputs();
    }

    /// The command that sets the configured pose, with the first estimate of a robot.
    fn place_first_robot(&mut self, events: &[Event]) -> Option<Input> {
        let pose = self.first_pose?;
        let robot = events
            .iter()
            .find_map(|event| if let Event::EstimateUpdated { robot, .. } = event { Some(*robot) } else { None })?;
        self.first_pose = None;
        Some(Input::RobotCommand { robot, command: Command::set_pose_by_eye(pose) })
    }

    /// Passes an input and its outputs to the recorder. Removes a failed one and returns a report.
    fn record(&mut self, now: Timestamp<HostClock>, input: Input, events: &Arc<[Event]>) -> Option<Input> {
        let recorder = self.recorder.as_mut()?;
        if recorder.record(now, input).is_ok() {
            recorder.record_events(now, events);
            return None;
        }
        let ended = self.recorder.take().map(Recorder::finish);
        self.requests.drop_recording();
        let Some(Err(error)) = ended else {
            return None;
        };
        tracing::error!(error = format!("{error:#}"), "the recording ends here");
        let report = warning(format!("no longer recording: {error:#}"));
        self.failures.record::<()>(Err(error.context("the recording is not whole")));
        Some(report)
    }

    /// Passes received and sent bytes to the telemetry log. Removes a failed one and returns a report.
    fn log_traffic(
        &mut self,
        now: Timestamp<HostClock>,
        input: &Input,
        sent: &[(LinkId, Priority, Vec<u8>)],
    ) -> Option<Input> {
        let tlog = self.tlog.as_mut()?;
        let mut taken = tlog.received(now, input);
        for (link, priority, frame) in sent {
            taken = taken.and_then(|()| tlog.sent(now, *link, *priority, frame));
        }
        if taken.is_ok() { None } else { end_side_file(&mut self.tlog, &mut self.failures) }
    }

    /// Passes outputs to the ROS 2 bag. Removes a failed one and returns a report.
    fn record_bag(&mut self, now: Timestamp<HostClock>, events: &Arc<[Event]>) -> Option<Input> {
        let recorded = self.bag.as_mut()?.record(now, events);
        if recorded.is_ok() { None } else { end_side_file(&mut self.bag, &mut self.failures) }
    }
}

/// Removes a file that has failed, and returns a report.
fn end_side_file<F: SideFileFormat>(file: &mut Option<SideFile<F>>, failures: &mut DeferredErrors) -> Option<Input> {
    let Err(error) = file.take()?.finish() else {
        return None;
    };
    let kind = F::KIND;
    tracing::error!(error = format!("{error:#}"), "the {kind} ends here");
    let report = warning(format!("no more {kind}: {error:#}"));
    failures.record::<()>(Err(error.context(format!("the {kind} is not whole"))));
    Some(report)
}

/// The next event of the fleet; pending without one.
async fn next_fleet_event(fleet: &mut Option<Fleet>) -> FleetEvent {
    match fleet {
        Some(fleet) => fleet.next_event().await,
        None => std::future::pending().await,
    }
}

/// The next request of a node of ROS 2; pending without one.
async fn next_ros2_request(ros2: &mut Option<Ros2Publisher>) -> Input {
    match ros2 {
        Some(ros2) => ros2.next_request().await,
        None => std::future::pending().await,
    }
}

fn warning(text: String) -> Input {
    let severity = WARNING;
    Input::Report { severity, text }
}

/// Whether an input about a link's state is new: a link reports each new reason of one loss.
fn changes_state(link: LinkId, input: &Input, states: &mut BTreeMap<LinkId, LinkState>) -> bool {
    if let Input::Link { state, .. } = input {
        return states.insert(link, *state) != Some(*state);
    }
    true
}

/// The newest peer of each link: transports number peers in the order in which they come.
#[derive(Debug, Default)]
struct NewestPeers(BTreeMap<LinkId, PeerId>);

impl NewestPeers {
    /// The input that gives the address of a peer whose first bytes these are, if it has one.
    fn address_of_new(&mut self, links: &LinkSet, input: &Input) -> Option<Input> {
        if let Input::Link { link, .. } = input {
            // It numbers its peers anew.
            self.0.remove(link);
        }
        let Input::Bytes { link, peer, .. } = *input else {
            return None;
        };
        if self.0.get(&link).is_some_and(|newest| peer <= *newest) {
            return None;
        }
        self.0.insert(link, peer);
        let host = links.iter().find(|port| port.id() == link)?.peer_address(peer)?;
        Some(Input::PeerAddress { link, peer, host })
    }
}

/// A smaller change is the steady correction of a clock, not a step.
const STEP_THRESHOLD: TimeDelta = TimeDelta::from_millis(1_000);

#[derive(Clone, Copy, Debug, Default)]
pub struct ClockStepDetector {
    reported: TimeDelta,
}

impl ClockStepDetector {
    /// `ahead` is the date minus the session's clock; returns the step since the last report.
    pub fn detect(&mut self, ahead: TimeDelta) -> Option<TimeDelta> {
        let leapt = ahead - self.reported;
        if leapt < STEP_THRESHOLD && leapt > -STEP_THRESHOLD {
            return None;
        }
        self.reported = ahead;
        Some(leapt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_date_that_is_set_is_told_once_and_a_slow_correction_is_not() {
        let mut watch = ClockStepDetector::default();
        assert_eq!(watch.detect(TimeDelta::from_millis(400)), None);
        let hour = TimeDelta::from_millis(3_600_000);
        assert_eq!(watch.detect(hour), Some(hour));
        assert_eq!(watch.detect(hour + TimeDelta::from_millis(300)), None);
        let back = watch.detect(TimeDelta::ZERO);
        assert_eq!(back, Some(-hour));
        assert_eq!(watch.detect(TimeDelta::ZERO), None);
    }
}
