//! Answers questions about schedules, while this node commands or nobody does; a standby is silent.

use std::sync::Arc;
use std::time::Duration;

use bus::Service;

use super::{ScheduleFile, findings, plan, texts};

/// Answers what is wrong with a schedule, what it will do, and which ones were active.
pub async fn keep_answering(file: Arc<ScheduleFile>) -> anyhow::Result<()> {
    let (mut hold, mut services): (_, Option<[Service; 3]>) = (file.authority.hold.clone(), None);
    let turn = Arc::default();
    loop {
        if !file.authority.is_publishing() {
            services = None;
        } else if services.is_none() {
            let findings = findings::serve(&file, &turn).await?;
            services = Some([findings, plan::serve(&file, &turn).await?, texts::serve(&file).await?]);
        }
        if hold.changed().await.is_err() {
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }
}
