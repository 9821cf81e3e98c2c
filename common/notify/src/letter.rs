//! The text that a person gets.

use std::fmt::Write as _;

use contract::observatory::{Alert, AlertEvent, AlertKind, Priority};
use contract::{Address, printable};
use serde_json::{Value, json};
use units::Utc;

/// Chat services and mail servers refuse messages that are too long.
const MOST_IN_FULL: usize = 20;
const MOST_CHARS: usize = 1000;
/// ntfy makes a file of a message of more bytes than 4,096.
const MOST_BYTES_NTFY: usize = 3500;

/// The parts of a message to a browser, which has at most some 3,900 bytes: in JSON a character can take two.
const MOST_BYTES_TITLE: usize = 200;
const MOST_BYTES_PART: usize = 500;

/// What a test message has in the place of an alert's id.
const TEST: &str = "test-message";

/// One event of one alert.
#[derive(Debug, Clone, PartialEq)]
pub struct News {
    /// The event.
    pub event: AlertEvent,
    /// The alert.
    pub alert: Alert,
}

/// A message to a browser.
#[derive(Debug, Clone, PartialEq)]
pub struct Push {
    /// What the service worker of the page shows.
    pub content: Value,
    /// A later message with the same tag takes the place of this one.
    pub tag: String,
    /// It should wake a device that saves power.
    pub is_urgent: bool,
}

/// One message: one event, or all that gathered while a flood was held back.
#[derive(Debug, Clone, PartialEq)]
pub struct Letter {
    /// The most urgent first.
    pub news: Vec<News>,
}

impl Letter {
    /// A message that only tests whether it arrives, as loud as an alert that somebody must see tonight.
    pub fn test(by: &str, now: Utc) -> Self {
        Self::trial(&format!("{by} tests whether messages arrive here."), now)
    }

    /// The same with other words.
    pub fn trial(cause: &str, now: Utc) -> Self {
        let alert = Alert {
            id: TEST.to_owned(),
            priority: Priority::High,
            consequence: "Nothing is wrong.".to_owned(),
            action: "Nothing: it has arrived.".to_owned(),
            ..AlertKind::AlertNotSent.alert(TEST, now, cause)
        };
        Self { news: vec![News { event: AlertEvent::Raised, alert }] }
    }

    /// One line that summarizes the letter; a mail's subject.
    pub fn subject(&self, address: &Address) -> String {
        match self.news.as_slice() {
            [one] => {
                // Text of other nodes must not become a line of its own in a mail's head.
                let id = printable(&one.alert.id);
                format!("[{address}] {} {}: {id}", one.alert.priority.word(), one.event.word())
            }
            all => format!("[{address}] {} alerts", all.len()),
        }
    }

    /// The whole text: the most urgent alerts in full, and the rest by their ids.
    /// `page` is the address of the pages.
    pub fn text(&self, address: &Address, page: Option<&str>) -> String {
        let mut text = String::new();
        for News { event, alert } in self.news.iter().take(MOST_IN_FULL) {
            let Alert { id, cause, consequence, action, raised_utc, .. } = alert;
            let (id, cause) = (printable(id), printable(cause));
            let (event_word, urgency) = (event.word(), alert.priority.word());
            let _ = writeln!(text, "{urgency} {event_word}: {id} at {address}\n{}", cut(&cause));
            match event {
                AlertEvent::Raised => {
                    let _ = writeln!(text, "Consequence: {consequence}\nWhat to do: {action}");
                    if id != TEST {
                        let _ = writeln!(text, "Acknowledge: starmesh order {address} ack {id}");
                    }
                }
                AlertEvent::Acknowledged => {
                    let _ = writeln!(text, "by {}", printable(alert.acknowledged_by.as_deref().unwrap_or("somebody")));
                }
                AlertEvent::Returned => text.push_str("Its cause is gone, and nobody has acknowledged it.\n"),
                AlertEvent::Cleared => {}
            }
            let _ = writeln!(text, "Since {}\n", raised_utc.to_second());
        }
        for News { event, alert } in self.news.iter().skip(MOST_IN_FULL) {
            let _ = writeln!(text, "{} {}: {}", alert.priority.word(), event.word(), printable(&alert.id));
        }
        if let Some(page) = page {
            let _ = writeln!(text, "{}", link(page, address));
        }
        text.truncate(text.trim_end().len());
        text
    }

    /// The priority of its most urgent alert.
    fn priority(&self) -> Priority {
        self.news.iter().map(|news| news.alert.priority).min().unwrap_or(Priority::Advisory)
    }

    /// Is something in it not over? What is over disturbs nobody's sleep.
    fn is_bad(&self) -> bool {
        self.news.iter().any(|news| news.event == AlertEvent::Raised)
    }

    /// The content for a topic of ntfy: as urgent as its most urgent alert, and a touch on it opens the telescope's page.
    pub fn ntfy(&self, address: &Address, topic: &str, page: Option<&str>) -> Value {
        let priority = match self.priority() {
            Priority::Critical => 5,
            Priority::High => 4,
            Priority::Medium => 3,
            Priority::Advisory => 2,
        };
        let is_bad = self.is_bad();
        let mut message = json!({
            "topic": topic,
            "title": self.subject(address),
            "message": cut_bytes(&self.text(address, None), MOST_BYTES_NTFY),
            "priority": if is_bad { priority } else { priority.min(3) },
            "tags": [if is_bad { "telescope" } else { "white_check_mark" }],
        });
        if let Some(page) = page {
            message["click"] = json!(link(page, address));
        }
        message
    }

    /// The message for a browser: what a person reads at a glance, and the telescope's page behind it.
    pub fn push(&self, address: &Address) -> Push {
        let part = |text: &str| cut_bytes(&printable(text), MOST_BYTES_PART);
        let (tag, body) = match self.news.as_slice() {
            [News { event, alert }] => {
                let what = match event {
                    AlertEvent::Raised => format!("What to do: {}", alert.action),
                    AlertEvent::Acknowledged => {
                        format!("Acknowledged by {}.", alert.acknowledged_by.as_deref().unwrap_or("somebody"))
                    }
                    AlertEvent::Returned => "Its cause is gone, and nobody has acknowledged it.".to_owned(),
                    AlertEvent::Cleared => "It is over.".to_owned(),
                };
                (alert.id.clone(), format!("{}\n{}", part(&alert.cause), part(&what)))
            }
            all => {
                let line = |News { event, alert }: &News| {
                    format!("{} {}: {}\n", alert.priority.word(), event.word(), printable(&alert.id))
                };
                // Of another digest no event may be lost.
                let first = all.first().map_or("none", |news| &news.alert.id);
                (format!("several/{first}"), cut_bytes(&all.iter().map(line).collect::<String>(), 2 * MOST_BYTES_PART))
            }
        };
        let tag = format!("{address}/{}", cut_bytes(&tag, MOST_BYTES_TITLE));
        let (is_bad, priority) = (self.is_bad(), self.priority());
        let content = json!({
            "title": cut_bytes(&self.subject(address), MOST_BYTES_TITLE),
            "body": body.trim_end(),
            "tag": tag,
            "url": link("", address),
            "silent": !is_bad,
            "stays": is_bad && priority == Priority::Critical,
        });
        Push { content, tag, is_urgent: is_bad && priority <= Priority::High }
    }

    /// The content for a webhook.
    pub fn json(&self, address: &Address, page: Option<&str>) -> Value {
        let news: Vec<Value> =
            self.news.iter().map(|news| json!({"event": news.event.word(), "alert": news.alert})).collect();
        json!({
            "site": address.site,
            "telescope": address.telescope,
            // The field that chat services show.
            "text": format!("{}\n{}", self.subject(address), self.text(address, page)),
            "news": news,
        })
    }
}

/// The telescope's page.
fn link(page: &str, address: &Address) -> String {
    format!("{}/t/{}/{}", page.trim_end_matches('/'), address.site, address.telescope)
}

/// A text of at most so many bytes, and a sign where it goes on.
fn cut_bytes(text: &str, most: usize) -> String {
    let end = text.floor_char_boundary(most);
    format!("{}{}", &text[..end], if end < text.len() { " ..." } else { "" })
}

/// A cause may contain a server's whole answer.
fn cut(cause: &str) -> String {
    match cause.char_indices().nth(MOST_CHARS) {
        Some((end, _)) => format!("{} ...", &cause[..end]),
        None => cause.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn letter(ids: usize, cause: &str) -> Letter {
        let alert = |number| AlertKind::DomeHeld.alert(format_args!("d{number}"), Utc::EPOCH, cause);
        Letter { news: (0..ids).map(|n| News { event: AlertEvent::Raised, alert: alert(n) }).collect() }
    }

    #[test]
    fn a_test_message_is_loud_and_asks_for_nothing() {
        let address = Address::new("s", "t").unwrap();
        let letter = Letter::test("ana", Utc::EPOCH);
        let text = letter.text(&address, Some("https://t.example"));
        assert!(
            text.contains("ana tests whether messages arrive here.") && text.contains("Nothing is wrong."),
            "{text}"
        );
        assert!(!text.contains("starmesh order") && text.ends_with("https://t.example/t/s/t"), "{text}");
        assert_eq!(letter.subject(&address), "[s/t] high raised: test-message");
        assert_eq!(letter.ntfy(&address, "topic", None)["priority"], 4);
    }

    #[test]
    fn a_long_letter_stays_short_and_names_every_alert() {
        let address = Address::new("s", "t").unwrap();
        let text = letter(50, &"\u{e9}".repeat(5000)).text(&address, None);
        assert!(text.chars().count() < 30_000, "{}", text.chars().count());
        assert!((0..50).all(|number| text.contains(&format!("dome-held/d{number}"))), "{text}");
        assert_eq!(text.matches("What to do").count(), 20);
    }

    #[test]
    fn a_message_of_ntfy_is_short_urgent_while_it_is_bad_and_leads_to_the_page() {
        let address = Address::new("s", "t").unwrap();
        let (mut long, mut short) = (letter(50, &"\u{e9}".repeat(5000)), letter(1, "c"));
        let sent = long.ntfy(&address, "night", Some("https://x.org/"));
        assert!(sent["message"].as_str().unwrap().len() <= 3504, "{sent}");
        assert_eq!((&sent["topic"], &sent["priority"]), (&json!("night"), &json!(4)));
        assert_eq!(sent["click"], "https://x.org/t/s/t");
        long.news[7].alert.priority = Priority::Critical;
        assert_eq!(long.ntfy(&address, "night", None)["priority"], 5);
        short.news[0].event = AlertEvent::Cleared;
        let sent = short.ntfy(&address, "night", None);
        assert_eq!((&sent["priority"], sent.get("click")), (&json!(3), None));
        assert!(short.text(&address, Some("https://x.org")).ends_with("\nhttps://x.org/t/s/t"));
    }

    #[test]
    fn a_message_to_a_browser_says_what_to_do_replaces_the_one_before_and_fits_whatever_a_node_publishes() {
        let address = Address::new("s", "t").unwrap();
        let mut short = letter(1, "c");
        let sent = short.push(&address);
        assert_eq!((sent.tag.as_str(), sent.is_urgent), ("s/t/dome-held/d0", true));
        assert_eq!(sent.content["title"], "[s/t] high raised: dome-held/d0");
        assert_eq!((&sent.content["url"], &sent.content["silent"]), (&json!("/t/s/t"), &json!(false)));
        assert!(sent.content["body"].as_str().is_some_and(|body| body.starts_with("c\nWhat to do: ")), "{sent:?}");
        short.news[0].event = AlertEvent::Cleared;
        let over = short.push(&address);
        assert_eq!((&over.tag, over.is_urgent, &over.content["silent"]), (&sent.tag, false, &json!(true)));
        assert_eq!(over.content["body"], "c\nIt is over.");
        short.news[0].alert.priority = Priority::Critical;
        assert_eq!(short.push(&address).content["stays"], false);
        for event in [AlertEvent::Raised, AlertEvent::Acknowledged] {
            let mut long = letter(1, &"\"\u{e9}".repeat(5000));
            (long.news[0].event, long.news[0].alert.id) = (event, "\\".repeat(5000));
            (long.news[0].alert.action, long.news[0].alert.acknowledged_by) =
                ("\"".repeat(5000), Some("\n".repeat(5000)));
            for bytes in [
                long.push(&address).content.to_string().len(),
                letter(50, "\u{1}").push(&address).content.to_string().len(),
            ] {
                assert!(bytes < 3900, "{bytes}");
            }
        }
    }

    #[test]
    fn a_subject_is_one_line_whatever_a_node_publishes() {
        let mut letter = letter(1, "c");
        letter.news[0].alert.id = "x\r\nBcc: all@example.org".to_owned();
        let subject = letter.subject(&Address::new("s", "t").unwrap());
        assert_eq!(subject, "[s/t] high raised: x\\r\\nBcc: all@example.org");
    }
}
