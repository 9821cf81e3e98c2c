//! `starmesh status`: one table of all telescopes on the bus.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use clap::Args;
use contract::observatory::{Alerts, NightState, Posture, SafetyState, Verdict};
use contract::{Address, Key, Part};

use crate::console::line;
use crate::join::Join;

/// Options of `starmesh status`.
#[derive(Debug, Args)]
pub struct Options {
    /// How long to look for telescopes, s.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    #[command(flatten)]
    join: Join,
}

#[derive(Default)]
struct Row {
    safety: String,
    posture: String,
    mode: String,
    doing: String,
    alerts: usize,
}

/// Asks all observatory nodes and prints the table.
pub async fn run(options: Options) -> anyhow::Result<()> {
    let bus = options.join.open().await?;
    let until = Instant::now() + Duration::from_secs_f64(options.seconds.clamp(0.5, 60.0));
    let mut rows: BTreeMap<Address, Row> = BTreeMap::new();
    // peers are found one after another: ask until the time is up or an answer repeats without news
    let mut known = 0;
    while Instant::now() < until {
        ask(&bus, &mut rows).await;
        if !rows.is_empty() && rows.len() == known {
            break;
        }
        known = rows.len();
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    if rows.is_empty() {
        anyhow::bail!(
            "no telescope answered on the bus within {} s; is a node running, and is it reachable by multicast or --connect?",
            options.seconds
        );
    }
    line(format_args!("{:28} {:8} {:9} {:9} {:>6}  NOW", "TELESCOPE", "SAFETY", "POSTURE", "MODE", "ALERTS"))?;
    for (address, row) in rows {
        let Row { safety, posture, mode, doing, alerts } = row;
        line(format_args!("{:28} {safety:8} {posture:9} {mode:9} {alerts:>6}  {doing}", address.to_string()))?;
    }
    bus.close().await;
    Ok(())
}

async fn ask(bus: &bus::Bus, rows: &mut BTreeMap<Address, Row>) {
    let timeout = Duration::from_secs(1);
    let part = |part: Part| format!("{}/*/*/observatory/{}/state", contract::key::ROOT, part.word());
    for (key, said) in bus.get_all::<NightState>(&part(Part::Night), timeout).await {
        let row = rows.entry(key.address().clone()).or_default();
        row.posture = posture_word(said.body.posture).to_owned();
        row.mode = match (said.body.simulated, said.body.robotic) {
            (true, _) => "SIMULATED",
            (false, true) => "ROBOTIC",
            (false, false) => "MANUAL",
        }
        .to_owned();
        let actions = said.body.actions.iter().map(|action| {
            let object = action.object.as_deref().unwrap_or_default();
            format!("{} {object} {}", action.action, action.step)
        });
        row.doing = actions.collect::<Vec<_>>().join("; ");
    }
    for (key, said) in bus.get_all::<SafetyState>(&part(Part::Safety), timeout).await {
        let row = rows.entry(key.address().clone()).or_default();
        row.safety = match said.body.verdict {
            Verdict::Safe => "SAFE".to_owned(),
            Verdict::Unsafe => "UNSAFE".to_owned(),
        };
        if let Some(reason) = said.body.reasons.first().filter(|_| row.doing.is_empty()) {
            row.doing = format!("{}: {}", reason.input, reason.why);
        }
    }
    for (key, said) in bus.get_all::<Alerts>(&part(Part::Alerts), timeout).await {
        if matches!(key, Key::Observatory(..)) {
            rows.entry(key.address().clone()).or_default().alerts = said.body.alerts.len();
        }
    }
}

/// A posture as operators say it.
pub fn posture_word(posture: Posture) -> &'static str {
    match posture {
        Posture::Closed => "CLOSED",
        Posture::Opening => "OPENING",
        Posture::Open => "OPEN",
        Posture::Closing => "CLOSING",
        Posture::Unknown => "UNKNOWN",
    }
}
