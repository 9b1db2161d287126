//! Properties that hold for any input, one module for each untrusted input.
//!
//! A body takes bytes, gives them to one part of the program and panics when a property does not hold. The bodies are a
//! crate of their own so that two drivers share them: libFuzzer (`fuzz/`, which needs a nightly compiler) and the short
//! run of the test suite (`tests/fuzz_short.rs`, any compiler). Bodies are deterministic and read no clock, file or
//! network.

mod brick;
mod codecs;
mod config;
mod dashboard_command;
mod decode;
mod impairment;
mod nxt;
mod operands;
mod parameters;
mod recognise;
mod recording;
mod routing;
mod scanner;
mod session;
mod signing;
mod tlog;
mod url;

/// Every fuzz target. Adding one: a module with its `check`, a line here, and seeds in `fuzz/corpus/<name>/`.
pub const TARGETS: &[Target] = &[
    Target::new("scanner", scanner::check, 250_000),
    Target::new("decode", decode::check, 1_500_000),
    Target::new("session", session::check, 120_000),
    Target::new("parameters", parameters::check, 120_000),
    Target::new("url", url::check, 1_500_000),
    Target::new("config", config::check, 90_000),
    Target::new("recognise", recognise::check, 700_000),
    Target::new("recording", recording::check, 150_000),
    Target::new("signing", signing::check, 9_000),
    Target::new("impairment", impairment::check, 100_000),
    Target::new("routing", routing::check, 1_500),
    Target::new("nxt", nxt::check, 150_000),
    Target::new("ev3", codecs::check_ev3, 500_000),
    Target::new("brick", brick::check, 400_000),
    Target::new("tlog", tlog::check, 60_000),
    Target::new("line", codecs::check_line, 700_000),
    Target::new("camera_json", codecs::check_camera_json, 200_000),
    Target::new("dashboard_command", dashboard_command::check, 300_000),
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
