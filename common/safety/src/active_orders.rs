//! A person's operator orders about the verdict: stay closed, and do without one limit for a while.
//!
//! They survive a restart of the node and a takeover (`takeover.rs`). Staying closed has no end of its own; an override
//! has, at most eight hours, and only limits and the Sun can be overridden: no safety monitor, no vote.

use std::collections::BTreeMap;

use config::Response;
use contract::observatory::{self, AlertKind, OperatorOrders, Shelved};
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::ordered_by::OrderedBy;
use crate::rules::Rules;

/// The longest that one order can override a limit, sky s.
pub const LONGEST_OVERRIDE_S: f64 = 8.0 * 3600.0;
/// What the Sun is called among the inputs.
pub const SUN: &str = "sun";

/// One limit that is done without.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Override {
    /// Who, why and when.
    #[serde(flatten)]
    pub ordered_by: OrderedBy,
    /// Until when, sky time.
    pub until_utc: Utc,
}

/// The operator orders.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActiveOrders {
    /// Fencing token of the commander that keeps them; absent where there is no arbiter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<u64>,
    /// Nothing opens while this is active.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stay_closed: Option<OrderedBy>,
    /// The operator who has taken the telescope from the schedule.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control: Option<OrderedBy>,
    /// By input. Always written: another file in the place of this one releases nobody's order to stay closed.
    pub overrides: BTreeMap<String, Override>,
}

impl ActiveOrders {
    /// The orders that hold when there are two records: any that keeps it closed, and no override that only one of them
    /// has.
    pub fn stricter(self, other: &Self) -> Self {
        let mut overrides = BTreeMap::new();
        for (input, order) in self.overrides {
            if let Some(known) = other.overrides.get(&input) {
                let ends_first = if known.until_utc < order.until_utc { known.clone() } else { order };
                overrides.insert(input, ends_first);
            }
        }
        let stay_closed = self.stay_closed.or_else(|| other.stay_closed.clone());
        let control = self.control.or_else(|| other.control.clone());
        Self { token: self.token, stay_closed, control, overrides }
    }

    /// Are both the same, whichever commander holds them?
    pub fn has_same_orders(&self, other: &Self) -> bool {
        self.stay_closed == other.stay_closed && self.overrides == other.overrides
    }

    /// As they are published by a node that has this token, with the shelved alerts.
    pub fn published(self, token: Option<u64>, shelved: Vec<Shelved>) -> OperatorOrders {
        let overrides = self.overrides.into_iter().map(|(input, Override { ordered_by, until_utc })| {
            observatory::Override { input, until_utc, ordered: ordered_by.into() }
        });
        OperatorOrders {
            token,
            stay_closed: self.stay_closed.map(Into::into),
            control: self.control.map(Into::into),
            overrides: overrides.collect(),
            shelved,
        }
    }

    /// The alerts that keep each order from being forgotten: kind, instance and cause.
    pub fn reminders(&self, now: Utc) -> Vec<(AlertKind, String, String)> {
        let closed = self.stay_closed.iter().map(|ordered_by| {
            if ordered_by.is_by_node() {
                return (AlertKind::OrdersLost, String::new(), format!("it stays closed: {}", ordered_by.reason));
            }
            let cause = format!("{} ordered to stay closed: {}", ordered_by.from, ordered_by.reason);
            (AlertKind::StayClosed, String::new(), cause)
        });
        let overrides = self.holding(now).map(|(input, order)| {
            let (from, reason) = (&order.ordered_by.from, &order.ordered_by.reason);
            let cause = format!("{input} is overridden until {} by {from}: {reason}", order.until_utc.to_second());
            (AlertKind::Override, input.to_owned(), cause)
        });
        closed.chain(overrides).collect()
    }

    /// Takes an override, or returns why not.
    pub fn do_without(&mut self, rules: &Rules, input: &str, for_s: f64, ordered_by: OrderedBy) -> Result<(), String> {
        let known: Vec<&str> = rules.limits.iter().map(|rule| rule.input.as_str()).chain([SUN]).collect();
        if !known.contains(&input) {
            let why = if input.starts_with("safetymonitor/") {
                "a safety monitor cannot be overridden"
            } else {
                "no limit is called so"
            };
            return Err(format!("\"{input}\": {why}; expected one of {}", known.join(", ")));
        }
        if for_s != 0.0 && ordered_by.reason.trim().is_empty() {
            return Err("an override needs a reason".to_owned());
        }
        if !(0.0..=LONGEST_OVERRIDE_S).contains(&for_s) {
            return Err(format!("for_s = {for_s}: expected 0 (apply it again) to {LONGEST_OVERRIDE_S} s"));
        }
        if for_s == 0.0 {
            self.overrides.remove(input);
        } else {
            let until_utc = ordered_by.at_utc.plus_seconds(for_s);
            self.overrides.insert(input.to_owned(), Override { ordered_by, until_utc });
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

    /// The rules at a time that is not known better: an override that may be over is over.
    pub fn applied_between(&self, rules: &Rules, earliest: Utc, latest: Utc) -> Rules {
        let mut rules = rules.clone();
        let holds_late: Vec<&str> = self.holding(latest).map(|(input, _)| input).collect();
        for (input, _) in self.holding(earliest).filter(|(input, _)| holds_late.contains(input)) {
            if input == SUN {
                rules.sun_altitude_max_deg = None;
            }
            for rule in rules.limits.iter_mut().filter(|rule| rule.input == input) {
                rule.response = Response::Advise;
            }
        }
        rules.stay_closed = self
            .stay_closed
            .as_ref()
            .map(|ordered_by| format!("{} ordered it: {}", ordered_by.from, ordered_by.reason));
        rules
    }
}

impl From<&OperatorOrders> for ActiveOrders {
    fn from(orders: &OperatorOrders) -> Self {
        let overrides = orders.overrides.iter().cloned().map(|observatory::Override { input, until_utc, ordered }| {
            let order = Override { ordered_by: ordered.into(), until_utc };
            (input, order)
        });
        Self {
            token: orders.token,
            stay_closed: orders.stay_closed.clone().map(OrderedBy::from),
            control: orders.control.clone().map(OrderedBy::from),
            overrides: overrides.collect::<BTreeMap<_, _>>(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn rules() -> Rules {
        let text = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\n\
            elevation_m = 0\n[[observingconditions]]\nname = \"wx\"\nserver = \"a:1\"\n\
            limit = [{ parameter = \"Humidity\", upper = 80.0 }, { parameter = \"CloudCover\", upper = 50.0 }]\n";
        Rules::of(&config::parse(text, Path::new("/")).unwrap())
    }

    fn ordered_by(reason: &str) -> OrderedBy {
        OrderedBy { from: "web/ana".to_owned(), reason: reason.to_owned(), at_utc: Utc::from_seconds(1000.0) }
    }

    #[test]
    fn an_override_softens_one_limit_until_it_ends() {
        let mut orders = ActiveOrders::default();
        orders.do_without(&rules(), "wx/Humidity", 600.0, ordered_by("the sensor is wet")).unwrap();
        let response = |at_s| -> Vec<Response> {
            let now = Utc::from_seconds(at_s);
            let rules = orders.applied_between(&rules(), now, now);
            rules.limits.iter().map(|rule| rule.response).collect()
        };
        assert_eq!(response(1599.0), [Response::Advise, Response::Close]);
        assert_eq!(response(1600.0), [Response::Close, Response::Close]);
        assert_eq!(response(-100_000.0), [Response::Close, Response::Close], "a clock that was put back");
    }

    #[test]
    fn an_override_that_may_be_over_is_over() {
        let mut orders = ActiveOrders::default();
        orders.do_without(&rules(), SUN, 600.0, ordered_by("washing")).unwrap();
        let overridden = |early_s, late_s| {
            let (early, late) = (Utc::from_seconds(early_s), Utc::from_seconds(late_s));
            orders.applied_between(&rules(), early, late).sun_altitude_max_deg.is_none()
        };
        assert!(overridden(1000.0, 1599.0) && !overridden(1000.0, 1600.0));
        assert!(!overridden(1000.0 - 9.0 * 3600.0, 1000.0), "it would last longer than any may");
    }

    #[test]
    fn the_sun_can_be_overridden_and_restored() {
        let mut orders = ActiveOrders::default();
        orders.do_without(&rules(), SUN, 60.0, ordered_by("mirror washing")).unwrap();
        let now = Utc::from_seconds(1001.0);
        assert_eq!(orders.applied_between(&rules(), now, now).sun_altitude_max_deg, None);
        orders.do_without(&rules(), SUN, 0.0, ordered_by("done")).unwrap();
        assert_eq!(orders, ActiveOrders::default());
    }

    #[test]
    fn what_cannot_be_overridden_is_refused_with_what_can() {
        let mut orders = ActiveOrders::default();
        let mut refused = |input: &str, for_s: f64, reason: &str| {
            orders.do_without(&rules(), input, for_s, ordered_by(reason)).unwrap_err()
        };
        assert!(refused("safetymonitor/m", 60.0, "x").contains("wx/Humidity, wx/CloudCover, sun"));
        assert!(refused("wx/Humidity", 60.0, " ").contains("reason"));
        for for_s in [-1.0, f64::NAN, LONGEST_OVERRIDE_S + 1.0] {
            assert!(refused("wx/Humidity", for_s, "x").contains("expected 0"));
        }
    }

    #[test]
    fn an_order_has_an_alert_while_it_holds() {
        let mut orders =
            ActiveOrders { stay_closed: Some(ordered_by("people on the roof")), ..ActiveOrders::default() };
        orders.do_without(&rules(), SUN, 60.0, ordered_by("washing")).unwrap();
        let closed =
            (AlertKind::StayClosed, String::new(), "web/ana ordered to stay closed: people on the roof".to_owned());
        let cause = "sun is overridden until 1970-01-01 00:17:40 UTC by web/ana: washing".to_owned();
        let overridden = (AlertKind::Override, SUN.to_owned(), cause);
        assert_eq!(orders.reminders(Utc::from_seconds(1059.0)), [closed.clone(), overridden]);
        assert_eq!(orders.reminders(Utc::from_seconds(1060.0)), [closed]);
        orders.stay_closed = Some(OrderedBy::by_node("what was ordered before is not known".to_owned(), Utc::EPOCH));
        let lost = "it stays closed: what was ordered before is not known".to_owned();
        assert_eq!(orders.reminders(Utc::from_seconds(1060.0)), [(AlertKind::OrdersLost, String::new(), lost)]);
    }

    #[test]
    fn what_is_published_is_what_another_node_adopts() {
        let mut orders = ActiveOrders { control: Some(ordered_by("a visitor")), ..ActiveOrders::default() };
        orders.stay_closed = Some(ordered_by("people on the roof"));
        orders.do_without(&rules(), "wx/Humidity", 60.0, ordered_by("wet")).unwrap();
        let published = orders.clone().published(Some(7), Vec::new());
        assert_eq!(ActiveOrders::from(&published), ActiveOrders { token: Some(7), ..orders });
    }

    #[test]
    fn of_two_records_the_stricter_holds() {
        let closed = ActiveOrders { stay_closed: Some(ordered_by("people on the roof")), ..ActiveOrders::default() };
        let (mut open, mut sooner) = (ActiveOrders::default(), ActiveOrders::default());
        open.do_without(&rules(), SUN, 60.0, ordered_by("washing")).unwrap();
        sooner.do_without(&rules(), SUN, 30.0, ordered_by("washing")).unwrap();
        assert_eq!(closed.clone().stricter(&open), closed);
        assert_eq!(open.clone().stricter(&closed), closed);
        assert_eq!(open.clone().stricter(&open), open);
        assert_eq!(open.clone().stricter(&sooner), sooner);
        assert_eq!(sooner.clone().stricter(&open), sooner);
    }
}
