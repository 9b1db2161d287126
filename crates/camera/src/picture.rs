//! A picture on its way from a camera to the search for tags.

use posebridge_telemetry::{HostClock, Timestamp};

/// When a picture was taken, as far as its source knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PictureTime {
    /// The middle of the exposure lies between.
    Exposed { earliest: Timestamp<HostClock>, latest: Timestamp<HostClock> },
    /// Its first bytes came then, and it was exposed some time before.
    Received(Timestamp<HostClock>),
}

impl PictureTime {
    /// From when on the picture could have been known.
    pub(crate) const fn since(self) -> Timestamp<HostClock> {
        match self {
            Self::Exposed { latest, .. } => latest,
            Self::Received(at) => at,
        }
    }
}

/// A picture as it came.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct EncodedPicture {
    pub(crate) time: PictureTime,
    /// JPEG, PNG or PGM.
    pub(crate) bytes: Vec<u8>,
}
