//! The robotic switch: off closes what it had opened, and acts before it is on disk.

use std::sync::Arc;

use contract::observatory::AlertKind;

use crate::authority::Authority;
use crate::journal::Journal;

/// Turns the switch off; that closes what it had opened.
pub fn turn_off(authority: &Authority, journal: &Arc<Journal>, why: &str) {
    if authority.robotic.send_replace(false) {
        authority.close_request.send_replace(Some(why.to_owned()));
        note_off(authority, journal);
    }
}

/// Records that the switch is off, in parallel with all else.
pub fn note_off(authority: &Authority, journal: &Arc<Journal>) {
    let (node, journal) = (authority.node.clone(), journal.clone());
    let sent = journal.robotic_off(node.bus.clock().utc());
    tokio::task::spawn_blocking(move || match journal.arrive(sent) {
        Ok(()) => node.alerts.clear(AlertKind::Journal, ""),
        Err(error) => {
            let cause = format!("the robotic switch is off, and a restart will not know it: {error}");
            node.alerts.raise(AlertKind::Journal, "", &cause);
        }
    });
}
