//! The crate from outside: recordings, their outputs for other programs, and foreign data sets.

#![expect(clippy::unwrap_used, reason = "helpers outside the test functions may fail loudly as well")]

mod container;
mod container_damage;
mod container_properties;
mod datasets;
mod dead_reckoning;
mod events;
mod foxglove;
mod golden_outputs;
mod protobuf;
mod published_figures;
mod ros2;
mod ros2_bags;

use std::cell::RefCell;
use std::io::{Result as IoResult, Write};
use std::rc::Rc;

/// A file in memory that can be read while it is written.
#[derive(Clone, Default)]
struct MemoryFile(Rc<RefCell<Vec<u8>>>);

impl MemoryFile {
    fn content(&self) -> Vec<u8> {
        self.0.borrow().clone()
    }
}

impl Write for MemoryFile {
    fn write(&mut self, bytes: &[u8]) -> IoResult<usize> {
        self.0.borrow_mut().write(bytes)
    }
    fn flush(&mut self) -> IoResult<()> {
        Ok(())
    }
}
