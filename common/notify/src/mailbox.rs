//! The messages that are still due to one receiver, and when. Pure: alerts and time come in, letters go out.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use bus::MachineTime;
use contract::observatory::{Alert, AlertEvent, Alerts, Notification, Priority};
use units::Utc;

pub use crate::letter::{Letter, News};

/// The settings of one receiver.
#[derive(Debug, Clone, PartialEq)]
pub struct ReceiverSettings {
    /// Its name in the configuration.
    pub receiver: String,
    /// Less urgent alerts are not sent.
    pub min_priority: Priority,
    /// Only alerts that have been unacknowledged for so long.
    pub after: Duration,
    /// At most so many letters ...
    pub most: usize,
    /// ... in so long; critical ones are counted separately, so that no flood holds one back.
    pub window: Duration,
    /// The alert about this very receiver, which is not sent to it.
    pub own_alert: String,
}

/// A failed letter is tried again after this, then twice as long, up to [`LONGEST_WAIT`].
const FIRST_WAIT: Duration = Duration::from_secs(2);
const LONGEST_WAIT: Duration = Duration::from_secs(300);
/// Nodes notice the same thing within so many seconds of each other, sky time.
const NOTICED_WITHIN_S: f64 = 60.0;
/// Nodes publish every 10 s what they sent, so a node that begins to send knows all of it after this.
const LEARNS_WITHIN: Duration = Duration::from_secs(12);
/// The most events in one digest: receivers refuse messages that are too long.
const MOST_NEWS: usize = 50;

/// One receiver's mailbox.
#[derive(Debug)]
pub struct Mailbox {
    settings: ReceiverSettings,
    /// When it began; none for one that existed from the start.
    began: Option<(MachineTime, Utc)>,
    /// Active alerts that are not acknowledged, and since when.
    unseen: BTreeMap<String, MachineTime>,
    known: BTreeMap<String, Known>,
    /// The events that arrived, also those from nodes that sent before this one, of alerts that are not over.
    notifications: BTreeMap<String, Notification>,
    /// The newest time of any node's event about an alert.
    newest_utc: BTreeMap<String, Utc>,
    waiting: Vec<News>,
    sent: VecDeque<(MachineTime, bool)>,
    held_back: [bool; 2],
    failures: u32,
    not_before: Option<MachineTime>,
}

/// The state of an alert that needs no new letter.
#[derive(Debug)]
struct Known {
    alert: Alert,
    event: AlertEvent,
}

impl Mailbox {
    /// An empty mailbox.
    pub fn new(settings: ReceiverSettings) -> Self {
        Self {
            settings,
            began: None,
            unseen: BTreeMap::new(),
            known: BTreeMap::new(),
            notifications: BTreeMap::new(),
            newest_utc: BTreeMap::new(),
            waiting: Vec::new(),
            sent: VecDeque::new(),
            held_back: [false; 2],
            failures: 0,
            not_before: None,
        }
    }

    /// A mailbox that begins now, where another node may have sent before: for alerts raised until now, it waits for
    /// that node's report.
    pub fn begins(self, now: MachineTime, now_utc: Utc) -> Self {
        Self { began: Some((now, now_utc)), ..self }
    }

    /// Takes the alerts that are active now.
    pub fn look(&mut self, alerts: &Alerts, now: MachineTime) {
        let concerning: Vec<&Alert> = alerts.alerts.iter().filter(|alert| self.concerns(alert)).collect();
        for notification in &alerts.notifications {
            self.learn(notification, alerts);
        }
        let (newest, known) = (&mut self.newest_utc, &self.known);
        newest.retain(|id, _| {
            known.contains_key(id) || alerts.notifications.iter().any(|notification| notification.id == *id)
        });
        self.unseen.retain(|id, _| concerning.iter().any(|alert| alert.id == *id && is_open(alert)));
        let gone: Vec<String> =
            self.known.keys().filter(|id| concerning.iter().all(|alert| alert.id != **id)).cloned().collect();
        for id in gone {
            if let Some(known) = self.known.remove(&id) {
                self.add(AlertEvent::Cleared, known.alert);
            }
        }
        for alert in concerning {
            self.consider(alert, now);
        }
    }

    /// Takes another node's report of what it sent to this receiver. Its own reports come back too, and are recognized
    /// by their time.
    fn learn(&mut self, notification: &Notification, alerts: &Alerts) {
        let newest = self.newest_utc.get(&notification.id).copied();
        if notification.receiver != self.settings.receiver
            || newest.is_some_and(|newest| newest >= notification.sent_utc)
        {
            return;
        }
        self.newest_utc.insert(notification.id.clone(), notification.sent_utc);
        let is_same = |alert: &&Alert| alert.id == notification.id && is_of_one_time(alert, notification);
        let Some(alert) = alerts.alerts.iter().find(is_same).filter(|alert| self.concerns(alert)) else { return };
        self.known.insert(notification.id.clone(), Known { alert: alert.clone(), event: notification.event });
        self.notifications.insert(notification.id.clone(), notification.clone());
        self.waiting.retain(|news| news.alert.id != notification.id || news.event != notification.event);
    }

    fn concerns(&self, alert: &Alert) -> bool {
        alert.priority <= self.settings.min_priority && alert.id != self.settings.own_alert
    }

    fn consider(&mut self, alert: &Alert, now: MachineTime) {
        let since = if is_open(alert) { Some(*self.unseen.entry(alert.id.clone()).or_insert(now)) } else { None };
        let known = self.known.get(&alert.id).map(|known| known.event);
        let event = match (alert, known) {
            (Alert { shelved_until_utc: Some(_), .. }, _) => {
                // When it is unshelved it is sent anew.
                self.known.remove(&alert.id);
                self.notifications.remove(&alert.id);
                self.waiting.retain(|news| news.alert.id != alert.id);
                return;
            }
            (Alert { acknowledged_by: Some(_), .. }, Some(AlertEvent::Acknowledged) | None) => return,
            (Alert { acknowledged_by: Some(_), .. }, Some(_)) => AlertEvent::Acknowledged,
            (_, None) if self.may_have_been_sent(alert, now) => return,
            (Alert { returned_utc: Some(_), .. }, Some(AlertEvent::Returned)) => return,
            (Alert { returned_utc: Some(_), .. }, Some(_)) => AlertEvent::Returned,
            (_, Some(AlertEvent::Raised)) => return,
            // Also an alert that has cleared: a person must know that it existed.
            (_, _) if since.is_none_or(|since| now.since(since) < self.settings.after) => return,
            (Alert { returned_utc: Some(_), .. }, None) => AlertEvent::Returned,
            (_, _) => AlertEvent::Raised,
        };
        self.known.insert(alert.id.clone(), Known { alert: alert.clone(), event });
        self.add(event, alert.clone());
    }

    /// The alert may be received before the report of the node that sent it.
    fn may_have_been_sent(&self, alert: &Alert, now: MachineTime) -> bool {
        self.began.is_some_and(|(at, utc)| alert.raised_utc <= utc && now.since(at) < LEARNS_WITHIN)
    }

    /// Of one alert only the newest event waits; an alert that was raised and is over before it could be sent is sent
    /// once.
    fn add(&mut self, event: AlertEvent, alert: Alert) {
        if alert.priority == Priority::Critical && event == AlertEvent::Raised {
            // The receiver may be reachable again long before its next turn.
            self.not_before = None;
        }
        self.waiting.retain(|news| news.alert.id != alert.id);
        self.waiting.push(News { event, alert });
        self.waiting.sort_by_key(|news| (news.alert.priority, news.alert.raised_utc));
    }

    /// The letter that is to be sent now.
    pub fn due(&mut self, now: MachineTime) -> Option<Letter> {
        if self.not_before.is_some_and(|at| at > now) {
            return None;
        }
        self.sent.retain(|(at, _)| now.since(*at) < self.settings.window);
        [true, false].into_iter().find_map(|critical| self.due_of(critical))
    }

    fn due_of(&mut self, critical: bool) -> Option<Letter> {
        let of_class = |news: &&News| (news.alert.priority == Priority::Critical) == critical;
        let waiting: Vec<News> = self.waiting.iter().filter(of_class).cloned().collect();
        if waiting.is_empty() {
            return None;
        }
        if self.sent.iter().filter(|(_, was)| *was == critical).count() >= self.settings.most {
            self.held_back[usize::from(critical)] = true;
            return None;
        }
        let count = if self.held_back[usize::from(critical)] { MOST_NEWS } else { 1 };
        Some(Letter { news: waiting.into_iter().take(count).collect() })
    }

    /// The letter arrived, at this sky time.
    pub fn sent(&mut self, letter: &Letter, now: MachineTime, sent_utc: Utc) {
        self.waiting.retain(|news| !letter.news.contains(news));
        for News { event, alert } in &letter.news {
            self.note(*event, alert, sent_utc);
        }
        if let Some(first) = letter.news.first() {
            let critical = first.alert.priority == Priority::Critical;
            self.sent.push_back((now, critical));
            let left = self.waiting.iter().any(|news| (news.alert.priority == Priority::Critical) == critical);
            self.held_back[usize::from(critical)] &= left;
        }
        (self.failures, self.not_before) = (0, None);
    }

    fn note(&mut self, event: AlertEvent, alert: &Alert, sent_utc: Utc) {
        let Alert { id, raised_utc, .. } = alert;
        let newest = self.newest_utc.entry(id.clone()).or_insert(sent_utc);
        // Another node's clock may be ahead.
        *newest = sent_utc.max(*newest);
        if event == AlertEvent::Cleared {
            self.notifications.remove(id);
            return;
        }
        let receiver = self.settings.receiver.clone();
        let notification = Notification { receiver, id: id.clone(), raised_utc: *raised_utc, event, sent_utc };
        self.notifications.insert(id.clone(), notification);
    }

    /// The events of alerts that are not over which this receiver got.
    pub fn notifications(&self) -> Vec<Notification> {
        self.notifications.values().cloned().collect()
    }

    /// The letter did not arrive; returns how often in a row.
    pub fn failed(&mut self, now: MachineTime) -> u32 {
        let wait = FIRST_WAIT.saturating_mul(1 << self.failures.min(10)).min(LONGEST_WAIT);
        self.failures += 1;
        self.not_before = Some(now.plus(wait));
        self.failures
    }
}

/// Two nodes that notice the same thing publish it some seconds apart, and a node that receives both stores the first
/// one. An alert that was raised after people were informed is news.
fn is_of_one_time(alert: &Alert, notification: &Notification) -> bool {
    let apart_s = alert.raised_utc.seconds_since(notification.raised_utc).abs();
    apart_s <= NOTICED_WITHIN_S && (apart_s == 0.0 || alert.raised_utc <= notification.sent_utc)
}

/// Nobody has acknowledged it, and nobody has shelved it.
fn is_open(alert: &Alert) -> bool {
    alert.acknowledged_by.is_none() && alert.shelved_until_utc.is_none()
}

#[cfg(test)]
mod tests;
