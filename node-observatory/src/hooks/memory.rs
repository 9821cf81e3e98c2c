//! How much memory this process has taken since a script began.
//!
//! The language bounds each text, list and map where one is made or handed on, but not a map into which entry after
//! entry is put in its place (`map[key] = value`; rhai 1.27, module `eval::indexing`). So the whole is looked at too, now
//! and then.

/// A script that is at work while the process grows by more than this is ended, bytes: well beyond what its variables
/// can hold by the engine's other limits, and what a small computer can spare.
pub const MOST: u64 = 256 << 20;
/// Looked at once in so many steps of work: each step adds at most one text.
const EVERY: u64 = 256;

/// Memory of this process when a script began.
#[derive(Debug, Clone, Copy)]
pub struct Meter {
    before: Option<u64>,
    most: u64,
}

impl Meter {
    /// Begins now; the process may grow by `most` bytes, which others in it share.
    pub fn begin(most: u64) -> Self {
        Self { before: resident(), most }
    }

    /// Is it too much? Looked at in some steps of work only; never where the system does not report it.
    pub fn is_full(&self, step: u64) -> bool {
        let grown = || Some(resident()?.saturating_sub(self.before?));
        step.is_multiple_of(EVERY) && grown().is_some_and(|grown| grown > self.most)
    }

    /// In words.
    pub fn words(&self) -> String {
        format!("it is ended: memory grew by more than {} MiB while it ran", self.most >> 20)
    }
}

/// Resident memory of this process, bytes; Linux reports it in pages.
fn resident() -> Option<u64> {
    // Every kernel that this runs on by default has pages of this size, and others have larger ones.
    const PAGE: u64 = 4096;
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    text.split_whitespace().nth(1)?.parse::<u64>().ok().map(|pages| pages * PAGE)
}
