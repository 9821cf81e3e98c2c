//! `starmesh demo`: one simulated night of one or several telescopes through the real nodes, as processes, on a bus of their
//! own.

mod happenings;
mod progress;
mod site;

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use bus::{Bus, Clock};
use clap::Args;
use contract::{Address, Role};
use simulator::Simulator;
use tokio::task::JoinSet;
use units::Utc;

use crate::running;
use crate::supervise::{NodeProcess, end};
use happenings::{bad_night, happenings, play};
use progress::{Progress, summary};
use site::Plan;

/// Options of `starmesh demo`.
#[derive(Debug, Args)]
pub struct Options {
    /// Telescopes, 1 to 4: from the third on at a second site with its own weather, and the second one has a bad night.
    #[arg(long, default_value_t = 1, value_name = "N")]
    telescopes: usize,
    /// Sky seconds per machine second; a night at 300 takes about two minutes. 300 for one telescope, 150 for several.
    #[arg(long)]
    speed: Option<f64>,
    /// Port of the page; a free one where absent and 8080 is taken.
    #[arg(long)]
    port: Option<u16>,
    /// Keep the configuration, FITS files, database and logs here; a new or empty folder.
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Side of the simulated cameras, pixels; 2048 for one telescope, 768 for several.
    #[arg(long)]
    size_px: Option<u32>,
    /// When the night has ended, go on serving the page until Ctrl-C.
    #[arg(long)]
    stay: bool,
}

const USUAL_PORT: u16 = 8080;

/// Speed, and side of the cameras in pixels: of one telescope, and of several on a machine of two processors.
const ALONE: (f64, u32) = (300.0, 2048);
const SEVERAL: (f64, u32) = (150.0, 768);

/// Runs the night; an error when it did not go well.
pub async fn run(options: Options) -> anyhow::Result<()> {
    let usual = if options.telescopes > 1 { SEVERAL } else { ALONE };
    let (speed, size_px) = (options.speed.unwrap_or(usual.0), options.size_px.unwrap_or(usual.1));
    let most = site::MOST_TELESCOPES;
    anyhow::ensure!(
        (1..=most).contains(&options.telescopes),
        "--telescopes {}: expected 1 to {most}",
        options.telescopes
    );
    anyhow::ensure!((1.0..=2000.0).contains(&speed), "--speed {speed}: expected 1 to 2000");
    anyhow::ensure!((64..=8192).contains(&size_px), "--size-px {size_px}: expected 64 to 8192");
    let port = page_port(options.port)?;
    let folder = Folder::new(options.keep.as_deref())?;
    observe(&options, (speed, size_px), port, &folder).await?;
    folder.end();
    Ok(())
}

async fn observe(options: &Options, (speed, size_px): (f64, u32), port: u16, folder: &Folder) -> anyhow::Result<()> {
    let plans = Plan::of(options.telescopes, Clock::machine_clock().utc())?;
    let start = plans.iter().map(|plan| plan.night.start).min().context("no telescope")?;
    let dawn = plans.iter().map(|plan| plan.night.dawn).max().context("no telescope")?;
    let simulators = simulate(&plans, start, speed, size_px).await?;
    let stations = stations(&plans, &simulators, port, folder)?;
    let first = stations.first().context("no telescope")?;

    let clock = match simulators.first() {
        Some(simulator) => Clock::of_simulator(&format!("http://{}", simulator.address())).await?,
        None => anyhow::bail!("no simulator"),
    };
    let bus = Bus::open(&first.config.bus, clock.clone()).await?;
    let endpoint = bus.locators().await.into_iter().find(|locator| locator.contains("127.0.0.1"));
    let endpoint = endpoint.context("the demo's own bus listens nowhere")?;
    let mut nights = Vec::new();
    for (index, plan) in plans.iter().enumerate() {
        let address = Address::new(plan.telescope.site, plan.telescope.name)?;
        let alone = plans.len() == 1;
        let listen = Progress::listen(&bus, &address, alone, bad_night(&plans) == Some(index)).await?;
        nights.push((listen, plan.night));
    }
    let nodes = Nodes::start(&stations, &endpoint)?;
    let _running = running::announce("demo", &first.config.address(), &endpoint, &folder.path, None);

    let total_s = dawn.seconds_since(start) / speed;
    let names: Vec<String> =
        plans.iter().map(|plan| format!("{}/{}", plan.telescope.site, plan.telescope.name)).collect();
    println!("one night of {} at speed {speed}, about {total_s:.0} s", names.join(", "));
    println!("  page      http://127.0.0.1:{port}/");
    if plans.len() == 1 {
        println!("  files     {}", folder.path.join("images").display());
        println!("  database  {}", folder.path.join("data").join("archive.db").display());
        println!("  logs      {}", folder.path.display());
    } else {
        println!("  files, databases and logs: a folder of each telescope in {}", folder.path.display());
    }
    println!(
        "  bus       {endpoint} (for other programs; `starmesh status`, `tail` and `order` find it by themselves)"
    );
    let script = play(happenings(&plans, speed), &plans, &simulators, &clock);
    let well = tokio::select! {
        ended = follow(nights) => {
            let (summary, well) = summary(&ended?);
            println!("{summary}");
            if options.stay {
                println!("the page stays at http://127.0.0.1:{port}/ ; Ctrl-C ends");
                tokio::signal::ctrl_c().await?;
            }
            well
        }
        () = script => true,
        interrupted = tokio::signal::ctrl_c() => {
            interrupted?;
            println!("\ninterrupted; the nodes close what is open, and end");
            true
        }
    };
    nodes.stop().await?;
    for simulator in simulators {
        simulator.stop().await;
    }
    bus.close().await;
    anyhow::ensure!(well, "the night did not go well; the summary above and the logs say where");
    Ok(())
}

/// A simulated observatory for each telescope, all under one clock.
async fn simulate(plans: &[Plan], start: Utc, speed: f64, size_px: u32) -> anyhow::Result<Vec<Simulator>> {
    let mut simulators: Vec<Simulator> = Vec::new();
    for plan in plans {
        let mut world = plan.world(start, speed, size_px);
        world.clock = simulators.first().map(|first| first.world().clock());
        simulators.push(Simulator::start(world).await?);
    }
    Ok(simulators)
}

/// Follows the nights of all telescopes until each has ended.
async fn follow(nights: Vec<(Progress, site::DemoNight)>) -> anyhow::Result<Vec<Progress>> {
    let mut followed = JoinSet::new();
    for (index, (mut progress, night)) in nights.into_iter().enumerate() {
        followed.spawn(async move {
            let ended = progress.follow(night.start, night.dawn).await;
            (index, progress, ended)
        });
    }
    let mut all = Vec::new();
    for (index, progress, ended) in followed.join_all().await {
        ended?;
        all.push((index, progress));
    }
    all.sort_by_key(|(index, _)| *index);
    Ok(all.into_iter().map(|(_, progress)| progress).collect())
}

/// The nodes of one configuration file.
struct Station {
    folder: PathBuf,
    file: PathBuf,
    config: config::Observatory,
    roles: Vec<Role>,
}

impl Station {
    fn new(folder: PathBuf, configuration: &str, roles: &[Role]) -> anyhow::Result<Self> {
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let file = folder.join("observatory.toml");
        write(&file, configuration)?;
        let (config, _) = node::configuration::read_config(&file)?;
        Ok(Self { folder, file, config, roles: roles.to_vec() })
    }

    fn nodes(&self, role: Role) -> Vec<&str> {
        match role {
            _ if !self.roles.contains(&role) => Vec::new(),
            // The node of the enclosure is started last and ends first.
            Role::Device => self.config.device_nodes().into_iter().rev().collect(),
            _ => vec![config::MAIN_NODE],
        }
    }
}

/// Writes the files of all telescopes, and of what the telescopes of each site share. The first one serves the page.
fn stations(plans: &[Plan], simulators: &[Simulator], port: u16, folder: &Folder) -> anyhow::Result<Vec<Station>> {
    let mut stations = Vec::new();
    for (index, (plan, simulator)) in plans.iter().zip(simulators).enumerate() {
        let (site, name) = (plan.telescope.site, plan.telescope.name);
        let own = if plans.len() == 1 { folder.path.clone() } else { folder.path.join(format!("{site}-{name}")) };
        let web = (index == 0).then_some(port);
        let roles = [Role::Device, Role::Observatory, Role::Archive, Role::Web];
        let roles = if web.is_some() { &roles[..] } else { &roles[..3] };
        let station = Station::new(own, &plan.configuration(simulator.address(), web), roles)?;
        write(&station.folder.join("schedule.jsonl"), &plan.schedule())?;
        stations.push(station);
        if plan.shares && plan.is_first_of_site() {
            let shared = plan.shared_configuration(simulator.address());
            stations.push(Station::new(folder.path.join(format!("{site}-shared")), &shared, &[Role::Device])?);
        }
    }
    Ok(stations)
}

/// The node processes by role, those of the observatories last; dropping them ends them through their standard input.
struct Nodes {
    children: Vec<Vec<tokio::process::Child>>,
}

impl Nodes {
    fn start(stations: &[Station], endpoint: &str) -> anyhow::Result<Self> {
        // They end in the other order: archives and web are the last, which send and store what the others report.
        let start = |role: Role| {
            let nodes =
                stations.iter().flat_map(|station| station.nodes(role).into_iter().map(move |id| (station, id)));
            let spawn =
                |(station, id): (&Station, &str)| process(&station.folder, &station.file, (role, id), endpoint).spawn();
            nodes.map(spawn).collect::<anyhow::Result<Vec<_>>>()
        };
        let roles = [Role::Web, Role::Archive, Role::Device, Role::Observatory];
        Ok(Self { children: roles.into_iter().map(start).collect::<anyhow::Result<_>>()? })
    }

    /// Stops them, the observatories first; those of one role together.
    async fn stop(self) -> anyhow::Result<()> {
        for of_role in self.children.into_iter().rev() {
            let mut ending: JoinSet<anyhow::Result<()>> =
                of_role.into_iter().map(|child| end(child, Duration::from_secs(25))).collect();
            while let Some(ended) = ending.join_next().await {
                ended??;
            }
        }
        Ok(())
    }
}

/// How a node of the demo is started: whatever it stores is in the demo's folder.
fn process(folder: &Path, file: &Path, (role, id): (Role, &str), endpoint: &str) -> NodeProcess {
    let log = if role == Role::Device { format!("{role}-{id}.log") } else { format!("{role}.log") };
    NodeProcess {
        role,
        id: id.to_owned(),
        config: file.to_owned(),
        arguments: vec!["--connect".to_owned(), endpoint.to_owned()],
        log: Some(folder.join(log)),
        with_parent: true,
        left: None,
        reports: None,
        // The guard process of a later demo in a folder of this name would look for this one's dome, at an address where
        // nobody answers.
        state: Some(folder.join("state")),
    }
}

/// The folder of the demo's files.
struct Folder {
    path: PathBuf,
    keep: bool,
}

impl Folder {
    fn new(keep: Option<&Path>) -> anyhow::Result<Self> {
        let path = match keep {
            Some(path) => path.to_owned(),
            None => std::env::temp_dir().join(format!("starmesh-demo-{}", std::process::id())),
        };
        std::fs::create_dir_all(&path).with_context(|| format!("cannot make the folder {}", path.display()))?;
        let path = path.canonicalize()?;
        anyhow::ensure!(
            std::fs::read_dir(&path)?.next().is_none(),
            "{} is not empty; --keep takes a new or empty folder, so that nothing of yours is overwritten",
            path.display()
        );
        Ok(Self { path, keep: keep.is_some() })
    }

    fn end(&self) {
        if self.keep {
            println!("kept in {}", self.path.display());
        } else {
            println!("the files are removed; --keep DIR keeps them");
            if let Err(error) = std::fs::remove_dir_all(&self.path) {
                eprintln!("starmesh: cannot remove {}: {error}", self.path.display());
            }
        }
    }
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// The port that was asked for, the usual one, or a free one; address given so that it can be bound later.
fn page_port(asked: Option<u16>) -> anyhow::Result<u16> {
    let free = |port: u16| {
        let bound = TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port)))?;
        Ok::<u16, std::io::Error>(bound.local_addr()?.port())
    };
    match asked {
        Some(port) => free(port).with_context(|| format!("port {port} cannot be used; choose another with --port")),
        None => free(USUAL_PORT).or_else(|_| free(0)).context("no port is free for the page"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_demo_stores_nothing_outside_of_its_folder() {
        let folder = Path::new("/tmp/demo");
        let command = process(folder, &folder.join("observatory.toml"), (Role::Device, "enclosure"), "tcp/127.0.0.1:1");
        let command = command.command(Path::new("starmesh"));
        let state = command.as_std().get_envs().find(|(name, _)| *name == "STATE_DIRECTORY");
        assert_eq!(state.unwrap().1, Some(folder.join("state").as_os_str()));
    }
}
