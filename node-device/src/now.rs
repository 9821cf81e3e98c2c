//! One moment by both monotonic clocks.

use bus::{MachineTime, SkyTime};

/// Both monotonic times of one moment.
#[derive(Debug, Clone, Copy)]
pub struct Now {
    /// Machine time.
    pub machine: MachineTime,
    /// Sky time.
    pub sky: SkyTime,
}
