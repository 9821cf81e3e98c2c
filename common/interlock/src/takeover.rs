//! What a node that becomes the commander adopts of the one before it. The operator orders are `safety::take_over`'s.

use std::time::Duration;

use units::{MachineTime, Utc};

/// An order from last night is no order for this one, sky s.
const ORDER_HOLDS_S: f64 = 18.0 * 3600.0;
/// A commander publishes its state each second; one that is older than this does not count as its last.
const LAST_STATE: Duration = Duration::from_secs(60);
/// It publishes its orders each second, and holds the lease until it was silent for 5 s. If its orders were received
/// within this time, it can hardly have accepted others after them; if not, it may have.
const LAST_ORDERS: Duration = Duration::from_secs(10);

/// Are the orders that arrived then the last ones of a commander?
pub fn are_last_orders(arrived: MachineTime, now: MachineTime) -> bool {
    now.since(arrived) <= LAST_ORDERS
}

/// How the robotic switch was ordered last, and when, where that holds.
pub fn last_order(ordered: Option<(Utc, bool)>, now: Utc) -> Option<(Utc, bool)> {
    ordered.filter(|(at, _)| now.seconds_since(*at).abs() < ORDER_HOLDS_S)
}

/// The robotic switch as it was last ordered, else as configured.
pub fn ordered_switch(ordered: Option<(Utc, bool)>, configured: bool, now: Utc) -> bool {
    last_order(ordered, now).map_or(configured, |(_, on)| on)
}

/// The robotic switch of a new commander: as the one before published it last, else `own`. The journal of a commander
/// on another host is not accessible, but its last state is. An order to turn it off that this node knows, given
/// `off_ago`, holds if it is newer than that state.
pub fn switch_after(
    published: Option<(bool, MachineTime)>,
    off_ago: Option<Duration>,
    now: MachineTime,
    own: impl FnOnce() -> bool,
) -> bool {
    match published {
        Some((on, arrived)) if now.since(arrived) <= LAST_STATE => {
            on && off_ago.is_none_or(|ago| ago > now.since(arrived))
        }
        _ => own(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(second: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(second))
    }

    #[test]
    fn the_switch_is_as_the_commander_before_published_it_else_as_ordered_tonight_else_as_configured() {
        let (ordered, tonight) = (Utc::from_seconds(1_000_000.0), Utc::from_seconds(1_050_000.0));
        let tomorrow = Utc::from_seconds(1_090_000.0);
        // Published and how long ago, ordered, turned off here how long ago, configured, at which time; the switch.
        let scenarios = [
            ("nothing is known", None, None, None, true, tonight, true),
            ("ordered tonight", None, Some(false), None, true, tonight, false),
            ("ordered last night", None, Some(false), None, true, tomorrow, true),
            ("the commander before", Some((false, 60)), Some(true), None, true, tonight, false),
            ("it was silent for too long", Some((false, 61)), Some(true), None, true, tonight, true),
            (
                "turned off after the commander before fell silent",
                Some((true, 9)),
                Some(false),
                Some(5000),
                true,
                tonight,
                false,
            ),
            (
                "turned off before it published that it is on",
                Some((true, 9)),
                Some(false),
                Some(9500),
                true,
                tonight,
                true,
            ),
        ];
        for (name, published, order, off_ago_ms, configured, now, expected) in scenarios {
            let published = published.map(|(on, age_s): (bool, u64)| (on, at(1000 - age_s)));
            let own = || ordered_switch(order.map(|on| (ordered, on)), configured, now);
            assert_eq!(
                switch_after(published, off_ago_ms.map(Duration::from_millis), at(1000), own),
                expected,
                "{name}"
            );
        }
    }

    #[test]
    fn orders_are_the_last_ones_for_ten_seconds() {
        assert!(are_last_orders(at(0), at(10)) && !are_last_orders(at(0), at(11)));
    }
}
