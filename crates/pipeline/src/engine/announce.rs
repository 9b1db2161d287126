//! Events in words, as STATUSTEXT on links for ground stations.
//!
//! A text is said as soon as its input is done with. Of one topic it is said at most every few seconds, and tells how many were left
//! out: a screen full of the same line hides the other one.
//!
//! # Sources
//! common.xml, STATUSTEXT: at most 50 bytes in a part; parts of one text share an id other than 0 and count from 0; a part with a zero
//! in it, or shorter than 50 bytes, is the last.

use std::collections::BTreeMap;

use posebridge_protocol::message::{Message, TextPart};
use posebridge_telemetry::{
    Estimate, Event, FusionRecord, HostClock, LinkId, LinkState, Priority, RobotId, SensorId, Span, Stamp, Verdict,
};

use super::{Pipeline, SEVERITY_WARNING};
use crate::link_state::Speaker;

/// MAV_SEVERITY_ERROR.
const SEVERITY_ERROR: u8 = 3;
/// MAV_SEVERITY_NOTICE.
const SEVERITY_NOTICE: u8 = 5;
/// MAV_SEVERITY_INFO.
const SEVERITY_INFO: u8 = 6;
/// Time between two texts of one topic. A person reads a line in less.
const QUIET: Span = Span::from_millis(5_000);
/// The same for words of the station or of the robot, of which no two need be alike.
const QUIET_WORDS: Span = Span::from_millis(500);
/// So many reports of the program are told in [`QUIET`]: each answers somebody who asked for it, and the line that it was asked comes just
/// before. Two hands on buttons ask for less.
const REPORTS: u32 = 8;
/// Bytes of a part.
const PART: usize = 50;
/// Most bytes of a text; the rest is cut off.
const LONGEST: usize = 4 * PART;

/// What a text is about. There are as many as there are links and sensors, and no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Topic {
    LinkUp(LinkId),
    LinkDown(LinkId),
    RobotSeen,
    RobotLost,
    Restart,
    Reset,
    Refused(SensorId),
    Words(Speaker),
    Report,
}

impl Topic {
    /// How many texts of it are said in how long a time.
    const fn most(self) -> (u32, Span) {
        match self {
            Self::Words(_) => (1, QUIET_WORDS),
            Self::Report => (REPORTS, QUIET),
            Self::LinkUp(_)
            | Self::LinkDown(_)
            | Self::RobotSeen
            | Self::RobotLost
            | Self::Restart
            | Self::Reset
            | Self::Refused(_) => (1, QUIET),
        }
    }
}

/// Since when a topic is counted, how often it was told since then, and how often it was not.
#[derive(Clone, Copy, Debug)]
struct Told {
    since: Stamp<HostClock>,
    said: u32,
    left_out: u32,
}

/// A text that waits to be said.
#[derive(Debug)]
struct Text {
    speaker: Speaker,
    severity: u8,
    words: String,
}

/// What is to be told, and what was.
#[derive(Debug, Default)]
pub(super) struct Announcer {
    told: BTreeMap<Topic, Told>,
    waiting: Vec<Text>,
    last_text_id: u16,
    reset_counter: Option<u8>,
    /// It was told that the robot is lost, and not yet that it is there again.
    is_robot_missed: bool,
}

impl Announcer {
    fn tell(&mut self, now: Stamp<HostClock>, topic: Topic, mut text: Text) {
        let (most, quiet) = topic.most();
        let fresh = Told { since: now, said: 0, left_out: 0 };
        let told = self.told.entry(topic).or_insert(fresh);
        if now - told.since >= quiet {
            if told.left_out > 0 {
                text.words = format!("{} ({} more)", text.words, told.left_out);
            }
            *told = fresh;
        }
        if told.said >= most {
            told.left_out += 1;
            return;
        }
        told.said += 1;
        self.waiting.push(text);
    }

    /// The messages of a text.
    pub(super) fn parts(&mut self, severity: u8, words: &str) -> Vec<Message> {
        let words = printable(words);
        let text_id = if words.len() <= PART {
            0
        } else {
            self.last_text_id = self.last_text_id.checked_add(1).unwrap_or(1);
            self.last_text_id
        };
        let mut parts: Vec<&str> = words.as_bytes().chunks(PART).filter_map(as_text).collect();
        // A part of full length says that another one follows.
        if text_id != 0 && words.len().is_multiple_of(PART) {
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

fn as_text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}

/// As much of the words as is told, in ASCII, so that they can be cut at any byte.
fn printable(words: &str) -> String {
    let shown = |letter: char| match letter {
        ' '..='~' => letter,
        _ => '?',
    };
    words.chars().map(shown).take(LONGEST).collect()
}

impl Pipeline {
    /// Keeps what people at ground stations should read of an event.
    pub(super) fn announce(&mut self, event: &Event) {
        let Some((topic, severity, words)) = self.words_for(event) else {
            return;
        };
        let speaker = if let Topic::Words(speaker) = topic { speaker } else { Speaker::Station };
        let text = Text { speaker, severity, words };
        self.announcer.tell(self.now, topic, text);
    }

    /// Keeps what became of something that the program was asked for.
    pub(super) fn announce_report(&mut self, severity: u8, words: &str) {
        if self.voices == 0 {
            return;
        }
        let text = Text { speaker: Speaker::Station, severity, words: words.to_owned() };
        self.announcer.tell(self.now, Topic::Report, text);
    }

    /// Says what waits, on every link for ground stations.
    pub(super) fn say_texts(&mut self) {
        for text in std::mem::take(&mut self.announcer.waiting) {
            let parts = self.announcer.parts(text.severity, &text.words);
            let links = self.links.iter();
            let hearing = links.filter(|(_, link)| link.voice.is_some() && link.state == LinkState::Up);
            let hearing: Vec<LinkId> = hearing.map(|(id, _)| *id).collect();
            for id in hearing {
                for part in &parts {
                    let priority = Priority::Conversation;
                    match text.speaker {
                        Speaker::Station => self.transmit(id, part, priority),
                        Speaker::Robot => self.transmit_conversation_of_robot(id, part, priority),
                    }
                }
            }
        }
    }

    fn words_for(&mut self, event: &Event) -> Option<(Topic, u8, String)> {
        match event {
            Event::Link { link, state } => self.words_for_link(*link, *state),
            Event::RobotSeen { robot } if self.is_the_robot(*robot) => {
                let words = format!("robot {} is heard again", robot.address);
                let is_back = std::mem::take(&mut self.announcer.is_robot_missed);
                is_back.then_some((Topic::RobotSeen, SEVERITY_INFO, words))
            }
            Event::RobotLost { robot, silence } if self.is_the_robot(*robot) && !self.robot_is_heard() => {
                self.announcer.is_robot_missed = true;
                let (address, silence_s) = (robot.address, silence.as_secs_f64());
                let words = format!("robot {address} is lost: silent for {silence_s:.1} s");
                Some((Topic::RobotLost, SEVERITY_ERROR, words))
            }
            Event::BrickRestarted { robot } => {
                Some((Topic::Restart, SEVERITY_WARNING, format!("robot {} has restarted", robot.address)))
            }
            Event::Fused { record, .. } => words_for_record(record),
            Event::Estimated { estimate, .. } => self.words_for_reset(estimate),
            Event::Text { source, severity, text } => {
                let speaker = if *source == self.config.own {
                    Speaker::Station
                } else {
                    // A robot that speaks MAVLink says it itself.
                    let robot = self.robot.filter(|robot| robot.address == *source)?;
                    self.links.get(&robot.link)?.codec.as_ref()?;
                    Speaker::Robot
                };
                Some((Topic::Words(speaker), *severity, text.clone()))
            }
            Event::RobotSeen { .. }
            | Event::RobotLost { .. }
            | Event::Observed { .. }
            | Event::Temperature { .. }
            | Event::BrickClockAligned { .. }
            | Event::CameraClockAligned { .. }
            | Event::Health { .. }
            | Event::Defect { .. } => None,
        }
    }

    /// Whoever reads it hears by the link of his own whether that is up.
    fn words_for_link(&self, id: LinkId, state: LinkState) -> Option<(Topic, u8, String)> {
        let link = self.links.get(&id)?;
        if link.voice.is_some() {
            return None;
        }
        Some(match state {
            LinkState::Up => (Topic::LinkUp(id), SEVERITY_INFO, format!("link {id} is up")),
            LinkState::Down => (Topic::LinkDown(id), SEVERITY_WARNING, format!("link {id} is down")),
        })
    }

    fn words_for_reset(&mut self, estimate: &Estimate) -> Option<(Topic, u8, String)> {
        let counter = estimate.reset_counter;
        let before = self.announcer.reset_counter.replace(counter);
        if before.is_none_or(|before| before == counter) {
            return None;
        }
        let words = match estimate.last_jump {
            Some(jump) => format!(
                "pose was reset: moved by {:.3} m, turned by {:.1} deg",
                jump.dx_m.hypot(jump.dy_m),
                jump.turn.0.to_degrees()
            ),
            None => "pose was reset".to_owned(),
        };
        Some((Topic::Reset, SEVERITY_NOTICE, words))
    }

    fn is_the_robot(&self, robot: RobotId) -> bool {
        self.robot
            .is_some_and(|known| known.address == robot.address && self.router.lead_to_one(known.link, robot.link))
    }
}

/// Fixes that are not used; of other observations nobody wants to read.
fn words_for_record(record: &FusionRecord) -> Option<(Topic, u8, String)> {
    if record.kind != "fix" {
        return None;
    }
    let name = record.sensor.name();
    let words = match record.verdict {
        Verdict::Gated => format!("fix of {name} refused: NIS {:.1}", record.nis),
        Verdict::TooOld => format!("fix of {name} refused: {:.2} s late", record.lag.as_secs_f64()),
        Verdict::Malformed => format!("fix of {name} refused: malformed"),
        Verdict::Accepted | Verdict::Slip | Verdict::Rebased | Verdict::ResetTo | Verdict::Unused => return None,
    };
    Some((Topic::Refused(record.sensor), SEVERITY_WARNING, words))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(words: &str) -> Text {
        Text { speaker: Speaker::Station, severity: SEVERITY_INFO, words: words.to_owned() }
    }

    fn said(announcer: &mut Announcer, words: &str) -> Vec<(String, u16, u8)> {
        let parts = announcer.parts(SEVERITY_INFO, words).into_iter();
        let said = parts.filter_map(|message| {
            if let Message::StatusText { text, part, .. } = message {
                Some((text, part.text_id, part.index))
            } else {
                None
            }
        });
        said.collect()
    }

    #[test]
    fn a_long_text_comes_in_parts_of_which_the_last_can_be_told() {
        let mut announcer = Announcer::default();
        let a = |count| "a".repeat(count);
        assert_eq!(said(&mut announcer, "brief"), [("brief".to_owned(), 0, 0)]);
        assert_eq!(said(&mut announcer, &a(50)), [(a(50), 0, 0)]);
        assert_eq!(said(&mut announcer, &a(51)), [(a(50), 1, 0), (a(1), 1, 1)]);
        assert_eq!(said(&mut announcer, &a(100)), [(a(50), 2, 0), (a(50), 2, 1), (String::new(), 2, 2)]);
        assert_eq!(said(&mut announcer, &a(1_000)).len(), 5);
        announcer.last_text_id = u16::MAX;
        assert_eq!(said(&mut announcer, &a(60))[0].1, 1, "0 means a single part");
        assert_eq!(said(&mut announcer, "5 \u{b0}C")[0].0, "5 ?C");
    }

    #[test]
    fn a_topic_is_told_now_and_then_with_what_was_left_out() {
        let mut announcer = Announcer::default();
        let at = |millis| Stamp::<HostClock>::from_millis(millis);
        let camera = Topic::Refused(SensorId::CAMERA);
        for millis in [0, 1_000, 4_999] {
            announcer.tell(at(millis), camera, text("refused"));
        }
        announcer.tell(at(4_999), Topic::Restart, text("restarted"));
        announcer.tell(at(5_000), camera, text("refused"));
        announcer.tell(at(10_000), camera, text("refused"));
        let words: Vec<_> = announcer.waiting.iter().map(|text| text.words.as_str()).collect();
        assert_eq!(words, ["refused", "restarted", "refused (2 more)", "refused"]);
    }
}
