//! Writes what guiding did about each frame into the table `guiding` of the database.

use bus::{Catch, Node};
use contract::observatory::Correction;
use contract::{Key, Scalar};

use crate::database::{Database, StoredCorrection, Write};

/// Corrections that wait here when the database is slow.
const WAITING: usize = 4096;

/// Stores the corrections of this telescope.
pub async fn keep(node: Node, database: Database) -> anyhow::Result<()> {
    let address = node.config.address();
    let said = Key::Correction(address.clone()).to_string();
    let corrections = node.bus.subscribe::<Correction>(&said, Catch::All, WAITING).await?;
    let mut count = 0;
    loop {
        let heard = corrections.hear().await.said;
        let telescope = address.telescope.to_string();
        let stored = StoredCorrection { correction: heard.body, telescope, said: (heard.boot_id, heard.seq) };
        database.commit(vec![Write::Correction(Box::new(stored))]).await?;
        count += 1;
        node.figure("corrections_heard", Scalar::Int(count));
    }
}
