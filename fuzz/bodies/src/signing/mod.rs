//! Signatures: no frame is accepted twice or after a change, own timestamps only increase, and the stored state
//! survives a session.
//!
//! The first byte selects the meaning of the others: bytes of a link with foreign signatures, an exchange of several
//! senders, the text of a key file, or the text of the state that is stored beside a key.

mod exchange;
mod inputs;
mod stored;
mod wire;

use crate::operands::Operands;

/// Input: one byte that chooses the part, then what that part reads.
pub(crate) fn check(data: &[u8]) {
    let mut operands = Operands::new(data);
    match operands.byte() % 4 {
        0 => wire::check(operands),
        1 => exchange::check(operands),
        2 => stored::check_key(operands.remaining()),
        _ => stored::check_memory(operands.remaining()),
    }
}
