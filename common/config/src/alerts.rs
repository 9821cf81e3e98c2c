//! `[alerts]`: the receivers of alerts, and the ways to them.

use std::path::PathBuf;

use contract::Role;
use contract::observatory::Priority;
use serde::Deserialize;

/// `[alerts]`: the receivers of alerts, and the ways to them. Nobody receives any where it is absent.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Alerting {
    /// URLs that get a POST with JSON.
    pub webhook: Vec<Webhook>,
    /// The mail server.
    pub smtp: Option<Smtp>,
    /// The receivers of e-mail.
    pub email: Vec<Email>,
    /// URL that is asked while all is well, so that silence is noticed there.
    pub ping: Option<Ping>,
    /// Address of the pages, such as `https://telescopes.example.org`; messages then lead to the telescope's page.
    pub page: Option<String>,
    /// PEM file with certificates of the site's own authorities, trusted in addition to those of the host.
    pub ca_file: Option<PathBuf>,
    /// A receiver gets at most so many messages, critical and other ones counted apart ...
    pub flood_messages: u32,
    /// ... in so many minutes, machine time; what waits then comes as one digest.
    pub flood_minutes: f64,
    /// Another node sends when no observatory node has published for so long, machine s; nobody does where it is 0.
    pub send_when_observatory_silent_s: f64,
    /// Which role sends then, `archive` or `web`; the other one where it is silent too.
    pub stand_in: Role,
}

impl Default for Alerting {
    fn default() -> Self {
        Self {
            webhook: Vec::new(),
            smtp: None,
            email: Vec::new(),
            ping: None,
            page: None,
            ca_file: None,
            flood_messages: 10,
            flood_minutes: 10.0,
            send_when_observatory_silent_s: 20.0,
            stand_in: Role::Archive,
        }
    }
}

/// `[[alerts.webhook]]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Webhook {
    /// How it is called in alerts about it; never shows the URL, which may be a secret.
    pub name: String,
    /// `http://` or `https://`.
    pub url: String,
    /// What it is sent.
    #[serde(default)]
    pub format: Format,
    /// File that holds a bearer token.
    pub token_file: Option<PathBuf>,
    /// Environment variable that holds a bearer token.
    pub token_env: Option<String>,
    /// Nothing less urgent than this.
    #[serde(default = "high")]
    pub min_priority: Priority,
    /// Only what nobody has acknowledged for so many minutes, machine time: 0 for the first receivers, more for
    /// those that an alert is escalated to.
    #[serde(default)]
    pub after_min: f64,
}

/// What a webhook is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// The alerts as JSON, with a text that chat services show.
    #[default]
    Json,
    /// A message of [ntfy](https://docs.ntfy.sh/publish/#publish-as-json), which telephones show; the URL ends with the topic.
    Ntfy,
}

impl Webhook {
    /// The server and the topic of a URL such as `https://ntfy.sh/callisto-4f8a`, for ntfy.
    pub fn topic(&self) -> Option<(&str, &str)> {
        let (server, topic) = self.url.trim_end_matches('/').rsplit_once('/')?;
        let is_topic = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let is_whole = server.contains("://") && !server.ends_with('/') && topic.chars().all(is_topic);
        (is_whole && (1..=64).contains(&topic.len())).then_some((server, topic))
    }
}

/// `[alerts.smtp]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Smtp {
    /// Host name.
    pub server: String,
    /// TCP port; 587 for STARTTLS, 465 for TLS, 25 without, where absent.
    pub port: Option<u16>,
    /// How the way there is protected.
    #[serde(default)]
    pub security: Security,
    /// Name to log in with; no login where absent.
    pub user: Option<String>,
    /// File that holds the password.
    pub password_file: Option<PathBuf>,
    /// Environment variable that holds the password.
    pub password_env: Option<String>,
    /// Sender, such as `Callisto <callisto@example.org>`.
    pub from: String,
}

/// How the way to a mail server is protected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Security {
    /// Begins in the open, and goes on only encrypted.
    #[default]
    Starttls,
    /// Encrypted from the first byte.
    Tls,
    /// In the open: for a mail server on this host.
    None,
}

/// `[[alerts.email]]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Email {
    /// How it is called in alerts about it.
    pub name: String,
    /// Addresses.
    pub to: Vec<String>,
    /// Nothing less urgent than this.
    #[serde(default = "high")]
    pub min_priority: Priority,
    /// Only what nobody has acknowledged for so many minutes, machine time: 0 for the first receivers, more for
    /// those that an alert is escalated to.
    #[serde(default)]
    pub after_min: f64,
}

/// `[alerts.ping]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ping {
    /// `http://` or `https://`, asked with GET.
    pub url: String,
    /// How often, machine s.
    #[serde(default = "a_minute")]
    pub period_s: f64,
}

fn high() -> Priority {
    Priority::High
}

fn a_minute() -> f64 {
    60.0
}

impl Alerting {
    /// What is wrong with it: the value it is about, and what was expected.
    pub(crate) fn faults(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        let mut add = |quoted: &str, message: String| found.push((quoted.to_owned(), message));
        let urls = self.webhook.iter().map(|hook| ("alerts.webhook.url", &hook.url));
        let urls = urls.chain(self.ping.iter().map(|ping| ("alerts.ping.url", &ping.url)));
        for (key, url) in urls.chain(self.page.iter().map(|page| ("alerts.page", page))) {
            let host = url.strip_prefix("https://").or_else(|| url.strip_prefix("http://"));
            if host.is_none_or(|host| host.is_empty() || host.contains(char::is_whitespace)) {
                add(url, format!("{key}: expected http://... or https://..."));
            }
        }
        for hook in self.webhook.iter().filter(|hook| hook.format == Format::Ntfy && hook.topic().is_none()) {
            let expected =
                "expected a server and a topic of letters, digits, - and _, such as https://ntfy.sh/callisto-4f8a";
            add(&hook.url, format!("alerts.webhook.url of \"{}\", format = \"ntfy\": {expected}", hook.name));
        }
        let names = self.webhook.iter().map(|hook| &hook.name).chain(self.email.iter().map(|email| &email.name));
        let mut seen = std::collections::BTreeSet::new();
        for name in names {
            if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-') {
                add(name, format!("alerts: name = \"{name}\": expected letters, digits and -"));
            }
            if !seen.insert(name) || name == "ping" {
                add(
                    name,
                    format!("alerts: two receivers are named \"{name}\"; names must be unique, and \"ping\" is taken"),
                );
            }
        }
        let waits = self.webhook.iter().map(|hook| (&hook.name, hook.after_min));
        for (name, after_min) in waits.chain(self.email.iter().map(|email| (&email.name, email.after_min))) {
            if !(0.0..=1440.0).contains(&after_min) {
                add(name, format!("alerts \"{name}\": after_min = {after_min}: expected 0 to 1440"));
            }
        }
        for email in &self.email {
            if email.to.is_empty() || email.to.iter().any(|to| !to.contains('@')) {
                add(
                    &email.name,
                    format!("alerts.email \"{}\": to: expected addresses such as \"a@b.org\"", email.name),
                );
            }
        }
        match &self.smtp {
            None if !self.email.is_empty() => {
                add("", "alerts.email needs a mail server: add [alerts.smtp] with server and from".to_owned());
            }
            Some(smtp) if !smtp.from.contains('@') => {
                add(&smtp.from, format!("alerts.smtp.from = \"{}\": expected an address", smtp.from));
            }
            Some(Smtp { user: Some(user), password_file: None, password_env: None, .. }) => {
                add(user, "alerts.smtp.user needs a password_file or password_env".to_owned());
            }
            Some(Smtp { user: Some(_), security: Security::None, server, .. }) if !is_this_host(server) => {
                let message = "alerts.smtp: security = \"none\" would send the password in the open: expected \
                    \"starttls\" or \"tls\", or a server on this host such as \"localhost\"";
                add(server, message.to_owned());
            }
            _ => {}
        }
        if !(1.0..=86400.0).contains(&self.ping.as_ref().map_or(60.0, |ping| ping.period_s)) {
            add("", "alerts.ping.period_s: expected 1 to 86400 s".to_owned());
        }
        if self.flood_messages == 0 {
            add("", "alerts.flood_messages = 0: expected 1 or more".to_owned());
        }
        if !(self.flood_minutes > 0.0 && self.flood_minutes <= 1440.0) {
            add("", format!("alerts.flood_minutes = {}: expected more than 0 to 1440", self.flood_minutes));
        }
        let silent_s = self.send_when_observatory_silent_s;
        if silent_s != 0.0 && !(20.0..=86400.0).contains(&silent_s) {
            let what = "expected 20 to 86400 s, or 0 so that nobody sends in its place";
            add("", format!("alerts.send_when_observatory_silent_s = {silent_s}: {what}"));
        }
        if !matches!(self.stand_in, Role::Archive | Role::Web) {
            add("", "alerts.stand_in: expected \"archive\" or \"web\"".to_owned());
        }
        found
    }
}

/// What is sent there leaves no wire.
fn is_this_host(server: &str) -> bool {
    server == "localhost" || server.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    const PLACE: &str = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\n\
        elevation_m = 0\n";

    fn faults(text: &str) -> String {
        crate::parse(&format!("{PLACE}{text}"), Path::new("/etc/starmesh")).unwrap_err().to_string()
    }

    #[test]
    fn receivers_are_read_and_secrets_lie_next_to_the_file() {
        let text = "[alerts]\nca_file = \"ca.pem\"\n[[alerts.webhook]]\nname = \"chat\"\nurl = \"https://chat.example.org/x\"\ntoken_file = \"token\"\n\
            [alerts.smtp]\nserver = \"mail\"\nfrom = \"t@example.org\"\nuser = \"t\"\npassword_file = \"/run/secret\"\n\
            [[alerts.email]]\nname = \"chief\"\nto = [\"c@example.org\"]\nafter_min = 15\nmin_priority = \"critical\"\n";
        let alerts = crate::parse(&format!("{PLACE}{text}"), Path::new("/etc/starmesh")).unwrap().alerts;
        assert_eq!(alerts.webhook[0].token_file.as_deref(), Some(Path::new("/etc/starmesh/token")));
        assert_eq!(alerts.ca_file.as_deref(), Some(Path::new("/etc/starmesh/ca.pem")));
        assert_eq!(alerts.smtp.unwrap().password_file.as_deref(), Some(Path::new("/run/secret")));
        assert_eq!(alerts.email[0].after_min, 15.0);
    }

    #[test]
    fn without_a_word_about_it_another_node_sends_after_twenty_seconds_and_a_zero_switches_that_off() {
        let silent_s = |text: &str| {
            crate::parse(&format!("{PLACE}{text}"), Path::new("/")).unwrap().alerts.send_when_observatory_silent_s
        };
        assert_eq!([silent_s(""), silent_s("[alerts]\n")], [20.0, 20.0]);
        assert_eq!(silent_s("[alerts]\nsend_when_observatory_silent_s = 0\n"), 0.0);
    }

    #[test]
    fn the_example_for_operators_is_taken() {
        let page = include_str!("../../../docs/operator/alerts.md").replace("\r\n", "\n");
        let (_, rest) = page.split_once("```toml\n").unwrap();
        let (example, _) = rest.split_once("```").unwrap();
        let alerts = crate::parse(&format!("{PLACE}{example}"), Path::new("/")).unwrap().alerts;
        assert_eq!((alerts.webhook.len(), alerts.email.len(), alerts.flood_messages), (2, 2, 10));
    }

    #[test]
    fn what_cannot_be_is_refused_with_its_line() {
        let hook = |rest: &str| faults(&format!("[[alerts.webhook]]\nname = \"chat\"\n{rest}\n"));
        let cases = [
            (hook("url = \"chat.example.org\""), "line 9: alerts.webhook.url: expected http://"),
            (
                hook("url = \"https://ntfy.sh/\"\nformat = \"ntfy\""),
                "line 9: alerts.webhook.url of \"chat\", format = \"ntfy\": expected a server and a topic",
            ),
            (hook("url = \"https://ntfy.sh/a b\"\nformat = \"ntfy\""), "a server and a topic"),
            (hook("url = \"http://x/y\"\nformat = \"xml\""), "ntfy"),
            (faults("[alerts]\npage = \"telescopes\"\n"), "alerts.page: expected http://"),
            (hook("url = \"http://x\"\nafter_min = -1"), "line 8: alerts \"chat\": after_min = -1"),
            (hook("url = \"http://x\"\ntoken = \"secret\""), "there is no key \"token\" in [[alerts.webhook]]"),
            (
                hook("url = \"http://x\"\n[[alerts.webhook]]\nname = \"chat\"\nurl = \"http://y\""),
                "names must be unique",
            ),
            (faults("[[alerts.email]]\nname = \"a\"\nto = [\"a@b\"]\n"), "add [alerts.smtp]"),
            (
                faults("[alerts.smtp]\nserver = \"m\"\nfrom = \"a@b\"\nuser = \"u\"\n"),
                "line 10: alerts.smtp.user needs",
            ),
            (
                faults(
                    "[alerts.smtp]\nserver = \"m\"\nsecurity = \"none\"\nfrom = \"a@b\"\nuser = \"u\"\n\
                     password_env = \"P\"\n",
                ),
                "line 8: alerts.smtp: security = \"none\" would send the password in the open",
            ),
            (faults("[alerts]\nflood_messages = 0\n"), "expected 1 or more"),
            (faults("[alerts]\nsend_when_observatory_silent_s = 10\n"), "expected 20 to 86400 s, or 0"),
            (faults("[alerts]\nstand_in = \"device\"\n"), "expected \"archive\" or \"web\""),
            (faults("[alerts.ping]\nurl = \"http://x\"\nperiod_s = 0\n"), "expected 1 to 86400 s"),
        ];
        for (message, wanted) in cases {
            assert!(message.contains(wanted), "{wanted:?} is not in {message:?}");
        }
    }
}
