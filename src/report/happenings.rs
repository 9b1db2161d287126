//! What happened in a session, in words and in order: what a person would have noted down.
//!
//! What comes many times a second is not in it: damage is named once for each link and kind, and the tables of the links count it.

use std::collections::BTreeSet;

use posebridge_telemetry::{Defect, Estimate, Event, LinkState, PoseJump, Refusal, Span};

/// So many are kept; the rest is counted.
const MOST: usize = 400;

/// One thing that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Happening {
    /// When, in seconds since the first input.
    pub t_s: f64,
    /// What.
    pub what: String,
}

/// Notes them down.
#[derive(Debug, Default)]
pub struct Happenings {
    /// In their order.
    pub all: Vec<Happening>,
    /// How many more there were.
    pub more: u64,
    /// What is told once.
    told: BTreeSet<String>,
    resets: Option<u8>,
    is_dead_reckoning: Option<bool>,
}

impl Happenings {
    /// Takes an event.
    pub fn take(&mut self, t_s: f64, event: &Event) {
        match event {
            Event::RobotSeen { robot } => self.note(t_s, format!("robot {robot} heard")),
            Event::RobotLost { robot, silence } => {
                self.note(t_s, format!("robot {robot} lost: silent for {:.1} s", silence.as_secs_f64()))
            }
            Event::BrickRestarted { robot } => {
                self.note(t_s, format!("the brick of robot {robot} restarted"));
            }
            Event::Link { link, state } => {
                let state = match state {
                    LinkState::Up => "up",
                    LinkState::Down => "down",
                };
                self.note(t_s, format!("link {link} {state}"));
            }
            Event::Text { source, severity, text } => {
                self.note(t_s, format!("{source} says (severity {severity}): {text}"))
            }
            Event::BrickClockAligned { uncertainty, .. } => {
                self.note_once(t_s, &aligned("the brick's clock", *uncertainty), "brick clock");
            }
            Event::CameraClockAligned { camera, uncertainty, .. } => {
                let whose = format!("the clock of camera {camera}");
                self.note_once(t_s, &aligned(&whose, *uncertainty), &whose);
            }
            Event::Estimated { estimate, .. } => self.take_estimate(t_s, estimate),
            Event::Defect { link, defect } => {
                let what = format!("first on link {link}: {}", kind_of(defect));
                self.note_once(t_s, &what, &what);
            }
            Event::Observed { .. } | Event::Fused { .. } | Event::Temperature { .. } | Event::Health { .. } => {}
        }
    }

    fn take_estimate(&mut self, t_s: f64, estimate: &Estimate) {
        let before = self.resets.replace(estimate.reset_counter);
        if before.is_some_and(|before| before != estimate.reset_counter) {
            let how_far = estimate.last_jump.map(moved).unwrap_or_default();
            self.note(t_s, format!("the estimate was moved{how_far}"));
        }
        let before = self.is_dead_reckoning.replace(estimate.is_dead_reckoning);
        // Before the first fix everything is dead reckoning: nothing has happened.
        if before.is_some_and(|before| before != estimate.is_dead_reckoning) {
            let what = if estimate.is_dead_reckoning {
                "dead reckoning: no fix for longer than the limit"
            } else {
                "fixes: no dead reckoning any more"
            };
            self.note(t_s, what.to_owned());
        }
    }

    fn note_once(&mut self, t_s: f64, what: &str, key: &str) {
        if self.told.insert(key.to_owned()) {
            self.note(t_s, what.to_owned());
        }
    }

    fn note(&mut self, t_s: f64, what: String) {
        if self.all.len() < MOST {
            self.all.push(Happening { t_s, what });
        } else {
            self.more += 1;
        }
    }
}

fn aligned(whose: &str, uncertainty: Span) -> String {
    format!("{whose} aligned, ± {:.2} ms", uncertainty.as_millis_f64())
}

fn moved(jump: PoseJump) -> String {
    format!(" by {:.0} mm, {:.0} mm and {:.1} degrees", jump.dx_m * 1e3, jump.dy_m * 1e3, jump.turn.0.to_degrees())
}

const fn kind_of(defect: &Defect) -> &'static str {
    match defect {
        Defect::Checksum { .. } => "a frame with a wrong checksum",
        Defect::Garbage { .. } => "bytes outside every frame",
        Defect::ImpossibleHeader { .. } => "a header that its message cannot have",
        Defect::Stall { .. } => "a frame whose bytes stopped coming",
        Defect::Payload { .. } => "a payload that makes no sense",
        Defect::Lost { .. } => "frames missing",
        Defect::Refused { reason, .. } => match reason {
            Refusal::Unsigned => "a frame refused: not signed",
            Refusal::WrongSignature => "a frame refused: wrong signature",
            Refusal::Replayed => "a frame refused: its signature was used before",
            Refusal::Stale => "a frame refused: its signature is too old",
        },
        Defect::Namesake { .. } => "a frame under the station's own address",
        Defect::Unaligned { .. } => "a stamp that cannot be aligned",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, LinkId, RobotId};

    fn text(text: &str) -> Event {
        Event::Text { source: Address::new(1, 1), severity: 4, text: text.to_owned() }
    }

    #[test]
    fn damage_is_named_once_and_the_rest_in_order() {
        let mut happenings = Happenings::default();
        let damage = Event::Defect { link: LinkId(0), defect: Defect::Garbage { bytes: 3 } };
        happenings.take(1.0, &text("battery low"));
        happenings.take(2.0, &damage);
        happenings.take(3.0, &damage);
        happenings.take(4.0, &Event::BrickRestarted { robot: RobotId::default() });
        let said: Vec<&str> = happenings.all.iter().map(|one| one.what.as_str()).collect();
        assert_eq!(said.len(), 3);
        assert_eq!(said[0], "1/1 says (severity 4): battery low");
        assert_eq!(said[1], "first on link 0: bytes outside every frame");
        assert!(said[2].contains("restarted"));
    }

    #[test]
    fn a_robot_that_talks_without_end_is_counted() {
        let mut happenings = Happenings::default();
        for _ in 0..1_000 {
            happenings.take(0.0, &text("x"));
        }
        assert_eq!((happenings.all.len(), happenings.more), (MOST, 600));
    }
}
