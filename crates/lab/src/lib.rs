//! The laboratory: experiments, calibration, identification and tuning, as pure functions over observations.
//!
//! The program reads recordings and simulates drives; these modules compute what follows from them and give back values, tables and
//! pages of [`posebridge_report`]. They read no file and no clock, and draw no random number but by a given seed: two calls with the same
//! data give the same bytes.

pub mod accuracy;
pub mod calibration;
pub mod clocks;
pub mod end_errors;
pub mod identification;
pub mod noise_identification;
pub mod recorded_drive;
pub mod square;
pub mod tuning;
pub mod wall;
