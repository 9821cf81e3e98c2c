//! The browsers that get alerts of this node's telescope: whoever loses the right to read it gets none.

use std::sync::Arc;
use std::time::Duration;

use contract::Address;
use notify::push::Subscriptions;

use crate::authentication::{Authentication, Credential};

const EVERY: Duration = Duration::from_secs(5);

/// Those of this node.
///
/// # Errors
/// This host gives no random numbers.
pub fn open(node: &node::Node) -> anyhow::Result<Arc<Subscriptions>> {
    let name = format!("push-{}-{}.json", node.config.place.telescope, node.id);
    Ok(Arc::new(Subscriptions::open(node.config.folders.data.join(name), &node.config)?))
}

/// Follows the users, for ever.
pub async fn follow_users(
    subscriptions: Arc<Subscriptions>,
    authentication: Authentication,
    telescope: Address,
) -> anyhow::Result<()> {
    // As a proxy's word would count: by the users file, or by `web.proxy_right`.
    let may_read = |user: &str| {
        if authentication.is_faulty() {
            return true;
        }
        let caller = authentication.principal(&Credential::Proxy(user.to_owned()));
        caller.is_ok_and(|caller| caller.right_at(&telescope).is_some())
    };
    loop {
        match subscriptions.retain(|_, one| may_read(&one.user)).await {
            Ok(0) => {}
            Ok(removed) => tracing::info!(removed, "browsers of users without a right get no more alerts"),
            Err(error) => tracing::error!(%error, "browsers of users without a right could not be removed"),
        }
        tokio::time::sleep(EVERY).await;
    }
}
