//! `paste` is no longer maintained. mcap lists it and uses it in its own tests only; zenoh's `token-cell` needs its macro, which the
//! feature `word-pasting` takes from its maintained continuation.

#[cfg(feature = "word-pasting")]
pub use pastey::paste;
