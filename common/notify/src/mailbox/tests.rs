//! Scenarios of one receiver.

use contract::observatory::AlertKind;

use super::*;

fn at(seconds: f64) -> MachineTime {
    MachineTime::from_boot(Duration::from_secs_f64(1000.0 + seconds))
}

fn settings(after_s: u64) -> ReceiverSettings {
    ReceiverSettings {
        receiver: "me".to_owned(),
        min_priority: Priority::High,
        after: Duration::from_secs(after_s),
        most: 10,
        window: Duration::from_secs(60),
        own_alert: AlertKind::AlertNotSent.id("me"),
    }
}

fn critical(name: &str) -> Alert {
    AlertKind::DomeNotClosed.alert(name, Utc::EPOCH, "c")
}

fn high(name: &str) -> Alert {
    AlertKind::DomeHeld.alert(name, Utc::EPOCH, "c")
}

/// Gives the mailbox one list after another, a second apart, and returns what it sends; `!` fails a letter.
fn letters(settings: ReceiverSettings, lists: Vec<Vec<Alert>>) -> Vec<String> {
    let mut mailbox = Mailbox::new(settings);
    let mut sent = Vec::new();
    for (second, alerts) in lists.into_iter().enumerate() {
        let now = at(second as f64);
        mailbox.look(&Alerts { alerts, notifications: Vec::new() }, now);
        while let Some(letter) = mailbox.due(now) {
            mailbox.sent(&letter, now, Utc::EPOCH);
            let words: Vec<String> =
                letter.news.iter().map(|news| format!("{} {}", news.event.word(), news.alert.id)).collect();
            sent.push(format!("{second}: {}", words.join(", ")));
        }
    }
    sent
}

fn active(alerts: &[Alert]) -> Alerts {
    Alerts { alerts: alerts.to_vec(), notifications: Vec::new() }
}

fn acknowledged(alert: Alert) -> Alert {
    Alert { acknowledged_by: Some("ana".to_owned()), acknowledged_utc: Some(Utc::EPOCH), ..alert }
}

fn shelved(alert: Alert) -> Alert {
    Alert { shelved_until_utc: Some(Utc::EPOCH), ..alert }
}

fn returned(alert: Alert) -> Alert {
    Alert { returned_utc: Some(Utc::EPOCH), ..alert }
}

/// Name, seconds before it is escalated to this receiver, the lists one a second, the letters.
type Scenario = (&'static str, u64, Vec<Vec<Alert>>, Vec<&'static str>);

#[test]
fn each_event_is_sent_once_and_to_the_receivers_it_concerns() {
    let (d, mild) = (critical("d"), AlertKind::CoolingFailed.alert("c", Utc::EPOCH, "c"));
    let own = AlertKind::AlertNotSent.alert("me", Utc::EPOCH, "c");
    let other = AlertKind::AlertNotSent.alert("you", Utc::EPOCH, "c");
    let scenarios: Vec<Scenario> = vec![
        ("at once, and once", 0, vec![vec![d.clone()]; 3], vec!["0: raised dome-not-closed/d"]),
        (
            "its end too",
            0,
            vec![vec![d.clone()], vec![]],
            vec!["0: raised dome-not-closed/d", "1: cleared dome-not-closed/d"],
        ),
        (
            "a return, and its end",
            0,
            vec![vec![d.clone()], vec![returned(d.clone())], vec![]],
            vec!["0: raised dome-not-closed/d", "1: returned dome-not-closed/d", "2: cleared dome-not-closed/d"],
        ),
        (
            "who acknowledged",
            0,
            vec![vec![d.clone()], vec![acknowledged(d.clone())], vec![acknowledged(d.clone())]],
            vec!["0: raised dome-not-closed/d", "1: acknowledged dome-not-closed/d"],
        ),
        ("nothing less urgent", 0, vec![vec![mild]], vec![]),
        ("nothing of itself", 0, vec![vec![own]], vec![]),
        ("but of others", 0, vec![vec![other]], vec!["0: raised alert-not-sent/you"]),
        ("nothing that is shelved", 0, vec![vec![shelved(d.clone())]; 2], vec![]),
        (
            "but when it comes from the shelf, again",
            0,
            vec![vec![d.clone()], vec![shelved(d.clone())], vec![d.clone()]],
            vec!["0: raised dome-not-closed/d", "2: raised dome-not-closed/d"],
        ),
        ("escalated after its time", 2, vec![vec![d.clone()]; 4], vec!["2: raised dome-not-closed/d"]),
        (
            "not when somebody acknowledged",
            2,
            vec![vec![d.clone()], vec![acknowledged(d.clone())], vec![acknowledged(d.clone())], vec![]],
            vec![],
        ),
        ("nor when it is over", 2, vec![vec![d.clone()], vec![d.clone()], vec![], vec![]], vec![]),
        (
            "but when it returned and nobody looked",
            2,
            vec![vec![d.clone()], vec![returned(d.clone())], vec![returned(d)]],
            vec!["2: returned dome-not-closed/d"],
        ),
    ];
    for (name, after_s, lists, wanted) in scenarios {
        assert_eq!(letters(settings(after_s), lists), wanted, "{name}");
    }
}

#[test]
fn a_flood_ends_in_one_digest_and_holds_back_nothing_critical() {
    let flood: Vec<Alert> = ["a", "b", "c", "d", "e"].map(high).to_vec();
    let mut lists = vec![flood.clone(); 3];
    lists.extend(vec![flood.iter().cloned().chain([critical("x")]).collect(); 60]);
    let wanted = [
        "0: raised dome-held/a",
        "0: raised dome-held/b",
        "3: raised dome-not-closed/x",
        "60: raised dome-held/c, raised dome-held/d, raised dome-held/e",
    ];
    assert_eq!(letters(ReceiverSettings { most: 2, ..settings(0) }, lists), wanted);
}

#[test]
fn what_failed_is_tried_again_later_and_later_and_not_lost() {
    let mut mailbox = Mailbox::new(settings(0));
    mailbox.look(&active(&[critical("d")]), at(0.0));
    let mut now = 0.0;
    for (failures, wait_s) in [(1, 2.0), (2, 4.0), (3, 8.0)] {
        assert!(mailbox.due(at(now)).is_some());
        assert_eq!(mailbox.failed(at(now)), failures);
        assert_eq!(mailbox.due(at(now + wait_s - 0.1)), None);
        now += wait_s;
    }
    for _ in 0..20 {
        mailbox.failed(at(now));
    }
    assert!(mailbox.due(at(now + 299.0)).is_none());
    let letter = mailbox.due(at(now + 300.0)).unwrap();
    // Over before it could be sent: it is sent all the same.
    mailbox.look(&Alerts::default(), at(now + 300.0));
    let over = mailbox.due(at(now + 300.0)).unwrap();
    assert_eq!((letter.news[0].event, over.news[0].event), (AlertEvent::Raised, AlertEvent::Cleared));
    mailbox.sent(&over, at(now + 300.0), Utc::EPOCH);
    assert_eq!(mailbox.due(at(now + 301.0)), None);
}

/// All events that a mailbox has ready now, all of which arrive at this sky second.
fn empty(mailbox: &mut Mailbox, now_s: f64) -> Vec<(AlertEvent, String)> {
    let mut events = Vec::new();
    while let Some(letter) = mailbox.due(at(now_s)) {
        mailbox.sent(&letter, at(now_s), Utc::from_seconds(now_s));
        events.extend(letter.news.into_iter().map(|news| (news.event, news.alert.id)));
    }
    events
}

#[test]
fn who_sends_next_goes_on_where_the_last_one_ended() {
    use AlertEvent::{Cleared, Raised, Returned};
    let (old, new) = (critical("old"), critical("new"));
    let mut first = Mailbox::new(settings(0));
    first.look(&active(std::slice::from_ref(&old)), at(0.0));
    assert_eq!(empty(&mut first, 0.0), [(Raised, old.id.clone())]);

    // The second learns what the first has sent.
    let mut second = Mailbox::new(settings(0));
    let list = |alerts: &[Alert], notifications: Vec<Notification>| Alerts { notifications, ..active(alerts) };
    second.look(&list(&[old.clone(), new.clone()], first.notifications()), at(10.0));
    assert_eq!(empty(&mut second, 10.0), [(Raised, new.id.clone())], "only what is new");
    assert_eq!(second.notifications().len(), 2, "and publishes both from now on");
    second.look(&list(&[returned(old.clone()), new.clone()], first.notifications()), at(11.0));
    assert_eq!(empty(&mut second, 11.0), [(Returned, old.id.clone())], "its end is sent by the second");

    // The first runs again and learns what the second has sent; its own old reports come back to it too.
    let mut third = Mailbox::new(settings(0));
    let all = contract::observatory::merge(
        [first.notifications(), second.notifications()].map(|notifications| list(&[], notifications)).into_iter(),
    );
    third.look(&list(&[returned(old.clone()), new.clone()], all.notifications.clone()), at(20.0));
    assert_eq!(empty(&mut third, 20.0), []);
    third.look(&list(std::slice::from_ref(&new), all.notifications.clone()), at(21.0));
    assert_eq!(empty(&mut third, 21.0), [(Cleared, old.id.clone())]);
    third.look(&list(std::slice::from_ref(&new), all.notifications.clone()), at(22.0));
    assert_eq!(empty(&mut third, 22.0), [], "old words of others are no news");

    // An alert that was raised later under the same id is another alert, and other people's mail does not count.
    let again = Alert { raised_utc: Utc::from_seconds(30.0), ..old };
    let mut fourth = Mailbox::new(settings(0));
    fourth.look(&list(std::slice::from_ref(&again), all.notifications.clone()), at(31.0));
    assert_eq!(empty(&mut fourth, 31.0), [(Raised, again.id.clone())]);
    let mut other = Mailbox::new(ReceiverSettings { receiver: "you".to_owned(), ..settings(0) });
    other.look(&list(std::slice::from_ref(&new), all.notifications), at(31.0));
    assert_eq!(empty(&mut other, 31.0), [(Raised, new.id)]);
}

#[test]
fn who_begins_to_send_waits_for_the_word_of_who_sent_before_but_not_with_what_is_new() {
    let raised = |name: &str, second: f64| Alert { raised_utc: Utc::from_seconds(second), ..critical(name) };
    let (old, lost, new) = (raised("old", 90.0), raised("lost", 90.0), raised("new", 101.0));
    let notification = Notification {
        receiver: "me".to_owned(),
        id: old.id.clone(),
        raised_utc: old.raised_utc,
        event: AlertEvent::Raised,
        sent_utc: Utc::from_seconds(95.0),
    };
    let mut mailbox = Mailbox::new(settings(0)).begins(at(100.0), Utc::from_seconds(100.0));
    let all = || active(&[old.clone(), lost.clone(), new.clone()]);
    mailbox.look(&all(), at(101.0));
    let raised = |alert: &Alert| (AlertEvent::Raised, alert.id.clone());
    assert_eq!(empty(&mut mailbox, 101.0), [raised(&new)], "nobody else can have sent it");
    mailbox.look(&Alerts { notifications: vec![notification.clone()], ..all() }, at(105.0));
    assert_eq!(empty(&mut mailbox, 105.0), []);
    mailbox.look(&all(), at(111.9));
    assert_eq!(empty(&mut mailbox, 111.9), []);
    mailbox.look(&all(), at(112.0));
    assert_eq!(empty(&mut mailbox, 112.0), [raised(&lost)], "nobody sent it");
}

#[test]
fn what_two_nodes_noticed_is_sent_once_and_again_when_it_comes_back() {
    let noticed = |second: f64| Alert { raised_utc: Utc::from_seconds(second), ..critical("d") };
    let notification = |second: f64| Notification {
        receiver: "me".to_owned(),
        id: noticed(100.0).id,
        raised_utc: Utc::from_seconds(100.0),
        event: AlertEvent::Raised,
        sent_utc: Utc::from_seconds(second),
    };
    for (raised_s, sent_s, expected) in
        [(100.0, 110.0, 0), (104.0, 110.0, 0), (98.0, 110.0, 0), (111.0, 110.0, 1), (300.0, 310.0, 1)]
    {
        let mut mailbox = Mailbox::new(settings(0));
        mailbox.look(&Alerts { alerts: vec![noticed(raised_s)], notifications: vec![notification(sent_s)] }, at(400.0));
        assert_eq!(empty(&mut mailbox, 400.0).len(), expected, "raised at {raised_s}, sent at {sent_s}");
    }
}

#[test]
fn a_clock_that_is_ahead_elsewhere_makes_nobody_repeat_himself() {
    let alert = critical("d");
    let ahead = Notification {
        receiver: "me".to_owned(),
        id: alert.id.clone(),
        raised_utc: alert.raised_utc,
        event: AlertEvent::Raised,
        sent_utc: Utc::from_seconds(1e6),
    };
    let mut mailbox = Mailbox::new(settings(0));
    let mut sent = 0;
    for second in 0..5 {
        let list = Alerts { alerts: vec![acknowledged(alert.clone())], notifications: vec![ahead.clone()] };
        mailbox.look(&list, at(f64::from(second)));
        sent += empty(&mut mailbox, f64::from(second)).len();
    }
    assert_eq!(sent, 1, "acknowledged, once");
}

#[test]
fn a_shelved_alert_is_sent_anew_though_its_old_notifications_come_back() {
    let alert = critical("d");
    let mut mailbox = Mailbox::new(settings(0));
    let mut sent = Vec::new();
    for (second, shown) in [alert.clone(), shelved(alert.clone()), alert.clone(), alert].into_iter().enumerate() {
        let echo = mailbox.notifications();
        mailbox.look(&Alerts { alerts: vec![shown], notifications: echo }, at(second as f64));
        sent.extend(empty(&mut mailbox, second as f64).iter().map(|_| second));
    }
    assert_eq!(sent, [0, 2]);
}

#[test]
fn a_critical_alert_does_not_wait_for_the_turn_of_a_receiver_that_was_away() {
    let mut mailbox = Mailbox::new(settings(0));
    mailbox.look(&active(&[high("a")]), at(0.0));
    for _ in 0..20 {
        mailbox.failed(at(0.0));
    }
    assert_eq!(mailbox.due(at(10.0)), None);
    mailbox.look(&active(&[high("a"), high("b")]), at(10.0));
    assert_eq!(mailbox.due(at(10.0)), None, "another one waits");
    mailbox.look(&active(&[high("a"), critical("x")]), at(11.0));
    let letter = mailbox.due(at(11.0)).unwrap();
    assert_eq!(letter.news[0].alert.id, critical("x").id);
    mailbox.failed(at(11.0));
    mailbox.look(&active(&[high("a"), critical("x")]), at(12.0));
    assert_eq!(mailbox.due(at(12.0)), None, "and is tried once, not all the time");
}

#[test]
fn a_digest_is_never_longer_than_receivers_take_and_leaves_nothing_out() {
    let flood: Vec<Alert> = (0..120).map(|number| high(&format!("d{number}"))).collect();
    let mut mailbox = Mailbox::new(ReceiverSettings { most: 4, ..settings(0) });
    let (mut sizes, mut sent) = (Vec::new(), std::collections::BTreeSet::new());
    for second in 0..=61 {
        mailbox.look(&active(&flood), at(f64::from(second)));
        while let Some(letter) = mailbox.due(at(f64::from(second))) {
            sizes.push(letter.news.len());
            sent.extend(letter.news.iter().map(|news| news.alert.id.clone()));
            mailbox.sent(&letter, at(f64::from(second)), Utc::EPOCH);
        }
    }
    assert_eq!(sizes, [1, 1, 1, 1, 50, 50, 16]);
    assert_eq!(sent.len(), 120);
}
