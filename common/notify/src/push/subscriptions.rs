//! The browsers that have subscribed at this node, and its key, in one file, which is written whole and for its user alone.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::anyhow;
use bus::Clock;
use internet::{Method, StatusCode, header};
use node::{aside, private};
use serde::{Deserialize, Serialize};
use tokio::sync::{Mutex, watch};

use super::signing::SigningKey;
use super::{Endpoint, Subscription};
use crate::http::{Ask, Http};
use crate::letter::Push;

/// Devices of one person.
const MOST_OF_USER: usize = 20;
/// Each is a task, and a mailbox.
const MOST: usize = 200;
/// A push service keeps a message so long for a browser that is away, s: one that comes back in the morning is told what the night was.
const KEPT_S: u32 = 86_400;

/// By their ids.
type Devices = BTreeMap<String, Subscription>;

/// The browsers that have subscribed, and what is sent to them.
pub struct Subscriptions {
    file: PathBuf,
    key: SigningKey,
    known: Arc<watch::Sender<Devices>>,
    /// One change after another.
    /// Held until the disk has answered, whoever has gone meanwhile.
    turn: Arc<Mutex<()>>,
    /// Push services that the site's file names.
    services: Vec<String>,
    /// Whom a push service may ask about this server: an address of it, or of the project.
    contact: String,
}

/// Why a subscription is not taken.
#[derive(Debug)]
pub enum NotTaken {
    /// It is none: what was expected.
    Wrong(String),
    /// There are so many already.
    TooMany(String),
    /// It cannot be written down.
    Disk(io::Error),
}

/// A push service takes no message for this browser, now or later; with its words.
#[derive(Debug)]
pub struct Refused(String);

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Refused {}

/// As in the file.
#[derive(Serialize, Deserialize)]
struct Stored {
    key: String,
    subscriptions: Vec<Subscription>,
}

impl Subscriptions {
    /// Those of a node that stores them in this file. Without one, it has a new key, which is written with the first of them.
    ///
    /// # Errors
    /// This host gives no random numbers.
    pub fn open(file: PathBuf, config: &config::Observatory) -> anyhow::Result<Self> {
        let read = || match std::fs::read(&file) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            bytes => {
                let Stored { key, subscriptions } = serde_json::from_slice(&bytes?)?;
                let known: Devices = subscriptions.into_iter().map(|one| (one.id(), one)).collect();
                anyhow::Ok(Some((SigningKey::read(&key)?, known)))
            }
        };
        let found = read().unwrap_or_else(|error| {
            let now = "Nobody gets alerts on a browser until it is switched on there again.";
            aside::keep_copy(&file, &error.to_string(), now);
            None
        });
        let (key, known) = match found {
            Some(found) => found,
            None => (SigningKey::generate()?, Devices::new()),
        };
        let page = config.alerts.page.clone().filter(|page| page.starts_with("https://"));
        Ok(Self {
            file,
            key,
            known: Arc::new(watch::Sender::new(known)),
            turn: Arc::default(),
            services: config.web.push_services.clone(),
            contact: page.unwrap_or_else(|| env!("CARGO_PKG_REPOSITORY").to_owned()),
        })
    }

    /// What browsers subscribe with, base64url.
    pub fn public_key(&self) -> String {
        self.key.public()
    }

    /// All of them by their ids, as a value that can be followed.
    pub fn watch(&self) -> watch::Receiver<Devices> {
        self.known.subscribe()
    }

    /// Could one be taken now? True where it is of a new browser.
    ///
    /// # Errors
    /// It is none, or there are too many.
    pub fn check(&self, subscription: &Subscription) -> Result<bool, NotTaken> {
        Endpoint::read(&subscription.endpoint, &self.services).map_err(NotTaken::Wrong)?;
        subscription.encrypt(b"").map_err(|why| NotTaken::Wrong(format!("{why:#}")))?;
        let known = self.known.borrow();
        has_room(&known, subscription)?;
        Ok(!known.contains_key(&subscription.id()))
    }

    /// Takes one, in the place of an earlier one of the same browser. It is on disk when this returns.
    ///
    /// # Errors
    /// It is none, there are too many, or the disk does not take it.
    pub async fn add(&self, subscription: Subscription) -> Result<(), NotTaken> {
        self.check(&subscription)?;
        let taken = self.change(|known| -> Result<(), NotTaken> {
            // Others may have come while it waited for its turn.
            has_room(known, &subscription)?;
            known.insert(subscription.id(), subscription);
            Ok(())
        });
        taken.await.map_err(NotTaken::Disk)?
    }

    /// Drops all for which this is not so; returns how many.
    ///
    /// # Errors
    /// The disk does not take it: all are as before.
    pub async fn retain(&self, is_kept: impl Fn(&str, &Subscription) -> bool) -> io::Result<usize> {
        if self.known.borrow().iter().all(|(id, one)| is_kept(id, one)) {
            return Ok(0);
        }
        self.change(|known| {
            let before = known.len();
            known.retain(|id, one| is_kept(id, one));
            before - known.len()
        })
        .await
    }

    async fn change<T>(&self, change: impl FnOnce(&mut Devices) -> T) -> io::Result<T> {
        let turn = self.turn.clone().lock_owned().await;
        let mut known = self.known.borrow().clone();
        let done = change(&mut known);
        let subscriptions = known.values().cloned().collect();
        let stored = serde_json::to_vec_pretty(&Stored { key: self.key.document().to_owned(), subscriptions })?;
        let (file, published) = (self.file.clone(), self.known.clone());
        let write = move || {
            file.parent().map_or(Ok(()), private::make_folder)?;
            private::write_whole(&file, &stored)?;
            published.send_replace(known);
            drop(turn);
            Ok(())
        };
        tokio::task::spawn_blocking(write).await.map_err(io::Error::other)?.map(|()| done)
    }

    /// Sends a message to one of them. Where its push service says that it takes no more, it is dropped.
    ///
    /// # Errors
    /// The push service did not take it, with the reason; [`Refused`] where it will not take it later either.
    pub async fn send(
        self: &Arc<Self>,
        to: &Subscription,
        message: &Push,
        http: &mut Http,
        ca_file: Option<&std::path::Path>,
    ) -> anyhow::Result<()> {
        let Endpoint { origin, is_strangers } =
            Endpoint::read(&to.endpoint, &self.services).map_err(anyhow::Error::msg)?;
        // By the host's own clock: the sky may be a simulated one.
        let now = Clock::machine_clock().utc();
        let ask = Ask {
            method: Method::POST,
            url: &to.endpoint,
            headers: vec![
                (header::AUTHORIZATION, self.key.authorization(origin, &self.contact, now)?),
                (header::CONTENT_ENCODING, "aes128gcm".to_owned()),
                (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
                (header::HeaderName::from_static("ttl"), KEPT_S.to_string()),
                (
                    header::HeaderName::from_static("urgency"),
                    if message.is_urgent { "high" } else { "normal" }.to_owned(),
                ),
                (header::HeaderName::from_static("topic"), to.topic(&message.tag)),
            ],
            body: to.encrypt(message.content.to_string().as_bytes())?,
            is_strangers,
        };
        let status = http.status(ask, ca_file).await?;
        let what_to_do = match status {
            StatusCode::NOT_FOUND | StatusCode::GONE => {
                let id = to.id();
                if self.retain(|known, _| known != id).await? > 0 {
                    tracing::warn!(
                        user = to.user,
                        device = to.device,
                        "a browser takes no more alerts: it has withdrawn its subscription"
                    );
                }
                ": the subscription of the browser has ended"
            }
            StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => {
                ": look at the clock of this host, or switch the alerts off and on again on that device"
            }
            _ => "",
        };
        let why = format!("it answered {status}{what_to_do}");
        match status {
            taken if taken.is_success() => Ok(()),
            busy if busy.is_server_error() || busy == StatusCode::TOO_MANY_REQUESTS => Err(anyhow!(why)),
            _ => Err(Refused(why).into()),
        }
    }
}

fn has_room(known: &Devices, new: &Subscription) -> Result<(), NotTaken> {
    let (id, user) = (new.id(), &new.user);
    let others = known.iter().filter(|(known, _)| **known != id);
    let (all, own) = others.fold((0, 0), |(all, own), (_, one)| (all + 1, own + usize::from(one.user == *user)));
    if own >= MOST_OF_USER || all >= MOST {
        return Err(NotTaken::TooMany(format!(
            "{own} devices of {user} get alerts, and {all} of all users: expected fewer than {MOST_OF_USER} and {MOST}; remove \
             some first"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use base64::Engine as _;
    use base64::engine::general_purpose::URL_SAFE_NO_PAD;
    use contract::observatory::Priority;
    use test_support::{ALPHA, Browser};
    use units::Utc;

    use super::*;

    fn open(folder: &std::path::Path) -> Subscriptions {
        let config = config::parse(ALPHA, folder).unwrap();
        Subscriptions::open(folder.join("data/push.json"), &config).unwrap()
    }

    fn of(user: &str, number: usize) -> Subscription {
        let browser = Browser::new();
        let key = |bytes: &[u8]| URL_SAFE_NO_PAD.encode(bytes);
        Subscription {
            user: user.to_owned(),
            device: "phone".to_owned(),
            endpoint: format!("https://push.example.net/{user}/{number}"),
            p256dh: key(browser.public()),
            auth: key(browser.auth()),
            min_priority: Priority::High,
            after_min: 0.0,
            since_utc: Utc::EPOCH,
        }
    }

    #[tokio::test]
    async fn key_and_subscriptions_survive_a_restart_in_a_file_of_this_user_alone() {
        let folder = tempfile::tempdir().unwrap();
        let first = open(folder.path());
        first.add(of("ana", 1)).await.map_err(|_| "not taken").unwrap();
        let again = open(folder.path());
        assert_eq!(again.public_key(), first.public_key());
        assert_eq!(again.watch().borrow().keys().collect::<Vec<_>>(), [&of("ana", 1).id()]);
        let file = folder.path().join("data/push.json");
        assert!(!private::is_open_to_others(&file));
        assert_eq!(again.retain(|_, one| one.user != "ana").await.unwrap(), 1);
        assert!(open(folder.path()).watch().borrow().is_empty());
        std::fs::write(&file, "{\"key").unwrap();
        assert_ne!(open(folder.path()).public_key(), first.public_key());
        let copies = std::fs::read_dir(folder.path().join("data")).unwrap().count();
        assert_eq!(copies, 2, "what is damaged is kept for people");
    }

    #[tokio::test]
    async fn a_person_has_twenty_devices_at_most_and_one_that_is_there_can_be_changed() {
        let folder = tempfile::tempdir().unwrap();
        let all = open(folder.path());
        for number in 0..MOST_OF_USER {
            assert!(all.add(of("ana", number)).await.is_ok());
        }
        assert!(matches!(all.add(of("ana", MOST_OF_USER)).await, Err(NotTaken::TooMany(_))));
        assert!(all.add(of("ana", 3)).await.is_ok() && all.add(of("bob", 3)).await.is_ok());
        let wrong = Subscription { p256dh: "x".to_owned(), ..of("bob", 4) };
        assert!(matches!(all.add(wrong).await, Err(NotTaken::Wrong(why)) if why.contains("p256dh")));
        let wrong = Subscription { endpoint: "https://127.0.0.1/x".to_owned(), ..of("bob", 4) };
        assert!(matches!(all.add(wrong).await, Err(NotTaken::Wrong(why)) if why.contains("endpoint")));
        assert_eq!(all.watch().borrow().len(), MOST_OF_USER + 1);
    }
}
