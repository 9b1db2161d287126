//! What a weak robot says to posebridge and hears from it, for a microcontroller: no heap, no dependency, no clock.
//!
//! It is one of four that make the same bytes; the others are C (`brick/c`), MicroPython and NXC. `brick/vectors` holds
//! those bytes, made by a foreign implementation. The simulated brick speaks through this crate.
//!
//! # Model
//! ```text
//! MAVLink 2 frame   FD length flags 0 sequence system component id[3] payload[length] crc[2]     little-endian
//! payload           the fields, largest first; zeros at its end are not sent, one byte always is
//! crc               CRC-16/MCRF4XX over everything behind FD and then the message's CRC_EXTRA
//! ```
//! Counts and turns are totals, never increments: a lost frame then costs nothing. A time is the robot's own counter of
//! microseconds, taken when the sensor was read and not when the frame is sent; it wraps after 71.6 minutes.
//!
//! # Sources
//! MAVLink guide, "Packet Serialization"; `protocol/definitions/posebridge.xml`; MAVLink's minimal.xml (HEARTBEAT) and
//! common.xml (TIMESYNC).
//!
//! # Examples
//! ```
//! use posebridge_brick::{Link, Received, Receiver, Sides, WheelTicks};
//!
//! let mut wire = Vec::new();
//! let mut serial = |bytes: &[u8]| wire.extend_from_slice(bytes);
//! let mut link = Link::new(1, 1);
//! let ticks = WheelTicks { time_us: 20_000, left: 12, right: 13, valid: Sides::BOTH };
//! link.wheel_ticks(&ticks, &mut serial);
//!
//! let mut receiver = Receiver::new();
//! for byte in [0xFD, 0x09] {
//!     receiver.push(byte);
//!     while let Some(received) = receiver.poll() {
//!         match received {
//!             Received::Pose(pose) => assert!(pose.position_is_valid()),
//!             Received::TimeRequest(request) => link.answer_time(&request, 20_000, &mut serial),
//!         }
//!     }
//! }
//! assert_eq!(wire.len(), 12 + 13);
//! ```
#![no_std]
#![forbid(unsafe_code)]

mod frame;
mod gyro;
mod link;
mod messages;
mod receiver;

pub use gyro::Gyro;
pub use link::{Link, Sink};
pub use messages::{Battery, Inertial, InertialParts, PlanarPose, RobotDescription, Sides, TimeRequest, WheelTicks};
pub use receiver::{Received, Receiver};

/// The program on the page for newcomers compiles.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/protocols/boards.md")]
struct Page;
