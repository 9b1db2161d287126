//! The file of the default configuration.

/// The configuration that `posebridge` alone uses, and the documentation of every key.
pub const DEFAULT_TOML: &str = include_str!("../../config/default.toml");
