//! Prepares all that the tasks need before they run: the journal, the devices, and the state of each feature.

use std::sync::Arc;
use std::time::Duration;

use anyhow::ensure;
use audit::Audit;
use contract::Address;
use contract::observatory::{AlertKind, FocusRun};
use node::Node;
use safety::current_verdict::CurrentVerdict;
use schedule::names::KnownNames;
use tokio::sync::{Notify, mpsc, watch};

use crate::action::Techniques;
use crate::active_orders::OrderState;
use crate::authority::Authority;
use crate::devices::Devices;
use crate::devices::instrument::CommandSender;
use crate::expected::StepTimes;
use crate::failover::takeover::{self, FormerCommander};
use crate::focus::FocusData;
use crate::frames::FrameData;
use crate::guiding::GuidingData;
use crate::hold::Hold;
use crate::hooks::{Hooks, ScriptedSite};
use crate::journal::{self, Journal};
use crate::night::PublishedNight;
use crate::opening::Opener;
use crate::pointing::PointingData;
use crate::row_context::RowTools;
use crate::schedule_file::ScheduleFile;
use crate::schedule_file::versions::Versions;
use crate::slit::Slits;

/// What `run` hands to its tasks.
pub struct Start {
    /// What rows work with.
    pub tools: Arc<RowTools>,
    /// What actions use in addition.
    pub techniques: Arc<Techniques>,
    /// What people ordered.
    pub orders: Arc<OrderState>,
    /// The schedule file.
    pub schedule_file: Arc<ScheduleFile>,
    /// The site's script.
    pub site: Arc<ScriptedSite>,
    /// Where looked-up names are put.
    pub names: watch::Sender<KnownNames>,
    /// Focus runs that have ended.
    pub focus_runs: mpsc::UnboundedReceiver<FocusRun>,
    /// The safety loop sends its verdict here.
    pub verdict: watch::Sender<CurrentVerdict>,
    /// The lease.
    pub hold: watch::Sender<Hold>,
    /// Notified when a device knows a newer token than ours.
    pub doubt: Arc<Notify>,
    /// What the commander before this node publishes.
    pub before: FormerCommander,
}

/// Prepares everything and publishes nothing yet.
pub async fn start(node: &Node) -> anyhow::Result<Start> {
    let (config, clock) = (&node.config, node.bus.clock());
    ensure!(
        config.place.telescope.as_str() != Address::SHARED,
        "the file of a site's shared devices has no telescope to run; start an observatory node per telescope"
    );
    let journal = Arc::new(open_journal(node).await?);
    let robotic = takeover::robotic(&journal, config.schedule.robotic, clock.utc());
    let orders = Arc::new(OrderState::load(node).await?);
    let guiding = Arc::new(GuidingData::load(node).await?);
    let frames = Arc::new(FrameData::load(node).await?);
    let names = KnownNames::path(config);
    let read_names = move || -> KnownNames { crate::persisted::read_or_anew(&names, "where named targets stand") };
    let (names, known) = watch::channel(tokio::task::spawn_blocking(read_names).await?);
    let pointing = Arc::new(PointingData::load(node).await?);
    let (focus, focus_runs) = FocusData::load(node).await?;
    let (verdict, newest_verdict) = watch::channel(CurrentVerdict::none(clock.machine(), clock.utc()));
    let (hold, seen_hold) = watch::channel(Hold::Asking);
    let doubt = Arc::new(Notify::new());
    let command_sender = CommandSender {
        bus: node.bus.clone(),
        signature: node.signature(),
        lease: seen_hold.clone(),
        doubt: doubt.clone(),
    };
    let devices = Arc::new(Devices::listen(node, &command_sender, focus.learned.subscribe()).await?);
    let before = FormerCommander::listen(&node.bus, &config.address()).await?;
    let authority = Arc::new(Authority {
        node: node.clone(),
        verdict: newest_verdict,
        hold: seen_hold,
        robotic: watch::channel(robotic).0,
        close_request: watch::channel(None).0,
        audit: Audit::start(node).await?,
        shutters: {
            let devices = devices.clone();
            Box::new(move || devices.domes.iter().map(|dome| dome.shutter()).collect())
        },
    });
    let site = Arc::new(ScriptedSite {
        authority: authority.clone(),
        devices: devices.clone(),
        hooks: Hooks::load(node).await,
    });
    let slits = Arc::new(Slits { authority: authority.clone(), devices: devices.clone(), aim: watch::channel(None).0 });
    let opener =
        Opener { authority: authority.clone(), devices: devices.clone(), slits: slits.clone(), site: site.clone() };
    let schedule_file = ScheduleFile {
        authority: authority.clone(),
        devices: devices.clone(),
        names: known.clone(),
        versions: Versions::of(config),
        reload: watch::channel(0).0,
        read: watch::channel(Default::default()).0,
        active: Default::default(),
        earlier_nights: Arc::default(),
    };
    let night = Arc::new(PublishedNight::new(config.schedule.file.display().to_string()));
    Ok(Start {
        tools: Arc::new(RowTools {
            authority,
            devices,
            slits,
            journal,
            night,
            ledger: Arc::default(),
            frames,
            step_times: Arc::new(StepTimes::assumed(config)),
        }),
        techniques: Arc::new(Techniques { pointing, guiding, focus: Arc::new(focus), opener, names: known }),
        orders,
        schedule_file: Arc::new(schedule_file),
        site,
        names,
        focus_runs,
        verdict,
        hold,
        doubt,
        before,
    })
}

async fn open_journal(node: &Node) -> anyhow::Result<Journal> {
    let path = journal::path(&node.config);
    loop {
        let (here, printed) = (path.clone(), path.display());
        let why = match tokio::task::spawn_blocking(move || Journal::open(&here)).await? {
            Ok(journal) => {
                node.alerts.clear(AlertKind::Configuration, "folders.data");
                return Ok(journal);
            }
            Err(error) => format!("folders.data: cannot open the journal {printed}: {error}"),
        };
        // Without it nothing is opened, and the guards close: that is logged once, and tried again.
        let cause = format!("{why}; nothing is opened until it can be, which is tried each 15 s");
        node.alerts.raise(AlertKind::Configuration, "folders.data", &cause);
        ensure!(node.stop.or(tokio::time::sleep(AGAIN)).await.is_some(), "{why}");
    }
}

/// A data folder that cannot be used is tried again after this.
const AGAIN: Duration = Duration::from_secs(15);
