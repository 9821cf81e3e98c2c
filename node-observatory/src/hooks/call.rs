//! One call of a script's function: on a thread of its own, for so long and no longer.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rhai::{CallFnOptions, Dynamic, EvalAltResult, Scope};
use tokio::sync::{mpsc, oneshot};

use super::engine;
use super::line::{Asked, Host, ScriptLine};
use super::memory::{self, Meter};
use super::script::{Function, Script};

/// Stack of a script's thread, bytes: the depth of calls that the engine allows fits in with room to spare.
const STACK: usize = 16 << 20;

/// Why a function did not do its work.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CallError {
    /// It failed, with line and column where the script itself did.
    #[error("{0}")]
    Failed(String),
    /// It took too long.
    #[error("not done within {after_s:.1} s, and ended")]
    Late {
        /// How long.
        after_s: f64,
    },
}

/// What went wrong, with its place; of a script that was ended also why, which the language does not report.
fn words(error: &EvalAltResult) -> String {
    match error.unwrap_inner() {
        EvalAltResult::ErrorTerminated(why, place) => format!("{why} ({place})"),
        _ => error.to_string(),
    }
}

/// Ends the script of a call that is dropped.
struct CutOnDrop(Arc<AtomicBool>);

impl Drop for CutOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Script {
    /// Calls a function, and answers what it asks, at most for `most` of machine time; dropping the future ends it.
    ///
    /// # Errors
    /// When the script fails, or runs into a limit of time, work or memory.
    pub async fn call(&self, function: Function, most: Duration, host: &impl Host) -> Result<Dynamic, CallError> {
        self.call_within(function, most, memory::MOST, host).await
    }

    /// As [`Self::call`], with as many bytes of memory.
    pub(super) async fn call_within(
        &self,
        function: Function,
        most: Duration,
        most_bytes: u64,
        host: &impl Host,
    ) -> Result<Dynamic, CallError> {
        let (requests, mut asked) = mpsc::unbounded_channel::<Asked>();
        let (end, mut ended) = oneshot::channel();
        let cut = CutOnDrop(Arc::default());
        let until = Instant::now() + most;
        let line = ScriptLine { requests, cut: cut.0.clone(), until, memory: Meter::begin(most_bytes) };
        let ast = self.ast.clone();
        let run = move || {
            let options = CallFnOptions::new().eval_ast(false);
            let engine = engine::with_line(&line);
            let result = engine.call_fn_with_options::<Dynamic>(options, &mut Scope::new(), &ast, function.name(), ());
            // The receiver may be gone.
            let _ = end.send(result.map_err(|error| words(&error)));
        };
        let thread = std::thread::Builder::new().name("site script".to_owned()).stack_size(STACK);
        thread.spawn(run).map_err(|error| CallError::Failed(format!("it got no thread: {error}")))?;
        let talk = async {
            loop {
                tokio::select! {
                    biased;
                    result = &mut ended => {
                        let result = result.map_err(|_| CallError::Failed("it was lost".to_owned()))?;
                        return result.map_err(CallError::Failed);
                    }
                    Some(Asked { request, back }) = asked.recv() => {
                        // The script may have been cut meanwhile.
                        let _ = back.send(host.answer(request).await);
                    }
                }
            }
        };
        let ended = tokio::time::timeout(most, talk).await;
        let late = CallError::Late { after_s: most.as_secs_f64() };
        match ended {
            // The thread may notice the end before this task does.
            Ok(Err(CallError::Failed(_))) if Instant::now() >= until => Err(late),
            Ok(result) => result,
            Err(_) => Err(late),
        }
    }
}
