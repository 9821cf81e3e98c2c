//! A person's standing orders to the verdict: stay closed, and do without one limit for a while.
//!
//! They outlive a restart (`standing-TELESCOPE.json` in the data folder). Staying closed has no end of its own; an
//! override has, at most eight hours, and only limits and the Sun can be overridden: no safety monitor, no vote.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use config::Response;
use contract::observatory::AlertKind;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::control_room::ControlRoom;
use crate::safety::rules::Rules;

/// The longest that one order can do without a limit, sky s.
pub const LONGEST_OVERRIDE_S: f64 = 8.0 * 3600.0;
/// What the Sun is called among the inputs.
pub const SUN: &str = "sun";

/// Who ordered something, and why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Said {
    /// Who.
    pub from: String,
    /// Why.
    pub reason: String,
    /// When, sky time.
    pub at_utc: Utc,
}

/// One limit that is done without.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Override {
    /// Who, why and when.
    #[serde(flatten)]
    pub said: Said,
    /// Until when, sky time.
    pub until_utc: Utc,
}

/// The standing orders.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Standing {
    /// Nothing opens while this stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stay_closed: Option<Said>,
    /// By input.
    #[serde(default)]
    pub overrides: BTreeMap<String, Override>,
}

impl Standing {
    /// What was ordered before; a file that cannot be read keeps the dome closed until a person decides anew.
    pub fn read(path: &Path, now: Utc) -> Self {
        let unreadable = |why: String| {
            let reason = format!("{} cannot be read: {why}", path.display());
            Self {
                stay_closed: Some(Said { from: "observatory node".to_owned(), reason, at_utc: now }),
                ..Self::default()
            }
        };
        match std::fs::read(path) {
            Ok(bytes) => serde_json::from_slice(&bytes).unwrap_or_else(|error| unreadable(error.to_string())),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Self::default(),
            Err(error) => unreadable(error.to_string()),
        }
    }

    /// What holds where these orders could not be written and others stand on disk: whatever keeps it closed, and no
    /// override that only one of them knows.
    pub fn stricter(self, other: Self) -> Self {
        let overrides = self.overrides.into_iter().filter(|(input, order)| other.overrides.get(input) == Some(order));
        Self { stay_closed: self.stay_closed.or(other.stay_closed), overrides: overrides.collect() }
    }

    /// Keeps it for the next life of this node: the old file or the new one, whatever happens.
    pub fn write(&self, path: &Path) -> std::io::Result<()> {
        let part = path.with_extension("json.part");
        let mut file = std::fs::File::create(&part)?;
        file.write_all(&serde_json::to_vec_pretty(self)?)?;
        file.sync_all()?;
        std::fs::rename(part, path)
    }

    /// Takes an override, or says why not.
    pub fn do_without(&mut self, rules: &Rules, input: &str, for_s: f64, said: Said) -> Result<(), String> {
        let known: Vec<&str> = rules.limits.iter().map(|rule| rule.input.as_str()).chain([SUN]).collect();
        if !known.contains(&input) {
            return Err(format!("no limit is called \"{input}\"; expected one of {}", known.join(", ")));
        }
        if for_s != 0.0 && said.reason.trim().is_empty() {
            return Err("an override needs a reason".to_owned());
        }
        if !(0.0..=LONGEST_OVERRIDE_S).contains(&for_s) {
            return Err(format!("for_s = {for_s}: expected 0 (heed it again) to {LONGEST_OVERRIDE_S} s"));
        }
        if for_s == 0.0 {
            self.overrides.remove(input);
        } else {
            let until_utc = said.at_utc.plus_seconds(for_s);
            self.overrides.insert(input.to_owned(), Override { said, until_utc });
        }
        Ok(())
    }

    /// The overrides that hold now. A clock that was put back cannot make one last longer than an order may.
    pub fn holding(&self, now: Utc) -> impl Iterator<Item = (&str, &Override)> {
        let holds = move |order: &Override| {
            let left_s = order.until_utc.seconds_since(now);
            left_s > 0.0 && left_s <= LONGEST_OVERRIDE_S
        };
        self.overrides.iter().filter(move |(_, order)| holds(order)).map(|(input, order)| (input.as_str(), order))
    }

    /// The rules as they are now.
    pub fn applied_to(&self, rules: &Rules, now: Utc) -> Rules {
        let mut rules = rules.clone();
        for (input, _) in self.holding(now) {
            if input == SUN {
                rules.sun_altitude_max_deg = None;
            }
            for rule in rules.limits.iter_mut().filter(|rule| rule.input == input) {
                rule.response = Response::Advise;
            }
        }
        rules.stay_closed = self.stay_closed.as_ref().map(|said| format!("{} ordered it: {}", said.from, said.reason));
        rules
    }
}

/// Where the standing orders of a telescope are kept.
pub fn path(config: &config::Observatory) -> PathBuf {
    config.folders.data.join(format!("standing-{}.json", config.place.telescope))
}

/// Writes the standing orders at each change, again and again until the disk takes them.
pub async fn keep_on_disk(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let (mut standing, path) = (room.standing.subscribe(), path(&room.node.config));
    // those of the start came from the disk
    standing.mark_unchanged();
    loop {
        standing.changed().await?;
        loop {
            let (orders, path) = (standing.borrow_and_update().clone(), path.clone());
            let written = tokio::task::spawn_blocking(move || orders.write(&path).map(|()| orders)).await?;
            match written {
                Ok(orders) => {
                    room.standing_on_disk.send_replace(orders);
                    room.node.alerts.clear(AlertKind::StandingOrders, "");
                    break;
                }
                Err(error) => {
                    let cause = format!("the standing orders are not on disk: {error}");
                    room.node.alerts.raise(AlertKind::StandingOrders, "", &cause);
                    tokio::time::sleep(Duration::from_secs(2)).await;
                }
            }
        }
    }
}

/// Keeps an alert for every standing order, so that none is forgotten.
pub async fn keep_reminding(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let mut standing = room.standing.subscribe();
    let mut shown: BTreeSet<(AlertKind, String)> = BTreeSet::new();
    loop {
        let now = room.node.bus.clock().utc();
        let orders = standing.borrow_and_update().clone();
        let mut wanted = BTreeSet::new();
        let mut remind = |kind: AlertKind, instance: &str, cause: String| {
            room.node.alerts.raise(kind, instance, &cause);
            wanted.insert((kind, instance.to_owned()));
        };
        if let Some(said) = &orders.stay_closed {
            let cause = format!("{} ordered to stay closed: {}", said.from, said.reason);
            remind(AlertKind::StayClosed, "", cause);
        }
        for (input, order) in orders.holding(now) {
            let (from, reason) = (&order.said.from, &order.said.reason);
            let cause = format!("{input} is overridden until {} by {from}: {reason}", order.until_utc);
            remind(AlertKind::Override, input, cause);
        }
        for (kind, instance) in shown.difference(&wanted) {
            room.node.alerts.clear(*kind, instance);
        }
        shown = wanted;
        tokio::select! {
            changed = standing.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(5)) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules() -> Rules {
        let text = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\n\
            elevation_m = 0\n[[observingconditions]]\nname = \"wx\"\nserver = \"a:1\"\n\
            limit = [{ parameter = \"Humidity\", upper = 80.0 }, { parameter = \"CloudCover\", upper = 50.0 }]\n";
        Rules::of(&config::parse(text, Path::new("/")).unwrap())
    }

    fn said(reason: &str) -> Said {
        Said { from: "web/ana".to_owned(), reason: reason.to_owned(), at_utc: Utc::from_seconds(1000.0) }
    }

    #[test]
    fn an_override_softens_one_limit_until_it_ends() {
        let mut standing = Standing::default();
        standing.do_without(&rules(), "wx/Humidity", 600.0, said("the sensor is wet")).unwrap();
        let response = |at_s| -> Vec<Response> {
            let rules = standing.applied_to(&rules(), Utc::from_seconds(at_s));
            rules.limits.iter().map(|rule| rule.response).collect()
        };
        assert_eq!(response(1599.0), [Response::Advise, Response::Close]);
        assert_eq!(response(1600.0), [Response::Close, Response::Close]);
        assert_eq!(response(-100_000.0), [Response::Close, Response::Close], "a clock that was put back");
    }

    #[test]
    fn the_sun_can_be_overridden_and_heeded_again() {
        let mut standing = Standing::default();
        standing.do_without(&rules(), SUN, 60.0, said("mirror washing")).unwrap();
        assert_eq!(standing.applied_to(&rules(), Utc::from_seconds(1001.0)).sun_altitude_max_deg, None);
        standing.do_without(&rules(), SUN, 0.0, said("done")).unwrap();
        assert_eq!(standing, Standing::default());
    }

    #[test]
    fn what_cannot_be_overridden_is_refused_with_what_can() {
        let mut standing = Standing::default();
        let mut refused = |input: &str, for_s: f64, reason: &str| {
            standing.do_without(&rules(), input, for_s, said(reason)).unwrap_err()
        };
        assert!(refused("safetymonitor/m", 60.0, "x").contains("wx/Humidity, wx/CloudCover, sun"));
        assert!(refused("wx/Humidity", 60.0, " ").contains("reason"));
        for for_s in [-1.0, f64::NAN, LONGEST_OVERRIDE_S + 1.0] {
            assert!(refused("wx/Humidity", for_s, "x").contains("expected 0"));
        }
    }

    #[test]
    fn of_two_records_the_stricter_holds() {
        let closed = Standing { stay_closed: Some(said("people on the roof")), ..Standing::default() };
        let mut open = Standing::default();
        open.do_without(&rules(), SUN, 60.0, said("washing")).unwrap();
        assert_eq!(closed.clone().stricter(open.clone()), closed);
        assert_eq!(open.clone().stricter(closed.clone()), closed);
        assert_eq!(open.clone().stricter(open.clone()), open);
    }

    #[test]
    fn orders_outlive_a_restart_and_a_broken_file_stays_closed() {
        let folder = tempfile::tempdir().unwrap();
        let (path, now) = (folder.path().join("standing.json"), Utc::from_seconds(2000.0));
        assert_eq!(Standing::read(&path, now), Standing::default());
        let mut standing = Standing { stay_closed: Some(said("people on the roof")), ..Standing::default() };
        standing.do_without(&rules(), "wx/Humidity", 600.0, said("wet")).unwrap();
        standing.write(&path).unwrap();
        assert_eq!(Standing::read(&path, now), standing);
        std::fs::write(&path, "{").unwrap();
        assert!(Standing::read(&path, now).stay_closed.is_some());
    }
}
