//! What must be there before the tasks run: the journal, the devices, and the channels between the tasks.

use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;

use anyhow::{Context as _, ensure};
use audit::Audit;
use bus::Node;
use contract::Address;
use tokio::sync::{Notify, watch};

use crate::annunciator::{self, Annunciator};
use crate::control_room::ControlRoom;
use crate::journal::Journal;
use crate::lease::Hold;
use crate::ledger::Ledger;
use crate::neighbours::Neighbours;
use crate::night::Board;
use crate::rig::Rig;
use crate::rig::instrument::Voice;
use crate::safety::Ruling;
use crate::safety::rules::Rules;
use crate::schedule::Loaded;
use crate::standing::{self, Standing};
use crate::takeover;

/// A task of the node.
pub type Task = Pin<Box<dyn Future<Output = anyhow::Result<()>> + Send>>;

/// What `run` hands to its tasks.
pub struct Start {
    /// What all share.
    pub room: Arc<ControlRoom>,
    /// Where the safety loop puts its ruling.
    pub ruling: watch::Sender<Ruling>,
    /// Where the lease is kept.
    pub hold: watch::Sender<Hold>,
    /// Where the schedule is put.
    pub loaded: watch::Sender<Loaded>,
    /// The other telescopes of the site.
    pub neighbours: Neighbours,
}

/// Prepares everything and says nothing yet.
pub async fn start(node: &Node) -> anyhow::Result<Start> {
    let (config, clock) = (&node.config, node.bus.clock());
    ensure!(
        config.place.telescope.as_str() != Address::SHARED,
        "the file of a site's shared devices has no telescope to run; start an observatory node per telescope"
    );
    let journal = open_journal(node).await?;
    let robotic = takeover::robotic(&journal, config.schedule.robotic, clock.utc());
    let (orders, now) = (standing::path(config), clock.utc());
    let standing = tokio::task::spawn_blocking(move || Standing::read(&orders, now)).await?;
    let alerts = annunciator::path(config);
    let annunciator = tokio::task::spawn_blocking(move || Annunciator::read(&alerts)).await?;
    let (ruling, heard_ruling) = watch::channel(Ruling::none(clock.machine(), clock.utc()));
    let (hold, seen_hold) = watch::channel(Hold::Asking);
    let doubt = Arc::new(Notify::new());
    let voice =
        Voice { bus: node.bus.clone(), signature: node.signature(), lease: seen_hold.clone(), doubt: doubt.clone() };
    let room = ControlRoom {
        node: node.clone(),
        rig: Rig::listen(node, &voice).await?,
        ruling: heard_ruling,
        hold: seen_hold,
        doubt,
        robotic: watch::channel(robotic).0,
        wish_closed: watch::channel(None).0,
        aim: watch::channel(None).0,
        reload: watch::channel(0).0,
        journal,
        rules: Arc::new(Rules::of(config)),
        standing: watch::channel(standing.clone()).0,
        standing_on_disk: watch::channel(standing).0,
        annunciator: watch::channel(annunciator).0,
        alerts: watch::channel(None).0,
        ledger: Ledger::default(),
        audit: Audit::start(node).await?,
        board: Board::new(config.schedule.file.display().to_string()),
    };
    Ok(Start {
        room: Arc::new(room),
        ruling,
        hold,
        loaded: watch::channel(Loaded::default()).0,
        neighbours: Neighbours::default(),
    })
}

async fn open_journal(node: &Node) -> anyhow::Result<Journal> {
    let name = format!("journal-{}.jsonl", node.config.place.telescope);
    let path: PathBuf = node.config.folders.data.join(name);
    let shown = path.display().to_string();
    tokio::task::spawn_blocking(move || Journal::open(&path))
        .await?
        .with_context(|| format!("cannot open the journal {shown}"))
}
