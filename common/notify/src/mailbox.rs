//! What one receiver is still to be told, and when. Pure: alerts and time come in, letters go out.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use bus::MachineTime;
use contract::observatory::{Alert, Alerts, Priority};

pub use crate::letter::{Event, Letter, News};

/// What one receiver wants.
#[derive(Debug, Clone, PartialEq)]
pub struct Wish {
    /// Nothing less urgent.
    pub min_priority: Priority,
    /// Only what has stood unacknowledged for so long.
    pub after: Duration,
    /// At most so many letters ...
    pub most: usize,
    /// ... in so long; critical ones are counted apart, so that no flood holds one back.
    pub window: Duration,
    /// The alert about this very receiver, of which it is not told.
    pub own_alert: String,
}

/// A failed letter is tried again after this, then twice as long, up to [`LONGEST_WAIT`].
const FIRST_WAIT: Duration = Duration::from_secs(2);
const LONGEST_WAIT: Duration = Duration::from_secs(300);

/// One receiver's mailbox.
#[derive(Debug)]
pub struct Mailbox {
    wish: Wish,
    /// Alerts that stand unacknowledged, and since when they do.
    unseen: BTreeMap<String, MachineTime>,
    told: BTreeMap<String, Told>,
    waiting: Vec<News>,
    sent: VecDeque<(MachineTime, bool)>,
    held_back: [bool; 2],
    failures: u32,
    not_before: Option<MachineTime>,
}

#[derive(Debug)]
struct Told {
    alert: Alert,
    event: Event,
}

impl Mailbox {
    /// An empty one.
    pub fn new(wish: Wish) -> Self {
        Self {
            wish,
            unseen: BTreeMap::new(),
            told: BTreeMap::new(),
            waiting: Vec::new(),
            sent: VecDeque::new(),
            held_back: [false; 2],
            failures: 0,
            not_before: None,
        }
    }

    /// Takes the alerts as they stand now.
    pub fn look(&mut self, alerts: &Alerts, now: MachineTime) {
        let wished: Vec<&Alert> = alerts.alerts.iter().filter(|alert| self.concerns(alert)).collect();
        self.unseen.retain(|id, _| wished.iter().any(|alert| alert.id == *id && is_open(alert)));
        let gone: Vec<String> =
            self.told.keys().filter(|id| wished.iter().all(|alert| alert.id != **id)).cloned().collect();
        for id in gone {
            if let Some(told) = self.told.remove(&id) {
                self.add(Event::Cleared, told.alert);
            }
        }
        for alert in wished {
            self.consider(alert, now);
        }
    }

    fn concerns(&self, alert: &Alert) -> bool {
        alert.priority <= self.wish.min_priority && alert.id != self.wish.own_alert
    }

    fn consider(&mut self, alert: &Alert, now: MachineTime) {
        let since = if is_open(alert) { Some(*self.unseen.entry(alert.id.clone()).or_insert(now)) } else { None };
        let told = self.told.get(&alert.id).map(|told| told.event);
        let event = match (alert, told) {
            (Alert { shelved_until_utc: Some(_), .. }, _) => {
                // when it comes from the shelf it is told anew
                self.told.remove(&alert.id);
                self.waiting.retain(|news| news.alert.id != alert.id);
                return;
            }
            (Alert { acknowledged_by: Some(_), .. }, Some(Event::Acknowledged) | None) => return,
            (Alert { acknowledged_by: Some(_), .. }, Some(_)) => Event::Acknowledged,
            (Alert { returned_utc: Some(_), .. }, Some(Event::Returned)) => return,
            (Alert { returned_utc: Some(_), .. }, Some(_)) => Event::Returned,
            (_, Some(Event::Raised)) => return,
            // also one that has returned: somebody must know that it was there
            (_, _) if since.is_none_or(|since| now.since(since) < self.wish.after) => return,
            (Alert { returned_utc: Some(_), .. }, None) => Event::Returned,
            (_, _) => Event::Raised,
        };
        let told = Told { alert: alert.clone(), event };
        self.told.insert(alert.id.clone(), told);
        self.add(event, alert.clone());
    }

    /// Of one alert only the newest event waits; one that was raised and is over before it could be told is told once.
    fn add(&mut self, event: Event, alert: Alert) {
        self.waiting.retain(|news| news.alert.id != alert.id);
        self.waiting.push(News { event, alert });
        self.waiting.sort_by_key(|news| (news.alert.priority, news.alert.raised_utc));
    }

    /// What is to be sent now.
    pub fn due(&mut self, now: MachineTime) -> Option<Letter> {
        if self.not_before.is_some_and(|at| at > now) {
            return None;
        }
        self.sent.retain(|(at, _)| now.since(*at) < self.wish.window);
        [true, false].into_iter().find_map(|critical| self.due_of(critical))
    }

    fn due_of(&mut self, critical: bool) -> Option<Letter> {
        let of_class = |news: &&News| (news.alert.priority == Priority::Critical) == critical;
        let waiting: Vec<News> = self.waiting.iter().filter(of_class).cloned().collect();
        if waiting.is_empty() {
            return None;
        }
        if self.sent.iter().filter(|(_, was)| *was == critical).count() >= self.wish.most {
            self.held_back[usize::from(critical)] = true;
            return None;
        }
        let count = if self.held_back[usize::from(critical)] { waiting.len() } else { 1 };
        Some(Letter { news: waiting.into_iter().take(count).collect() })
    }

    /// It arrived.
    pub fn sent(&mut self, letter: &Letter, now: MachineTime) {
        self.waiting.retain(|news| !letter.news.contains(news));
        if let Some(first) = letter.news.first() {
            let critical = first.alert.priority == Priority::Critical;
            self.sent.push_back((now, critical));
            self.held_back[usize::from(critical)] = false;
        }
        (self.failures, self.not_before) = (0, None);
    }

    /// It did not; returns how often in a row.
    pub fn failed(&mut self, now: MachineTime) -> u32 {
        let wait = FIRST_WAIT.saturating_mul(1 << self.failures.min(10)).min(LONGEST_WAIT);
        self.failures += 1;
        self.not_before = Some(now.plus(wait));
        self.failures
    }
}

/// Nobody sees to it, and nobody wishes not to be told.
fn is_open(alert: &Alert) -> bool {
    alert.acknowledged_by.is_none() && alert.shelved_until_utc.is_none()
}

#[cfg(test)]
mod tests {
    use contract::observatory::AlertKind;
    use units::Utc;

    use super::*;

    fn at(seconds: f64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs_f64(1000.0 + seconds))
    }

    fn wish(after_s: u64) -> Wish {
        Wish {
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

    /// Shows the mailbox one list after another, a second apart, and tells what it sends; `!` fails a letter.
    fn letters(wish: Wish, lists: Vec<Vec<Alert>>) -> Vec<String> {
        let mut mailbox = Mailbox::new(wish);
        let mut told = Vec::new();
        for (second, alerts) in lists.into_iter().enumerate() {
            let now = at(second as f64);
            mailbox.look(&Alerts { alerts }, now);
            while let Some(letter) = mailbox.due(now) {
                mailbox.sent(&letter, now);
                let words: Vec<String> =
                    letter.news.iter().map(|news| format!("{} {}", news.event.word(), news.alert.id)).collect();
                told.push(format!("{second}: {}", words.join(", ")));
            }
        }
        told
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
    type Story = (&'static str, u64, Vec<Vec<Alert>>, Vec<&'static str>);

    #[test]
    fn each_event_is_told_once_and_to_whom_it_concerns() {
        let (d, mild) = (critical("d"), AlertKind::CoolingFailed.alert("c", Utc::EPOCH, "c"));
        let own = AlertKind::AlertNotSent.alert("me", Utc::EPOCH, "c");
        let other = AlertKind::AlertNotSent.alert("you", Utc::EPOCH, "c");
        let stories: Vec<Story> = vec![
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
        for (name, after_s, lists, wanted) in stories {
            assert_eq!(letters(wish(after_s), lists), wanted, "{name}");
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
        assert_eq!(letters(Wish { most: 2, ..wish(0) }, lists), wanted);
    }

    #[test]
    fn what_failed_is_tried_again_later_and_later_and_not_lost() {
        let mut mailbox = Mailbox::new(wish(0));
        mailbox.look(&Alerts { alerts: vec![critical("d")] }, at(0.0));
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
        // over before it could be told: told all the same
        mailbox.look(&Alerts::default(), at(now + 300.0));
        let over = mailbox.due(at(now + 300.0)).unwrap();
        assert_eq!((letter.news[0].event, over.news[0].event), (Event::Raised, Event::Cleared));
        mailbox.sent(&over, at(now + 300.0));
        assert_eq!(mailbox.due(at(now + 301.0)), None);
    }
}
