//! `starmesh order`: what a person may order of one telescope, from any machine on its bus.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::{anyhow, bail};
use bus::{AskError, Catch, Subscriber};
use clap::{Args, Subcommand};
use contract::command::operator;
use contract::device::dome::Guard;
use contract::observatory::{NightState, Posture, StandingOrders};
use contract::{Address, CommandId, Device, Key, Kind, Order, OrderKind, Part, Reply, printable};

use crate::console::{foreign_line, line};
use crate::join::Join;
use crate::status::posture_word;
use crate::telescopes;

/// Options of `starmesh order`.
#[derive(Debug, Args)]
pub struct Options {
    /// Which telescope, as SITE/TELESCOPE.
    telescope: String,
    #[command(subcommand)]
    what: What,
    /// Why, for the log. An override, a shelved alert, and taking over from another operator need it.
    #[arg(long, default_value = "", global = true)]
    reason: String,
    /// Who orders, by name; by default $STARMESH_OPERATOR, else the name of the account.
    #[arg(long, value_name = "NAME", global = true)]
    operator: Option<String>,
    /// How long to wait until a close order is verified closed, s; 0 does not wait.
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0, global = true)]
    wait: f64,
    #[command(flatten)]
    join: Join,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Stop everything and close now; the robotic switch goes off. Waits until it is verified closed.
    Close,
    /// Work through the schedule.
    Start,
    /// Stop working through the schedule, after closing. Waits until it is verified closed.
    Stop,
    /// Read the schedule file again.
    Reload,
    /// Close, and open for nobody until `open-again`. Waits until it is verified closed.
    StayClosed,
    /// Take `stay-closed` back; the schedule goes on once the sky is safe, where somebody has ordered `start`.
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
    /// Run a camera's cooler now; the next row that exposes wants the configured set point again.
    Cool {
        /// Name of the camera.
        camera: String,
        /// Set point, degrees Celsius; that of the configuration where absent.
        #[arg(long, allow_negative_numbers = true)]
        temperature_c: Option<f64>,
    },
    /// Switch a camera's cooler off, until a row wants it.
    Warm {
        /// Name of the camera.
        camera: String,
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
            Self::Cool { camera, temperature_c } => OrderKind::Cool { camera, set_c: temperature_c },
            Self::Warm { camera } => OrderKind::Warm(camera),
            Self::Unshelve { alert } => OrderKind::Unshelve(alert),
        }
    }
}

/// How often an order that nobody answered is given again; a session that has just opened does not know all its peers.
const TRIES: u32 = 5;

/// An observatory node publishes each second which order it took last.
const SHOWN: Duration = Duration::from_secs(10);

/// Gives the order and prints what became of it.
pub async fn run(options: Options) -> anyhow::Result<()> {
    let Options { telescope, what, reason, operator, wait, join } = options;
    let wait = Duration::from_secs_f64(wait.clamp(0.0, 86_400.0));
    give(&telescope, what.kind(), By { operator, reason }, wait, join).await
}

/// The operator of an order, where a name was given, and the reason.
pub struct By {
    /// The operator's name.
    pub operator: Option<String>,
    /// For the log.
    pub reason: String,
}

/// Gives an order to a telescope, named as SITE/TELESCOPE, and prints the result; waits so long until a close order is
/// verified closed.
pub async fn give(telescope: &str, kind: OrderKind, by: By, wait: Duration, join: Join) -> anyhow::Result<()> {
    let order = Order { id: CommandId::fresh(), from: from(by.operator)?, reason: by.reason, kind };
    let bus = join.open().await?;
    let address = telescopes::read(telescope, &bus).await?;
    // The subscriptions begin before the order is given, so that no effect is missed.
    let sight = Sight::open(&bus, &address).await?;
    let key = Key::Order(address.clone());
    let mut tried = 0;
    let reply = loop {
        match bus.ask::<_, Reply>(&key, &order, Duration::from_secs(3)).await {
            Err(AskError::Unknown { .. }) if tried < TRIES => {
                tried += 1;
                // A mistyped name is reported at once where others answer.
                let known = telescopes::known(&bus).await;
                let is_mistyped = !known.is_empty() && !known.contains(&address);
                if is_mistyped && !telescopes::has_node(&address, &bus).await {
                    return Err(telescopes::unanswered(&address, &bus).await);
                }
            }
            Err(AskError::Unknown { .. }) => return Err(telescopes::unanswered(&address, &bus).await),
            answered => break answered.map_err(|error| anyhow!("{}", printable(&error.to_string())))?,
        }
        tokio::time::sleep(Duration::from_millis(500)).await;
    };
    match reply {
        Reply::Accepted(accepted) if accepted.id != order.id => {
            bail!("{key} answered for another order; whether it was done is unknown, see `starmesh status`")
        }
        Reply::Accepted(_) if closes(&order.kind) && !wait.is_zero() => {
            line(format_args!("accepted; waiting until it is verified closed, at most {:.0} s", wait.as_secs_f64()))?;
            sight.until_closed(&order.id, wait).await?;
            line(format_args!("verified closed"))?;
        }
        Reply::Accepted(_) => {
            line(format_args!("accepted"))?;
            if matches!(order.kind, OrderKind::Robotic(true)) {
                tell_of_hold(&bus, &address).await?;
            }
        }
        Reply::Refusal(refusal) => bail!("refused, {}: {}", refusal.reason, printable(&refusal.detail)),
    }
    bus.close().await;
    Ok(())
}

/// Prints the operator who ordered that the telescope stays closed, if there is such an order: a start opens nothing
/// then.
async fn tell_of_hold(bus: &bus::Bus, address: &Address) -> anyhow::Result<()> {
    let key = Key::Observatory(address.clone(), Part::Standing).to_string();
    for (_, said) in bus.get_all::<StandingOrders>(&key, Duration::from_secs(1)).await {
        if let Some(hold) = said.body.stay_closed {
            let reason = if hold.reason.is_empty() { "no reason given" } else { &hold.reason };
            foreign_line(format_args!(
                "it stays closed all the same: {} ordered so at {} ({reason}). `starmesh order {address} open-again` takes that back, \
                 and then it opens",
                operator(&hold.from),
                hold.at_utc
            ))?;
        }
    }
    Ok(())
}

/// The name of an operator at a command line: `cli/ana@dome-pc`.
fn from(operator: Option<String>) -> anyhow::Result<String> {
    let told = |name: &str| std::env::var(name).ok().filter(|value| !value.trim().is_empty());
    let account =
        || told("STARMESH_OPERATOR").or_else(|| told("USER")).or_else(|| told("USERNAME")).or_else(of_account);
    let name = operator.or_else(account).unwrap_or_default();
    let name = name.trim();
    if name.is_empty() || name.contains(['/', '@']) || name.chars().any(char::is_control) {
        bail!("who orders? expected --operator NAME, without '/' and '@', such as --operator ana; got {name:?}");
    }
    Ok(format!("cli/{name}@{}", bus::node::host_name()).trim_end_matches('@').to_owned())
}

/// The name of this process's account where its environment does not contain it, as in a container.
fn of_account() -> Option<String> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let uid = status.lines().find_map(|line| line.strip_prefix("Uid:"))?.split_whitespace().next()?.to_owned();
    let accounts = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let mut names = accounts.lines().filter_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)? == uid).then(|| name.to_owned())
    });
    Some(names.next().unwrap_or_else(|| format!("uid-{uid}")))
}

fn closes(kind: &OrderKind) -> bool {
    matches!(kind, OrderKind::Close | OrderKind::Robotic(false) | OrderKind::StayClosed(true))
}

/// The states of one telescope while an order is given.
struct Sight {
    address: Address,
    nights: Subscriber<NightState>,
    guards: Subscriber<Guard>,
}

impl Sight {
    async fn open(bus: &bus::Bus, address: &Address) -> anyhow::Result<Self> {
        let night = Key::Observatory(address.clone(), Part::Night).to_string();
        let guard = format!("{}/{}/*/device/{}/*/guard", contract::key::ROOT, address.site, Kind::Dome);
        Ok(Self {
            address: address.clone(),
            nights: bus.subscribe(&night, Catch::Newest, 64).await?,
            guards: bus.subscribe(&guard, Catch::Newest, 64).await?,
        })
    }

    /// Waits until the observatory node shows the order, reports that all is closed, and no guard of its domes contradicts it.
    async fn until_closed(&self, order: &CommandId, wait: Duration) -> anyhow::Result<()> {
        let began = Instant::now();
        let (mut seen, mut posture) = (false, None);
        let mut domes: BTreeMap<String, bool> = BTreeMap::new();
        while began.elapsed() < wait {
            let left = wait.saturating_sub(began.elapsed()).min(Duration::from_secs(1));
            tokio::select! {
                heard = self.nights.hear() => {
                    let night = heard.said.body;
                    // Somebody else may publish in its name: only a sample that contains the order counts.
                    if night.last_order.as_ref().is_some_and(|last| last.id == *order) {
                        (seen, posture) = (true, Some(night.posture));
                    }
                }
                heard = self.guards.hear() => {
                    if let Key::Guard(dome) = &heard.key && self.is_over(dome, &heard.said.body) {
                        domes.insert(dome.to_string(), heard.said.body.verified_closed != Some(false));
                    }
                }
                () = tokio::time::sleep(left) => {}
            }
            if seen && posture == Some(Posture::Closed) && domes.values().all(|closed| *closed) {
                return Ok(());
            }
            if !seen && began.elapsed() > SHOWN {
                bail!(
                    "NOT VERIFIED: somebody answered \"accepted\", but the observatory node of {} does not show the order \
                     after {} s. Look at the dome, and close it at its own controls",
                    self.address,
                    SHOWN.as_secs()
                );
            }
        }
        let open: Vec<&str> = domes.iter().filter(|(_, closed)| !**closed).map(|(dome, _)| dome.as_str()).collect();
        let posture = posture.map_or("unknown", posture_word).to_lowercase();
        let open = if open.is_empty() { String::new() } else { format!("; not closed: {}", open.join(", ")) };
        bail!(
            "NOT verified closed within {:.0} s: {} is {posture}{open}. The closing goes on; look at the alerts and at the dome",
            wait.as_secs_f64(),
            self.address
        )
    }

    /// Is this the guard of a dome over the telescope?
    fn is_over(&self, dome: &Device, said: &Guard) -> bool {
        let telescope = self.address.telescope.as_str();
        dome.address == self.address
            || said.granted.iter().any(|granted| granted.telescope == telescope)
            || said.permits.iter().any(|permit| permit.telescope == telescope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_orders_is_named_with_the_way_and_the_host() {
        let signed = from(Some(" ana ".to_owned())).unwrap();
        assert!(signed.starts_with("cli/ana"), "{signed}");
        assert_eq!(contract::command::operator(&signed), "ana");
        for bad in ["", " ", "a/b", "a@b", "a\nb"] {
            assert!(from(Some(bad.to_owned())).is_err(), "{bad:?}");
        }
        #[cfg(target_os = "linux")]
        assert!(!of_account().unwrap().is_empty(), "an account has a name or a number");
    }
}
