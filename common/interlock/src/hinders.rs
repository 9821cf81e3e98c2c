//! The commands that nobody may give while a closing is due.

use contract::Reason;

use crate::turned::Turned;

/// Does a command hinder a closing that is due?
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Hinders {
    /// No.
    No,
    /// Yes, whichever process gives it.
    Yes,
    /// Yes, unless the commander gives it.
    FromOthers,
    /// Yes, where the commander does not know of the closing.
    FromTheUnaware,
}

/// The closing that a device may obstruct.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct DueClosing {
    /// The dome itself must close and is not proven closed.
    pub dome_closes: bool,
    /// The roof over this mount must close and waits for its park.
    pub must_park: bool,
    /// And the commander of the mount does not know that.
    pub unknown_to_commander: bool,
}

impl Hinders {
    /// Nobody stops, turns or moves what a closing needs, as long as it must close and is not proven closed.
    pub fn keep_out_of_the_way(self, due: DueClosing, is_commander: impl FnOnce() -> bool) -> Result<(), Turned> {
        let DueClosing { dome_closes, must_park, unknown_to_commander } = due;
        let stands_in_the_way = match self {
            Self::No => false,
            Self::Yes => dome_closes || must_park,
            Self::FromOthers => (dome_closes || must_park) && !is_commander(),
            Self::FromTheUnaware => unknown_to_commander,
        };
        if !stands_in_the_way {
            return Ok(());
        }
        let detail = if dome_closes {
            "the dome must close and is not verified closed; nothing that stops or turns it is taken until it is"
        } else {
            "the roof over this mount must close and waits for its park; nothing else is taken until it is closed"
        };
        Err((Reason::WrongState, detail.to_owned()))
    }
}
