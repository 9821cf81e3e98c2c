//! Prepares all that the tasks need before they run: the journal, the devices, and the channels between the tasks.

use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use anyhow::ensure;
use audit::Audit;
use bus::Node;
use contract::Address;
use contract::observatory::{AlertKind, FocusRun, FocusState, GuidingState, PointingState};
use safety::rules::Rules;
use safety::ruling::Ruling;
use tokio::sync::{Notify, OnceCell, mpsc, watch};

use crate::annunciator;
use crate::control_room::ControlRoom;
use crate::focus;
use crate::frames::dark::Darks;
use crate::frames::looked::Looks;
use crate::frames::mounts::Mounts;
use crate::frames::optics;
use crate::frames::tell::Telling;
use crate::guiding::learnt::{self, Learnt};
use crate::hooks::Hooks;
use crate::journal::Journal;
use crate::kept::Kept;
use crate::lease::Hold;
use crate::ledger::Ledger;
use crate::neighbours::Neighbours;
use crate::night::Board;
use crate::pointing::learnt::{self as pointing_learnt, Book};
use crate::rig::Rig;
use crate::rig::instrument::Voice;
use crate::schedule_file::Loaded;
use crate::schedule_file::versions::Versions;
use crate::standing;
use crate::star_catalogue::StarCatalogue;
use crate::takeover::{self, Before};
use schedule::names::Known;

/// A task of the node.
pub type Task = Pin<Box<dyn Future<Output = anyhow::Result<()>> + Send>>;

/// What `run` hands to its tasks.
pub struct Start {
    /// What all share.
    pub room: Arc<ControlRoom>,
    /// The safety loop sends its verdict here.
    pub ruling: watch::Sender<Ruling>,
    /// The lease.
    pub hold: watch::Sender<Hold>,
    /// Where the schedule is put.
    pub loaded: watch::Sender<Loaded>,
    /// Focus runs that have ended.
    pub focus_runs: mpsc::UnboundedReceiver<FocusRun>,
    /// The other telescopes of the site.
    pub neighbours: Neighbours,
}

/// Prepares everything and publishes nothing yet.
pub async fn start(node: &Node) -> anyhow::Result<Start> {
    let (config, clock) = (&node.config, node.bus.clock());
    ensure!(
        config.place.telescope.as_str() != Address::SHARED,
        "the file of a site's shared devices has no telescope to run; start an observatory node per telescope"
    );
    let journal = open_journal(node).await?;
    let robotic = takeover::robotic(&journal, config.schedule.robotic, clock.utc());
    let (orders, now) = (standing::path(config), clock.utc());
    let standing = tokio::task::spawn_blocking(move || standing::read(&orders).orders(now)).await?;
    let alerts = annunciator::path(config);
    let annunciator = tokio::task::spawn_blocking(move || annunciator::read(&alerts)).await?;
    let guiding = learnt::path(config);
    let guide_learnt = tokio::task::spawn_blocking(move || Learnt::read(&guiding)).await?;
    let learnt = optics::path(config);
    let learnt = tokio::task::spawn_blocking(move || optics::read(&learnt)).await?;
    let names = Known::path(config);
    let names = tokio::task::spawn_blocking(move || -> Known {
        crate::kept::read_or_anew(&names, "where named targets stand")
    })
    .await?;
    let pointing = pointing_learnt::path(config);
    let pointing_book = tokio::task::spawn_blocking(move || Book::read(&pointing)).await?;
    let pointing_state = PointingState { models: pointing_book.models.clone(), ..PointingState::default() };
    let file = focus::path(config);
    let known = tokio::task::spawn_blocking(move || focus::Learnt::read(&file)).await?;
    let focus_learnt = Kept::new(focus::path(config), &node.id, known);
    let (ended_runs, focus_runs) = mpsc::unbounded_channel();
    let (ruling, heard_ruling) = watch::channel(Ruling::none(clock.machine(), clock.utc()));
    let (hold, seen_hold) = watch::channel(Hold::Asking);
    let doubt = Arc::new(Notify::new());
    let voice =
        Voice { bus: node.bus.clone(), signature: node.signature(), lease: seen_hold.clone(), doubt: doubt.clone() };
    let room = ControlRoom {
        node: node.clone(),
        rig: Rig::listen(node, &voice, focus_learnt.subscribe()).await?,
        ruling: heard_ruling,
        hold: seen_hold,
        doubt,
        robotic: watch::channel(robotic).0,
        wish_closed: watch::channel(None).0,
        aim: watch::channel(None).0,
        versions: Versions::of(config),
        reload: watch::channel(0).0,
        journal,
        rules: Arc::new(Rules::of(config)),
        standing: Kept::new(standing::path(config), &node.id, standing),
        standing_said: watch::channel(None).0,
        annunciator: Kept::new(annunciator::path(config), &node.id, annunciator),
        before: Before::listen(&node.bus, &config.address()).await?,
        alerts: watch::channel(None).0,
        ledger: Ledger::default(),
        facts: Telling::default(),
        looks: Looks::default(),
        darks: Darks::default(),
        catalogue: StarCatalogue::default(),
        mounts: Mounts::default(),
        optics: Kept::new(optics::path(config), &node.id, learnt),
        names: watch::channel(names).0,
        pointing: watch::channel(pointing_state).0,
        pointing_book: Kept::new(pointing_learnt::path(config), &node.id, pointing_book),
        guiding: watch::channel(GuidingState::default()).0,
        guide_learnt: Kept::new(learnt::path(config), &node.id, guide_learnt),
        corrections: OnceCell::new(),
        focus: watch::channel(FocusState::default()).0,
        focus_learnt,
        focus_runs: ended_runs,
        leaves_alone: Default::default(),
        audit: Audit::start(node).await?,
        hooks: Hooks::load(node).await,
        board: Board::new(config.schedule.file.display().to_string()),
    };
    Ok(Start {
        room: Arc::new(room),
        ruling,
        hold,
        loaded: watch::channel(Loaded::default()).0,
        focus_runs,
        neighbours: Neighbours::default(),
    })
}

async fn open_journal(node: &Node) -> anyhow::Result<Journal> {
    let name = format!("journal-{}.jsonl", node.config.place.telescope);
    let path: PathBuf = node.config.folders.data.join(name);
    loop {
        let (here, shown) = (path.clone(), path.display());
        let why = match tokio::task::spawn_blocking(move || Journal::open(&here)).await? {
            Ok(journal) => {
                node.alerts.clear(AlertKind::Configuration, "folders.data");
                return Ok(journal);
            }
            Err(error) => format!("folders.data: cannot open the journal {shown}: {error}"),
        };
        // Without it nothing is opened, and the guards close: that is logged once, and tried again.
        let told = format!("{why}; nothing is opened until it can be, which is tried each 15 s");
        node.alerts.raise(AlertKind::Configuration, "folders.data", &told);
        ensure!(node.stop.or(tokio::time::sleep(AGAIN)).await.is_some(), "{why}");
    }
}

/// A data folder that cannot be used is tried again after this.
const AGAIN: Duration = Duration::from_secs(15);
