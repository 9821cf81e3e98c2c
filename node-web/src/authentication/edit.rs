//! Changes the users file for a request, and lets the change count at once.

use users::{FileFault, LastEngineer, NoRandomness, Users};

use super::Authentication;
use crate::problem::{Code, Problem};

/// Why a change of the users file is refused.
pub enum Refusal {
    /// By what the request asks for.
    Problem(Problem),
    /// By the file.
    File(FileFault),
    /// No secret can be made.
    Randomness(NoRandomness),
}

impl From<FileFault> for Refusal {
    fn from(fault: FileFault) -> Self {
        Self::File(fault)
    }
}

impl From<LastEngineer> for Refusal {
    fn from(why: LastEngineer) -> Self {
        Self::Problem(Problem::new(Code::Conflict, "The last engineer", format!("{why}.")))
    }
}

impl From<Problem> for Refusal {
    fn from(problem: Problem) -> Self {
        Self::Problem(problem)
    }
}

impl From<NoRandomness> for Refusal {
    fn from(fault: NoRandomness) -> Self {
        Self::Randomness(fault)
    }
}

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        match refusal {
            Refusal::Problem(problem) => problem,
            Refusal::File(fault) => Self::internal(&fault),
            Refusal::Randomness(fault) => Self::internal(&fault),
        }
    }
}

impl Authentication {
    /// Changes the users file; what `change` refuses changes nothing. Sessions that a change ends have ended when this returns.
    ///
    /// # Errors
    /// The change is refused, or the file cannot be read or written.
    pub async fn edit<T: Send + 'static>(
        &self,
        change: impl FnOnce(&mut Users) -> Result<T, Refusal> + Send + 'static,
    ) -> Result<T, Problem> {
        let file = self.file();
        let done = tokio::task::spawn_blocking(move || users::edit(&file, change)).await;
        let done = done.map_err(|why| Problem::internal(&why))?;
        self.refresh().await;
        Ok(done?)
    }
}
