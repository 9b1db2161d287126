//! The receiving half: estimates and questions for the time, out of whatever a link delivers.
//!
//! # Model
//! ```text
//! window   the oldest byte is a start byte, or the window is empty
//! refute   header: length 1 to 56, no flag but the signature's, a known id     whole: checksum, finite numbers
//! refuted  the oldest byte is dropped, not the whole candidate: a real frame may begin inside it
//! ```
//! A lost byte therefore costs the frame that it was in and no other. Messages that are not for a brick are refuted by
//! their id. Signatures are not verified: they are skipped as noise between frames.

use crate::frame::{CHECKSUM, HEADER, Kind, PLANAR_POSE, START, TIMESYNC, checksum};
use crate::messages::{PlanarPose, TimeRequest};

/// The longest frame that is understood.
const WINDOW: usize = HEADER + PLANAR_POSE.length as usize + CHECKSUM;
/// Incompatible flags that do not stand in the way: 1 says that a signature follows the frame.
const HARMLESS_FLAGS: u8 = 1;

/// What came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Received {
    /// The station's estimate.
    Pose(PlanarPose),
    /// A question for the time: [`Link::answer_time`](crate::Link::answer_time).
    TimeRequest(TimeRequest),
}

/// A window on the bytes of a link, 68 bytes long.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    bytes: [u8; WINDOW],
    count: usize,
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

impl Receiver {
    /// A receiver that has heard nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self { bytes: [0; WINDOW], count: 0 }
    }

    /// Takes the next byte. Poll until `None` after each; a window that nobody polls forgets its oldest byte.
    pub fn push(&mut self, byte: u8) {
        if self.count == WINDOW {
            self.drop_front(1);
        }
        if let Some(place) = self.bytes.get_mut(self.count) {
            *place = byte;
            self.count += 1;
        }
    }

    /// What has come in whole; `None` means that more bytes are needed.
    pub fn poll(&mut self) -> Option<Received> {
        while self.count > 0 {
            match match_window(self.bytes.get(..self.count).unwrap_or_default()) {
                WindowMatch::Open => return None,
                WindowMatch::NoFrame => self.drop_front(1),
                WindowMatch::Frame { length, received } => {
                    self.drop_front(length);
                    return Some(received);
                }
            }
        }
        None
    }

    fn drop_front(&mut self, count: usize) {
        let count = count.min(self.count);
        self.bytes.copy_within(count..self.count, 0);
        self.count -= count;
    }
}

/// What the window's oldest byte begins.
enum WindowMatch {
    /// Perhaps a frame: more bytes are needed.
    Open,
    /// Nothing that is for us.
    NoFrame,
    /// A frame of this length.
    Frame { length: usize, received: Received },
}

fn match_window(window: &[u8]) -> WindowMatch {
    let is_plausible = |place: usize, check: fn(u8) -> bool| match window.get(place) {
        Some(byte) => check(*byte),
        None => true,
    };
    let starts = is_plausible(0, |start| start == START)
        && is_plausible(1, |length| (1..=PLANAR_POSE.length).contains(&length))
        && is_plausible(2, |flags| flags & !HARMLESS_FLAGS == 0);
    if !starts {
        return WindowMatch::NoFrame;
    }
    let Some((header, rest)) = window.split_first_chunk::<HEADER>() else {
        return WindowMatch::Open;
    };
    let [_, length, _, _, _, system, component, id0, id1, id2] = *header;
    let Some(kind) = kind_of(u32::from_le_bytes([id0, id1, id2, 0])) else {
        return WindowMatch::NoFrame;
    };
    if length > kind.length {
        return WindowMatch::NoFrame;
    }
    let length = usize::from(length);
    let (Some(payload), Some(&[low, high])) = (rest.get(..length), rest.get(length..length + 2)) else {
        return WindowMatch::Open;
    };
    let summed = window.get(1..HEADER + length).unwrap_or_default();
    if checksum(summed, kind.crc_extra) != u16::from_le_bytes([low, high]) {
        return WindowMatch::NoFrame;
    }
    let read = if kind == PLANAR_POSE { pose(payload) } else { time_request(payload, [system, component]) };
    match read {
        Some(received) => WindowMatch::Frame { length: HEADER + length + CHECKSUM, received },
        None => WindowMatch::NoFrame,
    }
}

fn kind_of(id: u32) -> Option<Kind> {
    [PLANAR_POSE, TIMESYNC].into_iter().find(|kind| kind.id == id)
}

/// Reads fields one after the other; behind the end of the payload stand the zeros that were not sent.
struct Fields<'a>(core::slice::Iter<'a, u8>);

impl Fields<'_> {
    fn next_bytes<const N: usize>(&mut self) -> [u8; N] {
        core::array::from_fn(|_| self.0.next().copied().unwrap_or(0))
    }

    fn float(&mut self) -> f32 {
        f32::from_le_bytes(self.next_bytes())
    }
}

/// The estimate, unless a number in it is none.
fn pose(payload: &[u8]) -> Option<Received> {
    let mut fields = Fields(payload.iter());
    let time_us = u32::from_le_bytes(fields.next_bytes());
    let floats: [f32; 11] = core::array::from_fn(|_| fields.float());
    if !floats.iter().all(|number| number.is_finite()) {
        return None;
    }
    let [x_m, y_m, heading_rad, forward_speed_m_per_s, turn_rate_rad_per_s, covariance @ ..] = floats;
    let fix_age_ms = u16::from_le_bytes(fields.next_bytes());
    let [reset_counter, flags] = fields.next_bytes();
    let epoch = u32::from_le_bytes(fields.next_bytes());
    Some(Received::Pose(PlanarPose {
        time_us,
        x_m,
        y_m,
        heading_rad,
        forward_speed_m_per_s,
        turn_rate_rad_per_s,
        covariance,
        fix_age_ms,
        reset_counter,
        flags,
        epoch,
    }))
}

/// The question, unless it is somebody's answer.
fn time_request(payload: &[u8], from: [u8; 2]) -> Option<Received> {
    let mut fields = Fields(payload.iter());
    let tc1: [u8; 8] = fields.next_bytes();
    let request = TimeRequest { ts1: fields.next_bytes(), target: fields.next_bytes(), from };
    (tc1 == [0; 8]).then_some(Received::TimeRequest(request))
}
