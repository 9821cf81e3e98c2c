//! The catalogue of alerts as a page for operators.

use std::fmt::Write as _;

use super::Priority;
use super::catalogue::{AlertEntry, AlertKind};

/// The generated part of `docs/operator/alerts.md`: each kind, the most urgent first.
pub fn markdown() -> String {
    let mut page = String::new();
    for priority in [Priority::Critical, Priority::High, Priority::Medium, Priority::Advisory] {
        let (name, means) = match priority {
            Priority::Critical => ("Critical", "Act now: people or hardware are in danger."),
            Priority::High => ("High", "Act within minutes: the night is being lost."),
            Priority::Medium => ("Medium", "Act tonight."),
            Priority::Advisory => ("Advisory", "For information; nothing is urgent."),
        };
        let _ = write!(page, "\n## {name}\n\n{means}\n");
        for kind in AlertKind::ALL.iter().filter(|kind| kind.entry().priority == priority) {
            let AlertEntry { consequence, action, on_delay_s, hold_s, .. } = kind.entry();
            let _ = write!(page, "\n### `{}`\n\n{}\n\n", kind.id(kind.entry().instance), kind.means());
            let _ = write!(page, "- Consequence: {consequence}\n- What to do: {action}\n");
            if *on_delay_s > 0 {
                let _ = writeln!(page, "- Shown after {on_delay_s} s.");
            }
            if *hold_s > 0 {
                let _ = writeln!(page, "- Stays active for {hold_s} s after its cause is gone.");
            }
        }
    }
    page
}
