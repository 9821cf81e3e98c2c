//! A site that is made anew at the path of one that was deleted.

use std::path::Path;

use crate::console::line;

/// Has the guard process forget the deleted site, and says so: else the new one stays closed in its first night, as after
/// the loss of its orders. `config` was not there before.
pub fn forget_deleted(config: &Path) -> anyhow::Result<()> {
    for copy in node_device::forget_deleted_site(config) {
        let copy = copy.display();
        line(format_args!(
            "removed {copy}: what the guard process of a deleted site at this path remembered; \
             no order of that site holds any more, such as stay-closed"
        ))?;
    }
    Ok(())
}
