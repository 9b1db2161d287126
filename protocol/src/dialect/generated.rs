//! The types of our own dialect, generated from `definitions/posebridge.xml` by the build script.

include!(concat!(env!("OUT_DIR"), "/mod.rs"));
