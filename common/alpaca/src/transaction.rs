//! Transaction ids: an answer counts only if it is the answer to this request.
//!
//! A proxy, a cache or a confused server may return the answer of an earlier request or of another client, and such an
//! answer may be "safe" or "closed" after that has ceased to be true. See docs/decisions/0040.

use std::hash::{BuildHasher as _, RandomState};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use serde_json::Value;

use crate::AlpacaError;
use crate::envelope_number::envelope_number;

/// The `ClientTransactionID` of an answer.
#[derive(Debug, Clone, PartialEq)]
pub enum Echo {
    /// There is none, or it is null.
    Absent,
    /// A whole number; as text too.
    Number(i64),
    /// Something that is no whole number.
    Unreadable(String),
}

impl Echo {
    /// Reads the member of an answer; `exact` takes JSON integers only.
    pub fn of(member: Option<&Value>, exact: bool) -> Self {
        match member {
            None | Some(Value::Null) => Self::Absent,
            Some(value) => {
                let number = if exact { value.as_i64() } else { envelope_number(value) };
                number.map_or_else(|| Self::Unreadable(value.to_string().chars().take(60).collect()), Self::Number)
            }
        }
    }
}

/// Numbers the requests to one device, and checks the numbers of its answers.
#[derive(Debug)]
pub struct Transactions {
    next: AtomicU32,
    /// The server has returned the id of a request once, so it can.
    echoes: AtomicBool,
}

impl Transactions {
    /// Begins at a random number, so that answers to an earlier process, or to another one, have other numbers.
    pub fn fresh() -> Self {
        let random = RandomState::new().hash_one(std::process::id());
        // The upper half of the range is left for counting.
        Self { next: AtomicU32::new((random as u32) >> 1), echoes: AtomicBool::new(false) }
    }

    /// The id of the next request; never 0, which means no id.
    pub fn next(&self) -> u32 {
        self.next.fetch_add(1, Ordering::Relaxed).max(1)
    }

    /// Is this the answer to request `asked`? Servers that return no id send none or 0; any other number is the answer
    /// to another request, whatever the device and the answer.
    pub fn check(&self, asked: u32, echo: &Echo) -> Result<(), AlpacaError> {
        let foreign = |got: String| AlpacaError::Foreign { asked, got };
        match echo {
            Echo::Number(number) if *number == i64::from(asked) => {
                self.echoes.store(true, Ordering::Relaxed);
                Ok(())
            }
            Echo::Absent | Echo::Number(0) => Ok(()),
            Echo::Number(other) => Err(foreign(other.to_string())),
            Echo::Unreadable(text) => Err(foreign(text.clone())),
        }
    }

    /// As [`Self::check`], for an answer on which safety depends: a server that has ever returned an id must do so
    /// again.
    pub fn check_exactly(&self, asked: u32, echo: &Echo) -> Result<(), AlpacaError> {
        self.check(asked, echo)?;
        let missing = matches!(echo, Echo::Absent | Echo::Number(0));
        if missing && self.echoes.load(Ordering::Relaxed) {
            return Err(AlpacaError::Foreign {
                asked,
                got: "none, although this server has returned ids before".to_owned(),
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn asked(transactions: &Transactions, member: Option<Value>) -> bool {
        transactions.check(7, &Echo::of(member.as_ref(), false)).is_ok()
    }

    #[test]
    fn only_the_own_id_or_none_is_accepted() {
        let transactions = Transactions::fresh();
        for mine in [None, Some(json!(null)), Some(json!(0)), Some(json!(7)), Some(json!("7")), Some(json!(7.0))] {
            assert!(asked(&transactions, mine.clone()), "{mine:?}");
        }
        for foreign in [json!(6), json!(8), json!(-1), json!(-7), json!(7.5), json!("x"), json!([7]), json!(true)] {
            assert!(!asked(&transactions, Some(foreign.clone())), "{foreign}");
        }
    }

    #[test]
    fn where_safety_rests_on_it_a_server_that_returned_ids_must_go_on_doing_so() {
        let transactions = Transactions::fresh();
        let exactly = |member: Option<Value>| transactions.check_exactly(7, &Echo::of(member.as_ref(), true)).is_ok();
        assert!(exactly(None) && exactly(Some(json!(0))), "a server that never returns any");
        assert!(!exactly(Some(json!("7"))), "a text is no id here");
        assert!(exactly(Some(json!(7))));
        assert!(!exactly(None) && !exactly(Some(json!(0))));
        assert!(transactions.check(7, &Echo::Absent).is_ok(), "elsewhere it may");
    }

    #[test]
    fn two_processes_do_not_count_the_same_way() {
        let (one, other) = (Transactions::fresh(), Transactions::fresh());
        assert_ne!((one.next(), one.next()), (other.next(), other.next()));
    }
}
