//! `starmesh demo`: one simulated night through the real nodes, as processes, on a bus of their own.

mod progress;
mod site;

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use bus::{Bus, Clock};
use clap::Args;
use contract::Role;
use simulator::Simulator;
use units::Utc;

use crate::running;
use crate::supervise::{NodeProcess, end};
use progress::Progress;
use site::DemoNight;

/// Options of `starmesh demo`.
#[derive(Debug, Args)]
pub struct Options {
    /// Sky seconds per machine second; a night at 300 takes about two minutes.
    #[arg(long, default_value_t = 300.0)]
    speed: f64,
    /// Port of the page; a free one where absent and 8080 is taken.
    #[arg(long)]
    port: Option<u16>,
    /// Keep the configuration, FITS files, database and logs here; a new or empty folder.
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Side of the simulated camera, pixels.
    #[arg(long, default_value_t = site::CAMERA_PX)]
    size_px: u32,
    /// When the night has ended, go on serving the page until Ctrl-C.
    #[arg(long)]
    stay: bool,
}

const USUAL_PORT: u16 = 8080;

/// Runs the night; an error when it did not go well.
pub async fn run(options: Options) -> anyhow::Result<()> {
    anyhow::ensure!((1.0..=2000.0).contains(&options.speed), "--speed {}: expected 1 to 2000", options.speed);
    anyhow::ensure!((64..=8192).contains(&options.size_px), "--size-px {}: expected 64 to 8192", options.size_px);
    let port = page_port(options.port)?;
    let folder = Folder::new(options.keep.as_deref())?;
    observe(&options, port, &folder).await?;
    folder.end();
    Ok(())
}

async fn observe(options: &Options, port: u16, folder: &Folder) -> anyhow::Result<()> {
    let mut world = simulator::Options { speed: options.speed, ..Default::default() };
    world.dome.watchdog_s = Some(120.0);
    // Rows ask for 0.3 arcmin: this mount repeats its slews to less than that, as most do.
    world.mount.scatter_arcsec = 1.0;
    // The same field of 1.5 deg, whatever the camera's size.
    world.camera.pixel_um *= f64::from(world.camera.width) / f64::from(options.size_px);
    (world.camera.width, world.camera.height) = (options.size_px, options.size_px);
    let night = DemoNight::next(world.latitude, world.longitude, world.elevation_m, Clock::machine_clock().utc())?;
    world.start = night.start;
    let simulator = Simulator::start(world.clone()).await?;

    let config_file = folder.path.join("observatory.toml");
    write(&config_file, &site::configuration(simulator.address(), port, &world))?;
    write(&folder.path.join("schedule.jsonl"), &night.schedule()?)?;
    let (config, _) = node::configuration::read_config(&config_file)?;

    let clock = Clock::of_simulator(&format!("http://{}", simulator.address())).await?;
    let bus = Bus::open(&config.bus, clock.clone()).await?;
    let endpoint = bus.locators().await.into_iter().find(|locator| locator.contains("127.0.0.1"));
    let endpoint = endpoint.context("the demo's own bus listens nowhere")?;
    let mut progress = Progress::listen(&bus, &config.address()).await?;
    let nodes = Nodes::start(folder, &config_file, &config, &endpoint)?;
    let _running = running::announce("demo", &config.address(), &endpoint, &folder.path);

    let total_s = night.dawn.seconds_since(night.start) / options.speed;
    println!("one night of {} at speed {}, about {:.0} s", config.address(), options.speed, total_s);
    println!("  page      http://127.0.0.1:{port}/");
    println!("  files     {}", folder.path.join("images").display());
    println!("  database  {}", folder.path.join("data").join("archive.db").display());
    println!("  logs      {}", folder.path.display());
    println!(
        "  bus       {endpoint} (for other programs; `starmesh status`, `tail` and `order` find it by themselves)"
    );
    let shower = shower(&simulator, &clock, night.shower());
    let well = tokio::select! {
        ended = progress.follow(night.start, night.dawn) => {
            ended?;
            let (summary, well) = progress.summary();
            println!("{summary}");
            if options.stay {
                println!("the page stays at http://127.0.0.1:{port}/ ; Ctrl-C ends");
                tokio::signal::ctrl_c().await?;
            }
            well
        }
        () = shower => true,
        interrupted = tokio::signal::ctrl_c() => {
            interrupted?;
            println!("\ninterrupted; the nodes close what is open, and end");
            true
        }
    };
    nodes.stop().await?;
    simulator.stop().await;
    bus.close().await;
    anyhow::ensure!(well, "the night did not go well; the summary above and the logs say where");
    Ok(())
}

/// A shower of twelve minutes in the middle of the night, so that everyone sees a dome close and open again.
async fn shower(simulator: &Simulator, clock: &Clock, at: Utc) {
    let wait_s = at.seconds_since(clock.utc()).max(0.0);
    clock.sleep_sky(Duration::from_secs_f64(wait_s)).await;
    simulator.world().rain(true);
    clock.sleep_sky(Duration::from_secs(720)).await;
    simulator.world().rain(false);
    std::future::pending::<()>().await;
}

/// The node processes, the observatory node last; dropping them ends them through their standard input.
struct Nodes {
    children: Vec<tokio::process::Child>,
}

impl Nodes {
    fn start(folder: &Folder, file: &Path, config: &config::Observatory, endpoint: &str) -> anyhow::Result<Self> {
        // They end in the other order: archive and web are the last, which send and store what the others report.
        let mut nodes = [Role::Web, Role::Archive].map(|role| (role, config::MAIN_NODE)).to_vec();
        nodes.extend(config.device_nodes().into_iter().rev().map(|id| (Role::Device, id)));
        nodes.push((Role::Observatory, config::MAIN_NODE));
        let start = |(role, id): (Role, &str)| process(&folder.path, file, (role, id), endpoint).spawn();
        Ok(Self { children: nodes.into_iter().map(start).collect::<anyhow::Result<_>>()? })
    }

    /// Stops them, the observatory first.
    async fn stop(self) -> anyhow::Result<()> {
        for child in self.children.into_iter().rev() {
            end(child, Duration::from_secs(25)).await?;
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
