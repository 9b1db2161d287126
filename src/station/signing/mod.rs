//! Keys and stamps in files: what signing needs of the world, for links that are to be signed.
//!
//! The station signs and verifies; here the keys are read, the stamps are kept from one session to the next, and a warning is
//! printed where any sender is accepted. A key leaves its file only into the station: recordings, events, logs and errors show
//! its name.

mod exposure;
mod keeper;
mod key_file;
mod session;
mod state_file;

pub use exposure::warn_of_open_listeners;
pub use keeper::SigningStateWriter;
pub use key_file::{create_key, read_key};
pub use session::{SigningSession, restore_states};
