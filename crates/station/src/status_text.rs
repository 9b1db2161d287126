//! Events in words, as STATUSTEXT on links for ground stations.
//!
//! A text is sent after its input was handled. A topic is reported at most every few seconds, with the number of
//! suppressed texts: otherwise a repeated line would hide the others.
//!
//! # Sources
//! common.xml, STATUSTEXT: at most 50 bytes in a part; parts of one text share an id other than 0 and count from 0; a part with a zero
//! in it, or shorter than 50 bytes, is the last.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::message::{Message, TextPart};
use posebridge_protocol::routing::FrameRouter;
use posebridge_telemetry::{
    Address, Event, FusionOutcome, FusionRecord, HostClock, LinkId, LinkState, RobotId, SensorId, TimeDelta, Timestamp,
    severity,
};

use crate::link_context::LinkContext;
use crate::robot_table::RobotTable;
use crate::sender_identity::RobotIndex;
use crate::sessions::{SenderRole, Sessions};

/// Time between two texts of one topic, enough to read a line.
const TOPIC_INTERVAL: TimeDelta = TimeDelta::from_millis(5_000);
/// The same for texts of the station or of the robot, which may all differ.
const TEXT_INTERVAL: TimeDelta = TimeDelta::from_millis(500);
/// Most reports of the program in [`TOPIC_INTERVAL`]: each is the result of a request, and follows the line about that
/// request. Two hands on buttons send fewer.
const MAX_REPORTS: u32 = 8;
const PART_BYTES: usize = 50;
/// Most bytes of a text; the rest is cut off.
const MAX_TEXT_BYTES: usize = 4 * PART_BYTES;

/// The subject of a text. Their number is bounded by the number of links and sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Topic {
    LinkUp(LinkId),
    LinkDown(LinkId),
    RobotDetected(RobotIndex),
    RobotLost(RobotIndex),
    RobotNamed(RobotIndex),
    Restart(RobotIndex),
    FixRejected(RobotIndex, SensorId),
    SenderText(SenderRole),
    Report,
}

impl Topic {
    /// Number of texts and the time within which they may be sent.
    const fn rate_limit(self) -> (u32, TimeDelta) {
        match self {
            Self::SenderText(_) => (1, TEXT_INTERVAL),
            Self::Report => (MAX_REPORTS, TOPIC_INTERVAL),
            Self::LinkUp(_)
            | Self::LinkDown(_)
            | Self::RobotDetected(_)
            | Self::RobotLost(_)
            | Self::RobotNamed(_)
            | Self::Restart(_)
            | Self::FixRejected(_, _) => (1, TOPIC_INTERVAL),
        }
    }
}

/// The start of a topic's period, and the numbers of its sent and suppressed texts.
#[derive(Clone, Copy, Debug)]
struct TopicRateLimit {
    since: Timestamp<HostClock>,
    sent: u32,
    suppressed: u32,
}

#[derive(Debug)]
pub(crate) struct PendingText {
    pub(crate) sender: SenderRole,
    pub(crate) severity: u8,
    pub(crate) text: String,
}

#[derive(Debug, Default)]
pub(crate) struct StatusTextQueue {
    rate_limits: BTreeMap<Topic, TopicRateLimit>,
    pending: Vec<PendingText>,
    last_text_id: u16,
    /// Robots with a reported loss and an unreported return.
    lost_robots: BTreeSet<RobotIndex>,
}

impl StatusTextQueue {
    fn push(&mut self, now: Timestamp<HostClock>, topic: Topic, mut text: PendingText) {
        let (most, quiet) = topic.rate_limit();
        let fresh = TopicRateLimit { since: now, sent: 0, suppressed: 0 };
        let limit = self.rate_limits.entry(topic).or_insert(fresh);
        if now - limit.since >= quiet {
            if limit.suppressed > 0 {
                text.text = format!("{} ({} more)", text.text, limit.suppressed);
            }
            *limit = fresh;
        }
        if limit.sent >= most {
            limit.suppressed += 1;
            return;
        }
        limit.sent += 1;
        self.pending.push(text);
    }

    pub(crate) fn split_text(&mut self, severity: u8, text: &str) -> Vec<Message> {
        let text = ascii(text);
        let text_id = if text.len() <= PART_BYTES {
            0
        } else {
            self.last_text_id = self.last_text_id.checked_add(1).unwrap_or(1);
            self.last_text_id
        };
        let mut parts: Vec<&str> = text.as_bytes().chunks(PART_BYTES).filter_map(utf8_prefix).collect();
        // A part of full length means that another one follows.
        if text_id != 0 && text.len().is_multiple_of(PART_BYTES) {
            parts.push("");
        }
        let numbered = (0_u8..).zip(parts);
        numbered
            .map(|(index, part)| Message::StatusText {
                severity,
                text: part.to_owned(),
                part: TextPart { text_id, index },
            })
            .collect()
    }
}

fn utf8_prefix(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}

/// The text that is sent, in ASCII, so that it can be cut at any byte.
fn ascii(text: &str) -> String {
    let shown = |letter: char| match letter {
        ' '..='~' => letter,
        _ => '?',
    };
    text.chars().map(shown).take(MAX_TEXT_BYTES).collect()
}

pub(crate) struct TextContext<'a> {
    pub(crate) own_address: Address,
    pub(crate) now: Timestamp<HostClock>,
    pub(crate) robots: &'a RobotTable,
    pub(crate) links: &'a BTreeMap<LinkId, LinkContext>,
    pub(crate) sessions: &'a Sessions,
    pub(crate) router: &'a FrameRouter,
}

impl TextContext<'_> {
    /// The robot of a session's peer, by the link on which it was received.
    fn robot(&self, peer: RobotId) -> Option<RobotIndex> {
        self.robots.find(RobotId { link: self.router.first_of_group(peer.link), ..peer })
    }
}

impl StatusTextQueue {
    pub(crate) fn push_event(&mut self, context: &TextContext<'_>, event: &Event) {
        let Some((topic, severity, text)) = self.text_for_event(context, event) else {
            return;
        };
        let sender = if let Topic::SenderText(sender) = topic { sender } else { SenderRole::Station };
        self.push(context.now, topic, PendingText { sender, severity, text });
    }

    /// Queues the result of a request to the program.
    pub(crate) fn push_report(&mut self, now: Timestamp<HostClock>, severity: u8, text: &str) {
        let text = PendingText { sender: SenderRole::Station, severity, text: text.to_owned() };
        self.push(now, Topic::Report, text);
    }

    pub(crate) fn take_pending(&mut self) -> Vec<PendingText> {
        std::mem::take(&mut self.pending)
    }

    fn text_for_event(&mut self, context: &TextContext<'_>, event: &Event) -> Option<(Topic, u8, String)> {
        let with_topic = |topic| event.describe().map(|(severity, text)| (topic, severity, text));
        match event {
            Event::Link { link, state } => with_topic(topic_of_link(context, *link, *state)?),
            Event::RobotDetected { robot } => {
                let index = context.robot(*robot)?;
                if !self.lost_robots.remove(&index) {
                    return None;
                }
                with_topic(Topic::RobotDetected(index))
                    .map(|(topic, severity, text)| (topic, severity, text + " again"))
            }
            Event::RobotNamed { robot, .. } => with_topic(Topic::RobotNamed(context.robots.find(*robot)?)),
            Event::RobotLost { robot, .. } => {
                let index = context.robot(*robot)?;
                if context.robots.get(index).is_alive(context.now) {
                    return None;
                }
                self.lost_robots.insert(index);
                // Ground stations announce errors aloud.
                with_topic(Topic::RobotLost(index)).map(|(topic, _, text)| (topic, severity::ERROR, text))
            }
            Event::BrickRestarted { robot } => with_topic(Topic::Restart(context.robots.find(*robot)?)),
            Event::ObservationFused { record, robot } => {
                let index = context.robots.find(*robot).unwrap_or_default();
                let (topic, severity, text) = text_for_record(index, record)?;
                Some((topic, severity, context.robots.labelled(index, &text)))
            }
            Event::Text { source, severity, text } => {
                let sender = if *source == context.own_address {
                    SenderRole::Station
                } else {
                    // A robot with MAVLink sends it itself.
                    let mut robots = context.robots.all().iter().filter(|robot| robot.id.address == *source);
                    let has_codec = |id: RobotId| context.links.get(&id.link).is_some_and(|link| link.codec.is_some());
                    SenderRole::Vehicle(robots.find(|robot| has_codec(robot.id))?.id)
                };
                Some((Topic::SenderText(sender), *severity, text.clone()))
            }
            Event::ObservationAligned { .. }
            | Event::EstimateUpdated { .. }
            | Event::ObservationCompared { .. }
            | Event::EstimateCompared { .. }
            | Event::QuantityUpdated { .. }
            | Event::Temperature { .. }
            | Event::BrickClockAligned { .. }
            | Event::CameraClockAligned { .. }
            | Event::Health { .. }
            | Event::ReceiveError { .. } => None,
        }
    }
}

/// A ground station detects the state of its own link itself.
fn topic_of_link(context: &TextContext<'_>, id: LinkId, state: LinkState) -> Option<Topic> {
    if !context.links.contains_key(&id) || context.sessions.vehicles(id).is_some() {
        return None;
    }
    Some(match state {
        LinkState::Up => Topic::LinkUp(id),
        LinkState::Down => Topic::LinkDown(id),
    })
}

/// Only fixes that are not used; other observations need no text.
fn text_for_record(robot: RobotIndex, record: &FusionRecord) -> Option<(Topic, u8, String)> {
    if record.kind != "fix" {
        return None;
    }
    let name = record.sensor.name();
    let text = match record.outcome {
        FusionOutcome::Gated => format!("fix of {name} refused: NIS {:.1}", record.nis),
        FusionOutcome::TooOld => format!("fix of {name} refused: {:.2} s late", record.lag.as_secs_f64()),
        FusionOutcome::Malformed => format!("fix of {name} refused: malformed"),
        FusionOutcome::Accepted
        | FusionOutcome::Slip
        | FusionOutcome::Rebased
        | FusionOutcome::PoseReset
        | FusionOutcome::Unused => return None,
    };
    Some((Topic::FixRejected(robot, record.sensor), severity::WARNING, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> PendingText {
        PendingText { sender: SenderRole::Station, severity: severity::INFO, text: text.to_owned() }
    }

    fn parts_of(announcer: &mut StatusTextQueue, text: &str) -> Vec<(String, u16, u8)> {
        let parts = announcer.split_text(severity::INFO, text).into_iter();
        let parts = parts.filter_map(|message| {
            if let Message::StatusText { text, part, .. } = message {
                Some((text, part.text_id, part.index))
            } else {
                None
            }
        });
        parts.collect()
    }

    #[test]
    fn a_long_text_is_split_so_that_its_last_part_is_recognizable() {
        let mut announcer = StatusTextQueue::default();
        let a = |count| "a".repeat(count);
        assert_eq!(parts_of(&mut announcer, "brief"), [("brief".to_owned(), 0, 0)]);
        assert_eq!(parts_of(&mut announcer, &a(50)), [(a(50), 0, 0)]);
        assert_eq!(parts_of(&mut announcer, &a(51)), [(a(50), 1, 0), (a(1), 1, 1)]);
        assert_eq!(parts_of(&mut announcer, &a(100)), [(a(50), 2, 0), (a(50), 2, 1), (String::new(), 2, 2)]);
        assert_eq!(parts_of(&mut announcer, &a(1_000)).len(), 5);
        announcer.last_text_id = u16::MAX;
        assert_eq!(parts_of(&mut announcer, &a(60))[0].1, 1, "0 means a single part");
        assert_eq!(parts_of(&mut announcer, "5 \u{b0}C")[0].0, "5 ?C");
    }

    #[test]
    fn a_topic_is_rate_limited_and_reports_its_suppressed_count() {
        let mut announcer = StatusTextQueue::default();
        let at = |millis| Timestamp::<HostClock>::from_millis(millis);
        let camera = Topic::FixRejected(0, SensorId::CAMERA);
        for millis in [0, 1_000, 4_999] {
            announcer.push(at(millis), camera, text("refused"));
        }
        announcer.push(at(4_999), Topic::Restart(0), text("restarted"));
        announcer.push(at(5_000), camera, text("refused"));
        announcer.push(at(10_000), camera, text("refused"));
        let texts: Vec<_> = announcer.pending.iter().map(|text| text.text.as_str()).collect();
        assert_eq!(texts, ["refused", "restarted", "refused (2 more)", "refused"]);
    }
}
