//! Every fuzz target in one program: POSEBRIDGE_FUZZ_TARGET names the row of the table of bodies. `fuzz/run` sets it.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use posebridge_fuzz_bodies::{TARGETS, Target, target};

static CHOSEN: LazyLock<&'static Target> = LazyLock::new(|| {
    let name = std::env::var("POSEBRIDGE_FUZZ_TARGET").unwrap_or_default();
    target(&name).unwrap_or_else(|| {
        let names: Vec<_> = TARGETS.iter().map(|target| target.name).collect();
        eprintln!("POSEBRIDGE_FUZZ_TARGET is `{name}`; there are: {}", names.join(", "));
        std::process::exit(2)
    })
});

fuzz_target!(
    init: {
        LazyLock::force(&CHOSEN);
    },
    |data: &[u8]| (CHOSEN.check)(data)
);
