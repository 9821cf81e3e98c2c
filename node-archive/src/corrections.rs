//! Writes what guiding did about each frame into the table `guiding` of the database.

use bus::Catch;
use contract::observatory::Correction;
use contract::{Key, Scalar};
use node::Node;

use crate::database::{Database, StoredCorrection, Write};

/// Corrections that wait here when the database is slow.
const WAITING: usize = 4096;

/// Stores the corrections of this telescope.
pub async fn keep(node: Node, database: Database) -> anyhow::Result<()> {
    let address = node.config.address();
    let payload = Key::Correction(address.clone()).to_string();
    let corrections = node.bus.subscribe::<Correction>(&payload, Catch::All, WAITING).await?;
    let mut count = 0;
    loop {
        let sample = corrections.recv().await.sample;
        let telescope = address.telescope.to_string();
        let stored = StoredCorrection { correction: sample.body, telescope, origin: (sample.boot_id, sample.seq) };
        database.commit(vec![Write::Correction(Box::new(stored))]).await?;
        count += 1;
        node.figure("corrections_heard", Scalar::Int(count));
    }
}
