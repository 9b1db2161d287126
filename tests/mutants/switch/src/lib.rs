//! Tells instrumented code which mutant is active. The environment is read at the first call of [`on`].
//!
//! `POSEBRIDGE_MUTANT=7` activates mutant 7. `POSEBRIDGE_MUTANT_RECORD=FILE` activates none and appends the number of
//! each mutant that is reached to FILE, as four little-endian bytes, once per process.

use std::env;
use std::fs::File;
use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

/// `mutants.py` numbers its mutants from 1 and refuses more than this.
const CAPACITY: usize = 1 << 16;

enum Mode {
    Original,
    Mutant(u32),
    Record(File),
}

static MODE: OnceLock<Mode> = OnceLock::new();
static REACHED: [AtomicBool; CAPACITY] = [const { AtomicBool::new(false) }; CAPACITY];

impl Mode {
    fn from_environment() -> Self {
        if let Some(path) = env::var_os("POSEBRIDGE_MUTANT_RECORD") {
            return File::options().append(true).create(true).open(path).map_or(Self::Original, Self::Record);
        }
        let number = env::var("POSEBRIDGE_MUTANT").ok().and_then(|number| number.parse().ok());
        number.map_or(Self::Original, Self::Mutant)
    }
}

/// Is mutant `id` active?
#[inline]
pub fn on(id: u32) -> bool {
    match MODE.get_or_init(Mode::from_environment) {
        Mode::Original => false,
        Mode::Mutant(active) => *active == id,
        Mode::Record(file) => {
            record(file, id);
            false
        }
    }
}

#[cold]
#[inline(never)]
fn record(mut file: &File, id: u32) {
    if !REACHED[id as usize % CAPACITY].swap(true, Ordering::Relaxed) {
        // A program that closed the file on purpose must not fail because of it.
        file.write_all(&id.to_le_bytes()).ok();
    }
}
