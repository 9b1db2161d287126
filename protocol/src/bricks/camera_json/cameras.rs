//! The cameras of one link, with their addresses by name.

use posebridge_telemetry::{Address, ChannelName, SourceHealth};

use super::super::heartbeat::HeartbeatSource;

/// MAV_COMP_ID_CAMERA of minimal.xml; five more follow it.
const FIRST_COMPONENT: u8 = 100;
/// The system of a robot's own cameras.
const SYSTEM: u8 = 1;
/// As many cameras as MAVLink has component ids for.
pub(super) const MAX_CAMERAS: usize = 6;

/// One camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    pub(super) name: ChannelName,
    pub(super) takes_requests: bool,
    pub(super) heartbeat: HeartbeatSource,
    pub(super) lines: u64,
}

/// Those that were heard, in their order.
#[derive(Debug, Default)]
pub(super) struct CameraTable(Vec<Camera>);

impl CameraTable {
    /// The camera with this name, its address, and whether it is new; `None` if there are too many already.
    pub(super) fn get_or_insert(&mut self, name: ChannelName) -> Option<(Address, &mut Camera, bool)> {
        let known = self.0.iter().position(|camera| camera.name == name);
        let index = match known {
            Some(index) => index,
            None if self.0.len() >= MAX_CAMERAS => return None,
            None => {
                self.0.push(Camera { name, takes_requests: false, heartbeat: HeartbeatSource::for_camera(), lines: 0 });
                self.0.len() - 1
            }
        };
        let camera = self.0.get_mut(index)?;
        Some((address(index), camera, known.is_none()))
    }

    /// The camera with this address.
    pub(super) fn get(&self, wanted: Address) -> Option<&Camera> {
        let index = usize::from(wanted.component.0.checked_sub(FIRST_COMPONENT)?);
        self.0.get(index).filter(|_| address(index) == wanted)
    }

    pub(super) fn source_health(&self) -> Vec<SourceHealth> {
        let sources = self.0.iter().enumerate();
        let sources =
            sources.map(|(index, camera)| SourceHealth { source: address(index), frames: camera.lines, lost: 0 });
        sources.collect()
    }
}

const fn address(index: usize) -> Address {
    Address::new(SYSTEM, FIRST_COMPONENT + index as u8)
}
