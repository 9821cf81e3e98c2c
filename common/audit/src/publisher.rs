//! Publishes a node's audit: each record once it is on disk, and the older ones when asked.

use std::sync::{Arc, Mutex, PoisonError};

use bus::BusError;
use contract::NodeTopic;
use contract::audit::{AuditAnswer, AuditQuestion, AuditRecord, PublishedRecord};
use node::Node;
use serde_json::Value;
use tokio::sync::mpsc;

use crate::Proven;
use crate::past::{PORTION, Past};

/// Publishes and answers until the writer has ended.
pub async fn start(node: &Node, past: Past, mut written: mpsc::Receiver<Proven>) -> Result<(), BusError> {
    let records = node.bus.publisher::<PublishedRecord<AuditRecord>>(&node.key(NodeTopic::Audit)).await?;
    let past = Arc::new(Mutex::new(past));
    let answer = move |question: Result<AuditQuestion, String>| {
        let past = past.clone();
        async move {
            let nothing = AuditAnswer { records: Vec::new(), more: false, known: true };
            let Ok(question) = question else { return nothing };
            let limit = question.limit.map_or(PORTION, |limit| (limit as usize).clamp(1, PORTION));
            let look = move || {
                let mut past = past.lock().unwrap_or_else(PoisonError::into_inner);
                past.after(question.after_sha256.as_deref(), limit)
            };
            match tokio::task::spawn_blocking(look).await {
                Ok(Ok(answer)) => answer,
                failed => {
                    tracing::warn!(?failed, "the audit's own file cannot be read; it will be asked for again");
                    // There are more records, and they cannot be sent now.
                    AuditAnswer { more: true, ..nothing }
                }
            }
        }
    };
    let service =
        node.bus.serve::<AuditQuestion, AuditAnswer<Value>, _, _>(&node.key(NodeTopic::AuditSince), answer).await?;
    tokio::spawn(async move {
        let _service = service;
        while let Some(proven) = written.recv().await {
            if let Err(error) = records.put(PublishedRecord { record: proven.record }).await {
                tracing::warn!(%error, "an audit record could not be published; the archive will ask for it");
            }
        }
    });
    Ok(())
}
