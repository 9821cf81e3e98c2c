//! Which operator has the telescope, or the schedule. Closing is everybody's; all else is taken over with a reason.
//!
//! An operator who closes, stops or keeps the telescope closed has it from then on, until somebody starts it again. To
//! loosen what another operator ordered, or to start what another one stopped, a reason is needed; the audit records
//! it.

use contract::observatory::CONTROL_LAPSES_S;
use contract::{Order, OrderKind, Reason, command::operator};
use units::Utc;

use crate::active_orders::ActiveOrders;
use crate::ordered_by::OrderedBy;

/// The effect of an order on which operator has the telescope.
#[derive(Debug, Clone, PartialEq)]
pub struct Weighed {
    /// The operator that it is taken from, with this order's reason.
    pub from: Option<OrderedBy>,
    /// The holder of the telescope then.
    pub then: Then,
}

/// The holder of the telescope after an order was executed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Then {
    /// As before.
    Same,
    /// The person who gave the order.
    Orderer,
    /// The schedule.
    Schedule,
}

/// Why an order is refused, for programs and for people.
pub type Refused = (Reason, String);

/// Weighs an order against who has the telescope; an error names what is missing.
pub fn weigh(order: &Order, orders: &ActiveOrders, is_robotic: bool, now: Utc) -> Result<Weighed, Refused> {
    let then = match &order.kind {
        OrderKind::Close | OrderKind::Robotic(false) | OrderKind::StayClosed(true) => Then::Orderer,
        OrderKind::Robotic(true) => Then::Schedule,
        OrderKind::StayClosed(false) if is_robotic => Then::Schedule,
        OrderKind::StayClosed(false) => Then::Orderer,
        _ => Then::Same,
    };
    let holder = holder(order, orders, now).filter(|held| operator(&held.from) != order.operator()).cloned();
    if loosens(&order.kind) {
        if order.operator().is_empty() {
            let what = "an order needs the name of who gives it: starmesh order ... --operator NAME";
            return Err((Reason::Malformed, what.to_owned()));
        }
        if let Some(held) = &holder
            && order.reason.trim().is_empty()
        {
            let (name, why) =
                (operator(&held.from), if held.reason.is_empty() { "no reason given" } else { &held.reason });
            return Err((
                Reason::NotNow,
                format!(
                    "{name} has the telescope since {} ({why}); to take it over give a reason: --reason \"...\"",
                    held.at_utc.to_second()
                ),
            ));
        }
    }
    let touches = then != Then::Same || loosens(&order.kind);
    Ok(Weighed { from: holder.filter(|_| touches), then })
}

/// Closing, stopping and being stricter never wait for anybody.
fn loosens(kind: &OrderKind) -> bool {
    match kind {
        OrderKind::Robotic(on) => *on,
        OrderKind::StayClosed(on) => !on,
        OrderKind::Override { for_s, .. } => *for_s != 0.0,
        OrderKind::PutSchedule { .. } => true,
        OrderKind::Close
        | OrderKind::ReloadSchedule
        | OrderKind::Acknowledge(_)
        | OrderKind::Shelve { .. }
        | OrderKind::Unshelve(_)
        | OrderKind::Cool { .. }
        | OrderKind::Warm(_)
        | OrderKind::CompleteHeaders { .. }
        // A row opens nothing that the schedule may not open.
        | OrderKind::Skip(_)
        | OrderKind::Repeat(_) => false,
    }
}

/// The operator whose order this one would undo: the one who ordered it to stay closed, else the one who has taken it.
fn holder<'a>(order: &Order, orders: &'a ActiveOrders, now: Utc) -> Option<&'a OrderedBy> {
    let closed = orders.stay_closed.as_ref().filter(|_| order.kind == OrderKind::StayClosed(false));
    // An order that a node gave by itself, or that came under a name without a path, is no operator's order.
    let control = orders.control.as_ref().filter(|held| now.seconds_since(held.at_utc).abs() < CONTROL_LAPSES_S);
    closed.or(control).filter(|held| held.from.contains('/'))
}

/// Remembers who has it after an order was executed.
pub fn keep(orders: &mut ActiveOrders, then: Then, ordered_by: &OrderedBy) {
    match then {
        Then::Same => {}
        Then::Orderer => orders.control = Some(ordered_by.clone()),
        Then::Schedule => orders.control = None,
    }
}

#[cfg(test)]
mod tests {
    use contract::CommandId;

    use super::*;

    fn order(from: &str, kind: OrderKind, reason: &str) -> Order {
        Order { id: CommandId::fresh(), from: from.to_owned(), reason: reason.to_owned(), kind, seen: None }
    }

    fn at(hours: f64) -> Utc {
        Utc::from_seconds(1_000_000.0 + hours * 3600.0)
    }

    fn of_ana() -> ActiveOrders {
        let ordered_by = OrderedBy { from: "cli/ana@pc".to_owned(), reason: "a visitor".to_owned(), at_utc: at(0.0) };
        ActiveOrders { control: Some(ordered_by), ..ActiveOrders::default() }
    }

    #[test]
    fn closing_is_everybodys_and_needs_no_reason() {
        for kind in [OrderKind::Close, OrderKind::Robotic(false), OrderKind::StayClosed(true)] {
            let weighed = weigh(&order("web/ben", kind.clone(), ""), &of_ana(), true, at(1.0)).unwrap();
            assert_eq!(weighed.then, Then::Orderer, "{kind:?}");
            assert_eq!(weighed.from, of_ana().control, "and it is written down whose it was");
        }
    }

    #[test]
    fn what_another_operator_has_is_taken_over_with_a_reason() {
        let put = OrderKind::PutSchedule { text: String::new(), instead_of: None };
        let softer = OrderKind::Override { input: "sun".to_owned(), for_s: 60.0 };
        for kind in [OrderKind::Robotic(true), OrderKind::StayClosed(false), put, softer] {
            let (reason, refused) = weigh(&order("web/ben", kind.clone(), " "), &of_ana(), true, at(1.0)).unwrap_err();
            assert_eq!(reason, Reason::NotNow, "the order itself was right");
            assert!(refused.contains("ana has the telescope") && refused.contains("a visitor"), "{refused}");
            let taken = weigh(&order("web/ben", kind.clone(), "she left"), &of_ana(), true, at(1.0)).unwrap();
            assert_eq!(taken.from, of_ana().control, "{kind:?}");
            // Her own, from anywhere, a day later, and where nobody has it.
            for (from, orders, now) in [
                ("web/ana", of_ana(), at(1.0)),
                ("cli/ana@other", of_ana(), at(1.0)),
                ("web/ben", of_ana(), at(19.0)),
                ("web/ben", ActiveOrders::default(), at(1.0)),
            ] {
                assert_eq!(weigh(&order(from, kind.clone(), ""), &orders, true, now).unwrap().from, None, "{from}");
            }
        }
    }

    #[test]
    fn who_orders_to_open_needs_a_name_and_what_a_node_decided_is_nobodys() {
        assert!(weigh(&order("cli/", OrderKind::Robotic(true), "x"), &ActiveOrders::default(), true, at(0.0)).is_err());
        assert!(weigh(&order("", OrderKind::Close, ""), &ActiveOrders::default(), true, at(0.0)).is_ok());
        let by_node = OrderedBy::by_node("the disk is away".to_owned(), at(0.0));
        let orders = ActiveOrders { stay_closed: Some(by_node), ..ActiveOrders::default() };
        assert!(weigh(&order("cli/ben@pc", OrderKind::StayClosed(false), ""), &orders, true, at(0.0)).is_ok());
    }

    #[test]
    fn starting_gives_the_telescope_back_to_the_schedule() {
        let mut orders = of_ana();
        let weighed = weigh(&order("cli/ana@pc", OrderKind::Robotic(true), ""), &orders, false, at(1.0)).unwrap();
        assert_eq!(weighed, Weighed { from: None, then: Then::Schedule });
        let ben = OrderedBy { from: "web/ben".to_owned(), reason: String::new(), at_utc: at(1.0) };
        keep(&mut orders, Then::Same, &ben);
        assert_eq!(orders, of_ana());
        keep(&mut orders, Then::Orderer, &ben);
        assert_eq!(orders.control, Some(ben.clone()));
        keep(&mut orders, weighed.then, &ben);
        assert_eq!(orders.control, None);
    }
}
