//! Which servers are simulators of ours; only they may run at another speed than 1.

use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::{Context as _, bail};
use bus::Clock;
use config::Common;
use contract::Kind;
use serde::Deserialize;

/// A simulator may still be starting when its nodes are.
const TIMEOUT: Duration = Duration::from_secs(10);

#[derive(Deserialize)]
struct Served {
    simulated: bool,
}

/// Does the server report that it is a simulator of ours? An error where it does not answer at all.
pub async fn is_simulated(server: &str) -> anyhow::Result<bool> {
    let client = local_http::client_builder().timeout(Duration::from_secs(2)).build()?;
    let answer = client.get(format!("http://{server}/simulator/v1/clock")).send().await?;
    let text = answer.text().await?;
    Ok(serde_json::from_str::<Served>(&text).is_ok_and(|served| served.simulated))
}

/// Refuses a speed other than 1 unless every device comes from a simulator.
pub async fn check_speed(clock: &Clock, devices: &[(Kind, &Common)]) -> anyhow::Result<()> {
    let speed = clock.speed();
    if speed == 1.0 {
        return Ok(());
    }
    let mut servers: BTreeMap<&str, bool> = BTreeMap::new();
    for (kind, common) in devices {
        let server = common.server.as_str();
        let simulated = match servers.get(server) {
            Some(known) => *known,
            None => asked(server).await.with_context(|| {
                format!("{kind} \"{}\": the clock runs at speed {speed}, and {server} does not answer whether it is a simulator", common.name)
            })?,
        };
        servers.insert(server, simulated);
        if !simulated {
            bail!(
                "{kind} \"{}\": the clock runs at speed {speed}, but {server} is no Starmesh simulator; real devices run at speed 1",
                common.name
            );
        }
    }
    Ok(())
}

async fn asked(server: &str) -> anyhow::Result<bool> {
    let asking = async {
        loop {
            match is_simulated(server).await {
                Ok(simulated) => return simulated,
                Err(error) => tracing::debug!(server, %error, "asked whether it is a simulator"),
            }
            tokio::time::sleep(Duration::from_millis(250)).await;
        }
    };
    Ok(tokio::time::timeout(TIMEOUT, asking).await?)
}
