//! The simulator from outside: whole drives, bricks over bytes, the camera, impaired links, Monte-Carlo drives.
#![expect(clippy::unwrap_used, reason = "test code stops at the first surprise")]

mod bricks;
mod by_hand;
mod camera;
mod drives;
mod impairment_properties;
mod impairment_statistics;
mod lego_bricks;
mod montecarlo;
mod refused_files;
mod rendered_camera;
mod support;
