//! The permits and tokens that a command needs before it is accepted.

/// What a command needs before it is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Need {
    /// Nothing: anyone who may send commands at all may stop and close.
    Nothing,
    /// The newest token, but only while a valid safe permit exists: park and tracking off.
    TokenWhileSafe,
    /// The newest token: everything that moves.
    Token,
    /// The newest token and every permit.
    TokenAndPermit,
    /// The newest token, every permit, and no hold: opening an enclosure.
    Open,
    /// Nothing, and the guard must know: closing an enclosure.
    Close,
    /// To be granted a lease.
    Claim,
    /// To end a hold of the guard.
    Resume,
}
