//! The stages for the frames of one input: verifier, router, decoder.
//!
//! All frames of an input are verified and routed before the station acts on the first of their messages. The router
//! decides ([`posebridge_protocol::routing`]); its decisions are collected here, because frames are forwarded only after
//! the station's own output.

use posebridge_protocol::dialect::{self, ids, is_signed};
use posebridge_protocol::frame_verifier::{FrameVerifier, VerifiedSender};
use posebridge_protocol::framing::{FrameRef, FramerOutput};
use posebridge_protocol::routing::{
    DuplicateStatus, Endpoint, FrameRouter, LinkSharing, MessageTarget, SenderCheck, SenderInfo, priority_of, retarget,
    target_of,
};
use posebridge_telemetry::{Address, HostClock, LinkId, ReceiveError, Recipients, Timestamp};

use crate::decoder::Decoder;
use crate::forwarded_frame::ForwardedFrame;
use crate::observers::{ObserverAddress, Observers};
use crate::receive::ReceivedMessage;
use crate::robot_table::RobotTable;
use crate::vehicle_proxy::{VEHICLE_COMPONENT, VehicleProxies};

#[derive(Debug, Default)]
pub(crate) struct ReceivedBatch {
    pub(crate) messages: Vec<ReceivedMessage>,
    pub(crate) errors: Vec<ReceiveError>,
    /// Descriptions of invalid payloads, with their senders.
    pub(crate) descriptions: Vec<(Address, String)>,
    pub(crate) rejected_frames: u64,
    pub(crate) report: ForwardingReport,
}

pub(crate) struct ReceivePass<'a> {
    pub(crate) now: Timestamp<HostClock>,
    pub(crate) from: Endpoint,
    pub(crate) sharing: LinkSharing,
    pub(crate) verifier: &'a mut FrameVerifier,
    pub(crate) router: &'a mut FrameRouter,
    pub(crate) decoder: &'a mut Decoder,
    /// The robots as vehicles on the link: the station may have to reply to a command in their place.
    pub(crate) vehicles: Option<&'a VehicleProxies>,
    pub(crate) robots: &'a RobotTable,
    pub(crate) observers: &'a Observers,
    pub(crate) batch: ReceivedBatch,
}

/// Counts and frames that are handled after the station's own output.
#[derive(Debug, Default)]
pub(crate) struct ForwardingReport {
    /// Frames that the inward filter rejected.
    pub(crate) filtered: u64,
    /// Duplicates from another endpoint.
    pub(crate) duplicates: u64,
    /// Frames with the station's own address that it did not send.
    pub(crate) address_conflicts: u64,
    /// Frames for a robot that is announced under another system, which are signed or damaged and cannot be
    /// readdressed.
    pub(crate) unchangeable: u64,
    pub(crate) forwarded: Vec<ForwardedFrame>,
}

impl ForwardingReport {
    pub(crate) const fn has_content(&self) -> bool {
        let dropped = self.filtered + self.duplicates + self.address_conflicts + self.unchangeable;
        dropped > 0 || !self.forwarded.is_empty()
    }
}

impl ReceivePass<'_> {
    pub(crate) fn push(&mut self, found: FramerOutput<'_>) {
        let verified = self.verifier.verify(self.now, self.from.peer, &found);
        match (found, verified) {
            (FramerOutput::Frame(frame) | FramerOutput::UnknownFrame(frame), Err(reason)) => {
                self.batch.rejected_frames += 1;
                self.batch.errors.push(ReceiveError::SignatureRejected { source: frame.source, reason });
            }
            (FramerOutput::Frame(frame), Ok(sender)) => self.handle_frame(&frame, sender),
            (FramerOutput::UnknownFrame(frame), Ok(sender)) => {
                self.route(&frame, sender.check);
            }
            (FramerOutput::Error(error), _) => self.batch.errors.push(error),
        }
    }

    fn handle_frame(&mut self, frame: &FrameRef<'_>, sender: VerifiedSender) {
        if sender.missing > 0 {
            let gap = ReceiveError::SequenceGap { source: frame.source, frames: sender.missing };
            self.batch.errors.push(gap);
        }
        match self.route(frame, sender.check) {
            Some(DuplicateStatus::AddressConflict) => {
                self.batch.errors.push(ReceiveError::AddressConflict { message_id: frame.message_id });
            }
            // The station's own frames are no input, least of all its own estimate.
            None | Some(DuplicateStatus::Echo) => {}
            Some(duplicate_status) => self.decode(frame, duplicate_status),
        }
    }

    fn decode(&mut self, frame: &FrameRef<'_>, duplicate_status: DuplicateStatus) {
        match self.decoder.decode(frame) {
            Ok(Some(message)) => {
                let is_signed = self.verifier.is_signed() && is_signed(frame.raw);
                self.batch.messages.push(ReceivedMessage {
                    source: frame.source,
                    duplicate_status,
                    is_signed,
                    message,
                });
            }
            Ok(None) => {}
            Err(error) => {
                self.batch.errors.push(ReceiveError::Payload { message_id: error.message_id });
                self.batch.descriptions.extend(error.description.map(|text| (frame.source, text)));
            }
        }
    }

    /// Routes a frame: returns whether it is a duplicate, or `None` if it must not be used.
    fn route(&mut self, frame: &FrameRef<'_>, check: SenderCheck) -> Option<DuplicateStatus> {
        if !self.router.admits(self.from.link, frame) {
            self.batch.report.filtered += 1;
            return None;
        }
        let sender = SenderInfo { check, sharing: self.sharing };
        let mut routed = self.router.route(self.now, self.from, frame, sender);
        if matches!(routed.duplicate_status, DuplicateStatus::Duplicate | DuplicateStatus::Loop)
            && self.is_of_another_sender(frame)
        {
            routed = self.router.route_as_new(self.now, self.from, frame, sender);
        }
        match routed.duplicate_status {
            DuplicateStatus::Duplicate | DuplicateStatus::Loop => self.batch.report.duplicates += 1,
            DuplicateStatus::AddressConflict => self.batch.report.address_conflicts += 1,
            DuplicateStatus::New | DuplicateStatus::Echo => {}
        }
        let mut bytes = None;
        if self.is_answered_here(frame) {
            routed.to.clear();
        } else if routed.duplicate_status == DuplicateStatus::New {
            bytes = self.follow_renaming(frame, &mut routed.to);
        }
        if !routed.to.is_empty() {
            self.batch.report.forwarded.push(ForwardedFrame {
                message_id: frame.message_id,
                source: frame.source,
                sequence: frame.sequence,
                is_signed: is_signed(frame.raw),
                from: self.from,
                version: frame.version,
                priority: priority_of(frame),
                to: routed.to,
                bytes: bytes.unwrap_or_else(|| frame.raw.to_vec()),
            });
        }
        Some(routed.duplicate_status)
    }

    /// Whether a duplicate from another endpoint was sent by another robot or camera with the same ids: weak ones have
    /// no clock, or start it at the same moment, and then send the same bytes.
    fn is_of_another_sender(&self, frame: &FrameRef<'_>) -> bool {
        let Some(first) = self.router.first_endpoint(self.now, self.from, frame) else {
            return false;
        };
        let robots = [first, self.from].map(|endpoint| self.robots.identities.at_endpoint(endpoint, frame.source));
        let observers = [first, self.from].map(|endpoint| {
            let home = self.router.first_of_group(endpoint.link);
            self.observers.at_endpoint(endpoint, ObserverAddress { home, address: frame.source })
        });
        are_different(robots) || are_different(observers)
    }

    /// Redirects a frame to the robot that ground stations see as its target system; returns the changed bytes, if any.
    fn follow_renaming(&mut self, frame: &FrameRef<'_>, to: &mut Vec<(LinkId, Recipients)>) -> Option<Vec<u8>> {
        if self.vehicles.is_none() || !self.robots.has_renamed() {
            return None;
        }
        let target = target_of(frame.message_id, frame.payload);
        let system = target.system()?;
        let Some(robot) = self.robots.renamed(system) else {
            to.retain(|(link, recipients)| match recipients {
                Recipients::Peer(peer) => {
                    !self.robots.is_announced_otherwise(Endpoint { link: *link, peer: *peer }, system)
                }
                Recipients::All | Recipients::AllExcept(_) => true,
            });
            return None;
        };
        let (endpoint, _) = robot.last_seen?;
        *to = self.router.destinations_at(self.from, frame, endpoint);
        let mut bytes = frame.raw.to_vec();
        let component = match target {
            // As a vehicle the robot has another component than in its own frames.
            MessageTarget::Component(address) if address.component != VEHICLE_COMPONENT => address.component,
            MessageTarget::Component(_) | MessageTarget::System(_) | MessageTarget::Broadcast => {
                robot.wire_address.component
            }
        };
        let wire_target = Address { system: robot.wire_address.system, component };
        if retarget(frame.message_id, &mut bytes, wire_target).is_err() {
            self.batch.report.unchangeable += u64::from(!to.is_empty());
            to.clear();
        }
        Some(bytes)
    }

    /// Whether a frame asks a robot for something that the station answers in its name.
    fn is_answered_here(&self, frame: &FrameRef<'_>) -> bool {
        let Some(vehicles) = self.vehicles.filter(|_| ids::is_request(frame.message_id)) else {
            return false;
        };
        let message = dialect::decode(frame).ok().flatten();
        message.is_some_and(|message| vehicles.is_answered_here(self.now, &message))
    }
}

fn are_different<T: PartialEq>([first, second]: [Option<T>; 2]) -> bool {
    first.is_some() && second.is_some() && first != second
}
