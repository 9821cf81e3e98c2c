//! Answers questions about one stored frame ([`service`]): its row and its file ([`found`]), its header and pieces of the file
//! ([`file`]), pictures and values of its pixels ([`pixels`]); and about the report of a night ([`report`]).
//!
//! A question brings an id, never a path: the file is that of the frame's row, below the folder of images, and no link is
//! followed there.

mod file;
mod found;
mod pixels;
mod report;
mod service;

pub use service::serve;

use contract::archived_frame::{ArchiveRefusal, NotGiven};

/// Why something is not given.
fn refused(reason: NotGiven, detail: impl Into<String>) -> ArchiveRefusal {
    ArchiveRefusal { reason, detail: detail.into() }
}

#[cfg(test)]
mod tests;
