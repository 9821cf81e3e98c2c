//! `starmesh up`: starts and supervises the nodes of one telescope, one process per role, and one more device node per dome.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bus::{Bus, Clock};
use clap::Args;
use contract::Role;
use node::{Stop, lines};
use tokio::sync::oneshot;
use tokio::task::JoinSet;

use crate::bus_address;
use crate::check::writable;
use crate::left::{self, Left};
use crate::reports::Reports;
use crate::running;
use crate::supervise::NodeProcess;

/// How often the command prints what it waits for.
const REPORT_AFTER: Duration = Duration::from_secs(10);

/// The files that tell what the telescope does by itself are waited for so long.
const BEGINNING: Duration = Duration::from_secs(5);

/// A file that cannot be used is read again so often.
const READ_AGAIN: Duration = Duration::from_secs(2);

/// Options of `starmesh up`.
#[derive(Debug, Args)]
pub struct Options {
    /// The telescope's observatory.toml.
    file: PathBuf,
    /// Extra arguments for every node, such as --connect tcp/10.0.0.5:7447.
    #[arg(last = true)]
    node_arguments: Vec<String>,
}

/// Runs until Ctrl-C or SIGTERM; then enclosures are closed before their device nodes end.
pub async fn run(options: Options) -> anyhow::Result<()> {
    if let Err(error) = node::configuration::read_observatory(&options.file)
        && !node_device::closes_by_copy(&options.file)
    {
        // Before anything is written next to a name that was mistyped.
        return Err(error);
    }
    let left = Arc::new(Left::find(&options.file).await?);
    let config = match node::configuration::read_observatory(&options.file) {
        Ok(config) => config,
        Err(error) => match guarded_until_readable(&options, error, &left).await? {
            Some(config) => config,
            None => {
                left.nothing();
                return Ok(());
            }
        },
    };
    // The nodes of this file meet here whatever the file says, and are introduced to each other by gossip.
    node::log::show_log();
    let bus = Bus::open(&bus_address::of_supervisor(&config.bus), clock(&config).await).await?;
    let locators = bus.locators().await;
    bus_address::complain(&config.bus, &locators);
    let here = bus_address::on_this_host(&config.bus, &locators);
    let mut arguments = options.node_arguments.clone();
    arguments.extend(bus_address::of_nodes(&config.bus, here.as_deref()));
    let (reports, reporting) = Reports::start(&bus, config.address());
    tokio::spawn(async {
        if let Err(error) = reporting.await {
            lines::complain(format_args!("starmesh: ends of nodes are not reported on the bus any more: {error:#}"));
        }
    });
    tokio::spawn(async {
        loop {
            // `up` itself may be run by a service manager.
            node::service_manager::alive();
            tokio::time::sleep(Duration::from_secs(5)).await;
        }
    });
    let folder = options.file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let nodes = left::path(&options.file);
    let _running = here.and_then(|here| running::announce("up", &config.address(), &here, folder, Some(&nodes)));
    let (told, beginning) = oneshot::channel();
    let (site, file, now) = (config.clone(), options.file.clone(), bus.clock().utc());
    // A disk that hangs keeps no node from its start.
    std::thread::spawn(move || {
        for why in unwritable(&site) {
            lines::complain(format_args!(
                "starmesh: {why}. What needs this folder waits for it, and the nodes try again"
            ));
        }
        let was_commanded = node_device::was_commanded(&file, &site);
        told.send(node_observatory::beginning::words(&site, was_commanded, now))
    });
    let node = |role, id: &str| NodeProcess {
        role,
        id: id.to_owned(),
        config: options.file.clone(),
        arguments: arguments.clone(),
        log: None,
        with_parent: role != Role::Device,
        left: Some(left.clone()),
        reports: Some(reports.clone()),
        state: None,
    };
    let page = page(config.web.listen);
    let mut devices: Vec<(String, Stop, JoinSet<()>)> = Vec::new();
    let mut first_starts = Vec::new();
    // Enclosures first, at the start and at the end: an enclosure that waits for the mount needs the mount's node until
    // it is closed.
    for id in config.device_nodes() {
        let (node, stop) = (node(Role::Device, id), Stop::default());
        let (stopped, mut task) = (stop.clone(), JoinSet::new());
        let (first, is_started) = oneshot::channel();
        first_starts.push((name(&node), is_started));
        task.spawn(async move { node.keep(stopped, first).await });
        devices.push((id.to_owned(), stop, task));
    }
    let shared = config.place.telescope.as_str() == contract::Address::SHARED;
    let mut run = |roles: &[Role]| {
        let (stop, mut tasks) = (Stop::default(), JoinSet::new());
        for role in roles {
            let (node, stopped) = (node(*role, config::MAIN_NODE), stop.clone());
            let (first, is_started) = oneshot::channel();
            first_starts.push((name(&node), is_started));
            tasks.spawn(async move { node.keep(stopped, first).await });
        }
        (stop, tasks)
    };
    let (stop_observatory, mut observatory) = run(if shared { &[] } else { &[Role::Observatory] });
    // They send and store what the others report until the end.
    let (stop_others, mut others) = run(&[Role::Archive, Role::Web]);
    let at = bus_address::shown(&config.bus, &locators);
    let (all, mut missing) = (first_starts.len(), Vec::new());
    for (name, is_started) in first_starts {
        if !is_started.await.unwrap_or(false) {
            missing.push(name);
        }
    }
    let started = started(all, &missing);
    if let Ok(Ok(Some(words))) = tokio::time::timeout(BEGINNING, beginning).await {
        lines::print_line(contract::printable(&words));
    }
    lines::print_line(format_args!("{}: {started}; {at}; {page}; Ctrl-C stops", config.address()));
    node::signals::end_asked().await;
    lines::print_line(
        "stopping: the observatory node closes first (at most 15 s), then each enclosure's device node (at most 300 s); archive \
         and web end last",
    );
    stop_observatory.stop();
    let ending = async {
        while observatory.join_next().await.is_some() {}
        let has_dome = |id: &str| config.served_by(id).iter().any(|(kind, _)| *kind == contract::Kind::Dome);
        let (enclosures, other_devices): (Vec<_>, Vec<_>) = devices.into_iter().partition(|(id, ..)| has_dome(id));
        for (id, stop, mut task) in enclosures {
            stop.stop();
            let began = Instant::now();
            while tokio::time::timeout(REPORT_AFTER, task.join_next()).await.is_err() {
                lines::print_line(format_args!(
                    "waiting for the device node {id} to close its enclosure, since {} s, at most 300 s; Ctrl-C again leaves \
                     it: it goes on closing until then, and the next `starmesh up` of this file waits for it",
                    began.elapsed().as_secs()
                ));
            }
        }
        // All at once: where these are shared, each second of theirs counts against the readings' allowed age elsewhere.
        other_devices.iter().for_each(|(_, stop, _)| stop.stop());
        if shared {
            stop_others.stop();
        }
        for (_, _, mut task) in other_devices {
            while task.join_next().await.is_some() {}
        }
        stop_others.stop();
        while others.join_next().await.is_some() {}
    };
    let in_good_order = tokio::select! {
        () = ending => true,
        () = node::signals::termination() => false,
    };
    bus.close().await;
    anyhow::ensure!(in_good_order, "ended by a second signal; what still runs: {}", left.names());
    left.nothing();
    lines::print_line("stopped: every node has ended");
    Ok(())
}

fn name(node: &NodeProcess) -> String {
    format!("the {} node {}", node.role, node.id)
}

/// How many nodes were started, and which were not.
fn started(all: usize, missing: &[String]) -> String {
    let started = format!("{} of {all} nodes started", all.saturating_sub(missing.len()));
    match missing {
        [] => started,
        [one] => format!("{started}; {one} was not (why is above), and is tried again"),
        many => format!("{started}; {} were not (why is above), and are tried again", many.join(", ")),
    }
}

/// The clock of the site, so that what `up` reports has the times of what the nodes report; that of the machine where the
/// simulator does not answer yet.
async fn clock(config: &config::Observatory) -> Clock {
    match &config.clock.simulator {
        Some(base) => Clock::of_simulator(base).await.unwrap_or_else(|_| Clock::machine_clock()),
        None => Clock::machine_clock(),
    }
}

/// The folders to which the nodes cannot write: the key, why, and what to do.
fn unwritable(config: &config::Observatory) -> Vec<String> {
    let folders = [("folders.data", &config.folders.data), ("folders.images", &config.folders.images)];
    folders.into_iter().filter_map(|(key, folder)| Some(format!("{key}: {}", writable(folder).err()?))).collect()
}

/// The address of the page, before the web node has taken it.
fn page(listen: std::net::SocketAddr) -> String {
    match std::net::TcpListener::bind(listen) {
        Ok(_) => format!("the page is at http://{listen}/ "),
        Err(error) if error.kind() == ErrorKind::AddrInUse => format!(
            "the page cannot be served at http://{listen}/ now: another program has this address, and a page that is there is of \
             that one; end it, or choose another web.listen"
        ),
        Err(error) => format!(
            "the page cannot be served at http://{listen}/ ({error}); choose an address of this host as web.listen, and a \
             port from 1024 on"
        ),
    }
}

/// Waits for a file that cannot be used, while the enclosure may be open: its guard process runs by the configuration
/// that last worked, until the file can be used (and is returned) or an end is requested. An error where nothing is
/// known of an enclosure.
async fn guarded_until_readable(
    options: &Options,
    error: anyhow::Error,
    left: &Arc<Left>,
) -> anyhow::Result<Option<config::Observatory>> {
    if !node_device::closes_by_copy(&options.file) {
        return Err(error);
    }
    lines::complain(format_args!(
        "starmesh: {error:#}\nstarmesh: until this file can be used, the enclosure is guarded and kept closed by what last \
         worked, and nothing else runs"
    ));
    let node = NodeProcess {
        role: Role::Device,
        id: config::ENCLOSURE_NODE.to_owned(),
        config: options.file.clone(),
        arguments: options.node_arguments.clone(),
        log: None,
        with_parent: false,
        left: Some(left.clone()),
        reports: None,
        state: None,
    };
    let (stop, mut task) = (Stop::default(), JoinSet::new());
    let stopped = stop.clone();
    task.spawn(async move { node.keep(stopped, oneshot::channel().0).await });
    let readable = async {
        loop {
            tokio::time::sleep(READ_AGAIN).await;
            if let Ok(config) = node::configuration::read_observatory(&options.file) {
                return config;
            }
        }
    };
    let config = tokio::select! {
        config = readable => Some(config),
        () = node::signals::end_asked() => None,
    };
    stop.stop();
    while task.join_next().await.is_some() {}
    Ok(config)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_that_were_not_started_are_counted_and_named() {
        let names = ["the device node main", "the archive node main"].map(str::to_owned);
        assert_eq!(started(5, &[]), "5 of 5 nodes started");
        let one = "4 of 5 nodes started; the archive node main was not (why is above), and is tried again";
        assert_eq!(started(5, &names[1..]), one);
        assert!(
            started(5, &names)
                .starts_with("3 of 5 nodes started; the device node main, the archive node main were not")
        );
    }

    #[test]
    fn a_folder_that_cannot_be_written_and_a_port_that_is_taken_are_told_with_their_keys_and_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("data"), "a file in the place of the folder").unwrap();
        let place = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\n\
                     elevation_m = 0.0\n";
        let config = config::parse(place, folder.path()).unwrap();
        let [found] = <[String; 1]>::try_from(unwritable(&config)).unwrap();
        assert!(found.starts_with("folders.data: ") && found.contains("data is no folder"), "{found}");

        let other = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let at = other.local_addr().unwrap();
        let words = page(at);
        assert!(words.contains(&at.to_string()) && words.contains("end it, or choose another web.listen"), "{words}");
    }
}
