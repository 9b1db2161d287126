//! The cameras of one link: names to addresses.

use posebridge_telemetry::{Address, ChannelName, SourceHealth};

use super::super::pulse::Pulse;

/// MAV_COMP_ID_CAMERA of minimal.xml; five more follow it.
const FIRST_COMPONENT: u8 = 100;
/// The system of a robot's own cameras.
const SYSTEM: u8 = 1;
/// As many cameras as MAVLink has component ids for.
pub(super) const MOST_CAMERAS: usize = 6;

/// One camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    pub(super) name: ChannelName,
    pub(super) takes_requests: bool,
    pub(super) pulse: Pulse,
    pub(super) lines: u64,
}

/// Those that were heard, in their order.
#[derive(Debug, Default)]
pub(super) struct Cameras(Vec<Camera>);

impl Cameras {
    /// The camera with this name, its address, and whether it is new; `None` if there are too many already.
    pub(super) fn named(&mut self, name: ChannelName) -> Option<(Address, &mut Camera, bool)> {
        let known = self.0.iter().position(|camera| camera.name == name);
        let index = match known {
            Some(index) => index,
            None if self.0.len() >= MOST_CAMERAS => return None,
            None => {
                self.0.push(Camera { name, takes_requests: false, pulse: Pulse::of_camera(), lines: 0 });
                self.0.len() - 1
            }
        };
        let camera = self.0.get_mut(index)?;
        Some((address(index), camera, known.is_none()))
    }

    /// The camera with this address.
    pub(super) fn at(&self, wanted: Address) -> Option<&Camera> {
        let index = usize::from(wanted.component.0.checked_sub(FIRST_COMPONENT)?);
        self.0.get(index).filter(|_| address(index) == wanted)
    }

    pub(super) fn sources(&self) -> Vec<SourceHealth> {
        let sources = self.0.iter().enumerate();
        let sources =
            sources.map(|(index, camera)| SourceHealth { source: address(index), frames: camera.lines, lost: 0 });
        sources.collect()
    }
}

const fn address(index: usize) -> Address {
    Address::new(SYSTEM, FIRST_COMPONENT + index as u8)
}
