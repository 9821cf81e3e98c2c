//! One received payload.

use contract::{Key, Stamped};

use crate::MachineTime;

/// One received payload.
#[derive(Debug, Clone)]
pub struct Received<T> {
    /// On which key.
    pub key: Key,
    /// The payload with boot id, sequence number and time.
    pub sample: Stamped<T>,
    /// When it arrived, on this machine's own clock, less what it was held or on its way longer than others were;
    /// ages are judged by it.
    pub arrived: MachineTime,
}
