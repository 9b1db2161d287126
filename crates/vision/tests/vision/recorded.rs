//! Recorded pictures by OpenCV and ffmpeg, and what these decode from them.

use std::io::{Error, ErrorKind, Read};

use posebridge_vision::{AviCutOff, GreyPicture, VideoFrame};
use proptest::prelude::*;

/// Gives at most so many bytes at a time, and is interrupted in between.
pub(crate) struct Trickle<'a> {
    bytes: &'a [u8],
    most: usize,
    is_interrupted: bool,
}

impl Read for Trickle<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.is_interrupted = !self.is_interrupted;
        if self.is_interrupted {
            return Err(Error::from(ErrorKind::Interrupted));
        }
        let most = self.most.min(buffer.len());
        self.bytes.read(&mut buffer[..most])
    }
}

pub(crate) const fn trickle(bytes: &[u8], most: usize) -> Trickle<'_> {
    Trickle { bytes, most, is_interrupted: false }
}

/// What a reader gives: its frames with their pixels, its errors, and how an AVI file was cut off.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Reading {
    pub(crate) frames: Vec<(VideoFrame, Vec<u8>)>,
    pub(crate) errors: Vec<String>,
    pub(crate) cut_off: Option<AviCutOff>,
}

impl Reading {
    /// Returns false at the end.
    pub(crate) fn push<E: ToString>(&mut self, frame: Result<Option<VideoFrame>, E>, picture: &GreyPicture) -> bool {
        match frame {
            Ok(Some(frame)) => {
                let image = picture.image().unwrap();
                self.frames.push((frame, (0..image.height()).flat_map(|y| image.row(y)).copied().collect()));
                return true;
            }
            Ok(None) => {}
            Err(error) => self.errors.push(error.to_string()),
        }
        assert!(picture.image().is_none());
        false
    }

    pub(crate) fn times(&self) -> Vec<f64> {
        self.frames.iter().map(|(frame, _)| frame.time_s).collect()
    }
}

pub(crate) fn worst_difference(one: &[u8], other: &[u8]) -> u8 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(one, other)| one.abs_diff(*other)).max().unwrap_or_default()
}

/// Most bytes that a decoder may hold for pictures of the largest size, those of a progressive one included.
pub(crate) const MAX_PICTURE_MEMORY: u64 = 10 * 4_928 * 4_928;

/// A file with bytes that were changed, of which a part is kept.
#[derive(Clone, Debug)]
pub(crate) struct Damage {
    changes: Vec<(usize, u8)>,
    kept: usize,
}

impl Damage {
    pub(crate) fn any() -> impl Strategy<Value = Self> {
        (prop::collection::vec((0_usize..13_000, any::<u8>()), 0..6), 0_usize..13_000)
            .prop_map(|(changes, kept)| Self { changes, kept })
    }

    pub(crate) fn apply(&self, bytes: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        let length = bytes.len();
        for (at, value) in &self.changes {
            bytes[at % length] = *value;
        }
        bytes.truncate(self.kept % (2 * length));
        bytes
    }
}
