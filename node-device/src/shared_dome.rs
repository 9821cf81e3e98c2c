//! Raises an alert for a dome that could turn, serves several telescopes, and for which no configuration says what
//! turns it.
//!
//! One slit cannot be where each of them looks, so no observatory node turns it (docs/decisions/0025). A roof that
//! slides off needs no more; behind a turning dome frames may show its wall.

use std::sync::{Arc, PoisonError};
use std::time::Duration;

use config::Follow;
use contract::Address;
use contract::device::dome::Capabilities;
use contract::observatory::AlertKind;
use node::Node;

use crate::command_server::CommandServer;
use crate::driver::dome::Dome;

/// The capabilities of a dome are read again whenever it connects; nobody needs to know of a change sooner.
const LOOK: Duration = Duration::from_secs(2);

/// Raises the alert of such a dome, and clears it when the dome reports that it does not turn or that another program
/// has slaved it; for ever.
pub async fn keep_noticing(
    node: Node,
    block: config::Dome,
    command_server: Arc<CommandServer<Dome>>,
) -> anyhow::Result<()> {
    let name = &block.common.name;
    let is_shared = node.config.place.telescope.as_str() == Address::SHARED;
    let mut reported = None;
    loop {
        let cause = {
            let status = command_server.status.lock().unwrap_or_else(PoisonError::into_inner);
            let slaved = status.fields.slaved.known() == Some(&true);
            status.can.as_ref().filter(|_| !slaved).and_then(|can| complaint(&block, is_shared, can))
        };
        if cause != reported {
            match &cause {
                Some(cause) => node.alerts.raise(AlertKind::DomeShared, name, cause),
                None => node.alerts.clear(AlertKind::DomeShared, name),
            }
            reported = cause;
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// The problem of a dome with these capabilities, if any; `is_shared` where its block is in the site's shared file.
fn complaint(block: &config::Dome, is_shared: bool, can: &Capabilities) -> Option<String> {
    let over_several = is_shared || block.telescopes.len() > 1;
    let why = format!(
        "dome {} can turn, stands over several telescopes, and nothing says who turns its slit: Starmesh does not",
        block.common.name
    );
    (over_several && block.follow == Follow::Auto && can.set_azimuth).then_some(why)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn only_a_dome_that_turns_over_several_telescopes_without_settings_is_complained_of() {
        let dome = |more: &str| {
            let text = format!(
                "[observatory]\nsite = \"p\"\ntelescope = \"t\"\nlatitude_deg = 1\nlongitude_deg = 2\nelevation_m = 3\n\
                 [[dome]]\nname = \"d\"\nserver = \"a:1\"\n{more}\n"
            );
            config::parse(&text, Path::new("/site")).unwrap().dome.remove(0)
        };
        let several = "telescopes = [\"t\", \"u\"]";
        let off = format!("{several}\nfollow = \"off\"");
        let scenarios = [
            ("", false, true, false),
            ("", true, true, true),
            ("telescopes = [\"t\"]", false, true, false),
            (several, false, true, true),
            (several, false, false, false),
            (&off, false, true, false),
        ];
        for (more, is_shared, set_azimuth, wanted) in scenarios {
            let can = Capabilities { set_azimuth, ..Capabilities::default() };
            let complained = complaint(&dome(more), is_shared, &can);
            assert_eq!(complained.is_some(), wanted, "{more} {is_shared} {set_azimuth}: {complained:?}");
        }
    }
}
