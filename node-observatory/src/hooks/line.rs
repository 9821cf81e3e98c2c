//! The line between a script's thread and this node: the script asks and waits, the node answers.

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use contract::device::vendor::VendorCommand;
use serde_json::Value;
use tokio::sync::{mpsc, oneshot};

use super::memory::Meter;

/// What a script may ask.
#[derive(Debug, Clone, PartialEq)]
pub enum Request {
    /// The default of what the function stands for.
    Default,
    /// Parts of the default opening.
    OpenDomes,
    /// See above.
    OpenCovers,
    /// See above.
    Unpark,
    /// A command of the maker's own to a device, such as `telescope` or `dome/roof`.
    Vendor(String, VendorCommand),
    /// What is true of a device.
    State(String),
    /// Is the sky safe?
    IsSafe,
    /// To wait, sky s.
    Sleep(f64),
    /// A line for the diary.
    Note(String),
}

/// What it is answered.
#[derive(Debug, Clone, PartialEq)]
pub enum Reply {
    /// It is done.
    Done,
    /// Yes or no.
    Truth(bool),
    /// Words.
    Text(String),
    /// Fields.
    Fields(Value),
}

/// An answer, or why there is none, in words that the script may catch.
pub type HostAnswer = Result<Reply, String>;

/// A request with the way back.
pub struct Asked {
    /// What.
    pub request: Request,
    /// Where the answer goes.
    pub back: oneshot::Sender<HostAnswer>,
}

/// The part that answers a script.
pub trait Host: Sync {
    /// Answers; dropping the future in the middle must be harmless.
    fn answer(&self, request: Request) -> impl Future<Output = HostAnswer> + Send;
}

/// The script's end of the line. Cheap to clone.
#[derive(Clone)]
pub struct ScriptLine {
    /// Where requests go.
    pub requests: mpsc::UnboundedSender<Asked>,
    /// Set when nobody waits for the script any more.
    pub cut: Arc<AtomicBool>,
    /// When it must end, by the machine's monotonic clock, also if nobody is there to cut it.
    pub until: Instant,
    /// How much memory it may take.
    pub memory: Meter,
}

/// The script is over, whatever its result.
pub struct Over;

impl ScriptLine {
    /// Asks, and waits for the answer.
    ///
    /// # Errors
    /// `Over` when the script must end; no script can catch that.
    pub fn ask(&self, request: Request) -> Result<HostAnswer, Over> {
        let (back, answer) = oneshot::channel();
        if self.is_over() || self.requests.send(Asked { request, back }).is_err() {
            return Err(Over);
        }
        answer.blocking_recv().map_err(|_| Over)
    }

    /// Must the script end?
    pub fn is_over(&self) -> bool {
        self.cut.load(Ordering::Relaxed) || Instant::now() >= self.until
    }
}
