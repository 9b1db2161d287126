//! The IO maps: the memory of the firmware's modules, which a station may read and in part write.
//!
//! ```text
//! Output   00020001   3 x 32 bytes        Input   00030001   4 x 20 bytes
//! LowSpeed 000B0001   4 x 19 bytes, ..    Command 00010001   name, tick at 20, state of the program at 28
//! ```
//! # Sources
//! LEGO's NXT firmware, the structs of the modules' IO maps.

use super::super::firmware_pass::FirmwarePass;
use super::Nxt;

/// Module numbers.
pub(super) const COMMAND: u32 = 0x0001_0001;
pub(super) const OUTPUT: u32 = 0x0002_0001;
pub(super) const INPUT: u32 = 0x0003_0001;
pub(super) const LOW_SPEED: u32 = 0x000B_0001;
/// Bytes of the Command module before the memory pool of the programs, which must not be read.
const COMMAND_BYTES: usize = 52;
/// Places in the Command module.
const TICK_AT: usize = 20;
const PROGRAM_STATE_AT: usize = 28;
const FILE_NAME_AT: usize = 32;
/// The beginning of the Command module, by which old programs knew the virtual machine.
const FORMAT: &[u8] = b"MindstormsNXT";
/// A program runs.
const RUNNING: u8 = 2;

/// The length of a module in bytes, if there is such a module.
pub(super) const fn length(id: u32) -> Option<usize> {
    match id {
        COMMAND => Some(COMMAND_BYTES),
        OUTPUT => Some(97),
        INPUT => Some(80),
        LOW_SPEED => Some(166),
        _ => None,
    }
}

impl Nxt {
    /// The memory of a module, if there is such a module.
    pub(super) fn map(&self, id: u32, moment: &FirmwarePass<'_>) -> Option<Vec<u8>> {
        match id {
            COMMAND => Some(self.command_map(moment)),
            OUTPUT => Some(self.outputs.map()),
            INPUT => Some(self.inputs.map()),
            LOW_SPEED => Some(self.low_speed.map()),
            _ => None,
        }
    }

    fn command_map(&self, moment: &FirmwarePass<'_>) -> Vec<u8> {
        let mut map = vec![0; COMMAND_BYTES];
        let mut put = |place: usize, bytes: &[u8]| {
            for (byte, value) in map.iter_mut().skip(place).zip(bytes) {
                *byte = *value;
            }
        };
        put(0, FORMAT);
        put(TICK_AT, &moment.tick_ms().to_le_bytes());
        if let Some(name) = &self.program {
            put(PROGRAM_STATE_AT, &[RUNNING]);
            put(FILE_NAME_AT, name);
        }
        map
    }
}
