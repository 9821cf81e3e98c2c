//! Which token a command needs, and whose lease it is of.

use contract::{Chunk, Reason};

use crate::turned::Turned;

/// A token older than the newest is refused; so is none, once there is one. A node that grants no leases may receive a
/// new one after its holder has used it.
pub fn fence(token: Option<u64>, highest: u64, is_arbiter: bool) -> Result<(), Turned> {
    match token {
        Some(token) if token == highest => Ok(()),
        Some(token) if token > highest && !is_arbiter => Ok(()),
        Some(token) if token > highest => {
            Err((Reason::StaleToken, format!("token {token} was never granted; the newest is {highest}")))
        }
        None if highest == 0 && !is_arbiter => Ok(()),
        Some(token) => Err((Reason::StaleToken, format!("token {token} is older than {highest}"))),
        None => Err((Reason::StaleToken, format!("no token; the newest is {highest}"))),
    }
}

/// Which telescope's lease counts for a command from `from` (`observatory/alpha/main`): the sender's own where the
/// device serves several (`served`, of a dome), else that of the device's telescope.
pub fn commanded(from: &str, served: &[Chunk], telescope: &str) -> Result<String, Turned> {
    match served {
        [] => Ok(telescope.to_owned()),
        [only] => Ok(only.to_string()),
        several => {
            let named = from.split('/').nth(1).unwrap_or_default();
            let found = several.iter().find(|telescope| telescope.as_str() == named).map(ToString::to_string);
            found.ok_or_else(|| {
                let detail = format!("{from:?} names none of this dome's telescopes; expected role/telescope/id");
                (Reason::Malformed, detail)
            })
        }
    }
}
