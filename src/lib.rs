//! The program: opens files and links, owns the threads, prints messages, and connects links, engine, recorder, simulated brick and
//! reports. It contains no formulas and no byte formats. Its modules form layers, and each may use those before it: [`config`],
//! [`station`], [`tools`], `lab`, [`cli`]. Only `cli` uses `lab`, which the feature of that name can remove.

pub mod cli;
pub mod config;
pub mod console;
mod examples;
pub mod exit;
pub mod flags;
#[cfg(feature = "lab")]
pub mod lab;
mod runtime;
pub mod station;
pub mod stderr_writer;
mod text_file;
pub mod tools;
pub mod virtual_station;
