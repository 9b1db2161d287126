//! Properties that hold for any input, one `check` for each untrusted input.
//!
//! A body takes bytes, gives them to one part of the program and panics when a property does not hold. The bodies are a
//! crate of their own so that two drivers share them: libFuzzer (`fuzz/`, which needs a nightly compiler) and the short
//! run of the test suite (`tests/fuzz_short.rs`, any compiler). Bodies are deterministic and read no clock, file or
//! network.

mod bag;
mod bricks;
mod dataset;
mod framing;
mod impairment;
mod message_log;
mod operands;
mod pictures;
mod recorded_pictures;
mod recording;
mod requests;
mod routing;
mod session;
mod signing;
mod table;
mod text;
mod tlog;

/// Every fuzz target. Adding one: a `check` in the module of its kind, a line here, and seeds in `fuzz/corpus/<name>/`.
pub const TARGETS: &[Target] = &[
    Target::new("scanner", framing::check_scanner, 250_000),
    Target::new("decode", framing::check_decode, 1_500_000),
    Target::new("fields", framing::check_fields, 60_000),
    Target::new("session", session::check_session, 120_000),
    Target::new("requests", requests::check, 400),
    Target::new("parameters", session::check_parameters, 120_000),
    Target::new("url", text::check_url, 1_500_000),
    Target::new("config", text::check_config, 90_000),
    Target::new("recognise", framing::check_recognise, 700_000),
    Target::new("recording", recording::check, 150_000),
    Target::new("signing", signing::check, 9_000),
    Target::new("impairment", impairment::check, 100_000),
    Target::new("routing", routing::check, 1_500),
    Target::new("nxt", bricks::check_nxt, 150_000),
    Target::new("ev3", bricks::check_ev3, 500_000),
    Target::new("brick", bricks::check_brick, 400_000),
    Target::new("tlog", tlog::check, 60_000),
    Target::new("bag", bag::check, 6_000),
    Target::new("message_log", message_log::check, 20_000),
    Target::new("table", table::check, 30_000),
    Target::new("pictures", pictures::check, 3_000),
    Target::new("avi", recorded_pictures::check_avi, 70_000),
    Target::new("y4m", recorded_pictures::check_y4m, 400_000),
    Target::new("png", recorded_pictures::check_png, 200_000),
    Target::new("picture_times", recorded_pictures::check_picture_times, 90_000),
    Target::new("line", bricks::check_line, 700_000),
    Target::new("camera_json", bricks::check_camera_json, 200_000),
    Target::new("dashboard_command", text::check_dashboard_command, 300_000),
];

/// One untrusted input and what must hold for it.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Its name on the command line, and its folder in `fuzz/corpus/`.
    pub name: &'static str,
    /// Returns if all promises were kept.
    ///
    /// # Panics
    /// When one was broken.
    pub check: fn(&[u8]),
    /// How many mutations the test suite tries: about two seconds' worth in a debug build.
    pub short_runs: u32,
}

impl Target {
    const fn new(name: &'static str, check: fn(&[u8]), short_runs: u32) -> Self {
        Self { name, check, short_runs }
    }
}

/// The target with this name.
pub fn target(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}
