//! The words that a person gets.

use std::fmt::Write as _;

use contract::Address;
use contract::observatory::{Alert, Priority};
use serde_json::{Value, json};

/// What happened to an alert.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// It stands and nobody has acknowledged it.
    Raised,
    /// Somebody sees to it.
    Acknowledged,
    /// Its cause is gone, and nobody had acknowledged it.
    Returned,
    /// It is over.
    Cleared,
}

impl Event {
    /// The event as a word of the messages.
    pub fn word(self) -> &'static str {
        match self {
            Self::Raised => "raised",
            Self::Acknowledged => "acknowledged",
            Self::Returned => "returned",
            Self::Cleared => "cleared",
        }
    }
}

/// One event of one alert.
#[derive(Debug, Clone, PartialEq)]
pub struct News {
    /// What happened.
    pub event: Event,
    /// To what.
    pub alert: Alert,
}

/// What is sent at once: one event, or what gathered while a flood was held back.
#[derive(Debug, Clone, PartialEq)]
pub struct Letter {
    /// The most urgent first.
    pub news: Vec<News>,
}

impl Letter {
    /// One line that says it all; a mail's subject.
    pub fn subject(&self, address: &Address) -> String {
        match self.news.as_slice() {
            [one] => format!("[{address}] {} {}: {}", priority(one.alert.priority), one.event.word(), one.alert.id),
            all => format!("[{address}] {} alerts", all.len()),
        }
    }

    /// The whole text.
    pub fn text(&self, address: &Address) -> String {
        let mut text = String::new();
        for News { event, alert } in &self.news {
            let Alert { id, cause, consequence, action, raised_utc, .. } = alert;
            let (event_word, urgency) = (event.word(), priority(alert.priority));
            let _ = writeln!(text, "{urgency} {event_word}: {id} at {address}\n{cause}");
            match event {
                Event::Raised => {
                    let _ = writeln!(text, "Consequence: {consequence}\nWhat to do: {action}");
                    let _ = writeln!(text, "Acknowledge: starmesh order {address} ack {id}");
                }
                Event::Acknowledged => {
                    let _ = writeln!(text, "by {}", alert.acknowledged_by.as_deref().unwrap_or("somebody"));
                }
                Event::Returned => text.push_str("Its cause is gone, and nobody has acknowledged it.\n"),
                Event::Cleared => {}
            }
            let _ = writeln!(text, "Since {raised_utc}\n");
        }
        text.truncate(text.trim_end().len());
        text
    }

    /// What a webhook gets.
    pub fn json(&self, address: &Address) -> Value {
        let news: Vec<Value> =
            self.news.iter().map(|news| json!({"event": news.event.word(), "alert": news.alert})).collect();
        json!({
            "site": address.site,
            "telescope": address.telescope,
            // the word that chat services show
            "text": format!("{}\n{}", self.subject(address), self.text(address)),
            "news": news,
        })
    }
}

fn priority(priority: Priority) -> &'static str {
    match priority {
        Priority::Critical => "CRITICAL",
        Priority::High => "high",
        Priority::Medium => "medium",
        Priority::Advisory => "advisory",
    }
}
