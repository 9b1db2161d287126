//! The program: it wires links, engine, recorder, simulated brick and reports together.
//!
//! No formula and no byte layout stands here: physics is in the crates, and what happens to data between a socket and a reply is
//! the station's business. The program opens files and links, owns the threads and prints for people.
//!
//! Its parts lie in layers, and each may use those before it: [`config`], [`station`], [`tools`], `lab`, [`cli`]. Nothing but `cli`
//! names `lab`, and the feature of that name takes it out of the program.

pub mod cli;
pub mod config;
pub mod console;
pub mod exit;
pub mod flags;
#[cfg(feature = "lab")]
pub mod lab;
pub mod station;
pub mod tools;
pub mod virtual_station;
