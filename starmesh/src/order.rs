//! `starmesh order`: what a person may order of one telescope, from any machine on its bus.

use std::time::Duration;

use anyhow::{Context as _, bail};
use bus::AskError;
use clap::{Args, Subcommand};
use contract::{Address, CommandId, Key, Order, OrderKind, Reply};

use crate::console::line;
use crate::join::Join;

/// Options of `starmesh order`.
#[derive(Debug, Args)]
pub struct Options {
    /// Which telescope, as SITE/TELESCOPE.
    telescope: String,
    #[command(subcommand)]
    what: What,
    /// Why, for the log; an override and a shelved alert need it.
    #[arg(long, default_value = "", global = true)]
    reason: String,
    #[command(flatten)]
    join: Join,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Stop everything and close now; the robotic switch goes off.
    Close,
    /// Work through the schedule.
    Start,
    /// Stop working through the schedule, after closing.
    Stop,
    /// Read the schedule file again.
    Reload,
    /// Close, and open for nobody until `open-again`.
    StayClosed,
    /// Take `stay-closed` back; opens nothing by itself.
    OpenAgain,
    /// Do without one limit of the weather, or the Sun's, for a while.
    Override {
        /// The input as `starmesh status` and the page name it, such as wx/Humidity or sun.
        input: String,
        /// For so many minutes of sky time, at most 480.
        #[arg(long, default_value_t = 60.0)]
        minutes: f64,
    },
    /// Heed an overridden limit again.
    Heed {
        /// The input.
        input: String,
    },
    /// Somebody knows of an alert and sees to it: it is not escalated, and clears when its cause is gone.
    Ack {
        /// Id of the alert, such as dome-not-closed/dome_1.
        alert: String,
    },
    /// Tell nobody of one alert for a while; needs a reason.
    Shelve {
        /// Id of the alert.
        alert: String,
        /// For so many minutes of sky time, at most 1440.
        #[arg(long, default_value_t = 60.0)]
        for_min: f64,
    },
    /// Tell of a shelved alert again.
    Unshelve {
        /// Id of the alert.
        alert: String,
    },
}

impl What {
    fn kind(self) -> OrderKind {
        match self {
            Self::Close => OrderKind::Close,
            Self::Start => OrderKind::Robotic(true),
            Self::Stop => OrderKind::Robotic(false),
            Self::Reload => OrderKind::ReloadSchedule,
            Self::StayClosed => OrderKind::StayClosed(true),
            Self::OpenAgain => OrderKind::StayClosed(false),
            Self::Override { input, minutes } => OrderKind::Override { input, for_s: minutes * 60.0 },
            Self::Heed { input } => OrderKind::Override { input, for_s: 0.0 },
            Self::Ack { alert } => OrderKind::Acknowledge(alert),
            Self::Shelve { alert, for_min } => OrderKind::Shelve { alert, for_s: for_min * 60.0 },
            Self::Unshelve { alert } => OrderKind::Unshelve(alert),
        }
    }
}

/// How often an order that nobody answered is given again; a session that has just opened does not know all its peers.
const TRIES: u32 = 5;

/// Gives the order and says what became of it.
pub async fn run(options: Options) -> anyhow::Result<()> {
    give(&options.telescope, options.what.kind(), options.reason, options.join).await
}

/// Gives any order to a telescope, named as SITE/TELESCOPE, and says what became of it.
pub async fn give(telescope: &str, kind: OrderKind, reason: String, join: Join) -> anyhow::Result<()> {
    let (site, telescope) = telescope.split_once('/').context("expected SITE/TELESCOPE, such as paranal/io")?;
    let address = Address::new(site, telescope).context("expected SITE/TELESCOPE, such as paranal/io")?;
    let user = std::env::var("USER").or_else(|_| std::env::var("USERNAME")).unwrap_or_default();
    let order = Order {
        id: CommandId::fresh(),
        from: format!("starmesh cli {user}@{}", bus::node::host_name()).trim_end_matches('@').to_owned(),
        reason,
        kind,
    };
    let bus = join.open().await?;
    let key = Key::Order(address);
    let mut tried = 0;
    let reply = loop {
        match bus.ask::<_, Reply>(&key, &order, Duration::from_secs(3)).await {
            Err(AskError::Unknown { .. }) if tried < TRIES => tried += 1,
            answered => break answered.with_context(|| format!("no observatory node answers {key}"))?,
        }
        tokio::time::sleep(Duration::from_millis(500)).await;
    };
    match reply {
        Reply::Accepted(_) => line(format_args!("accepted"))?,
        Reply::Refusal(refusal) => bail!("refused, {}: {}", refusal.reason, refusal.detail),
    }
    bus.close().await;
    Ok(())
}
