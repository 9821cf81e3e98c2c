//! `starmesh up`: starts and supervises the nodes of one telescope, one process per role.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

use bus::{Bus, Clock, Stop};
use clap::Args;
use contract::device::dome::{Fields, Shutter};
use contract::{DeviceState, Key, Kind, Role};

use crate::supervise::NodeProcess;

/// Options of `starmesh up`.
#[derive(Debug, Args)]
pub struct Options {
    /// The telescope's observatory.toml.
    file: PathBuf,
    /// Extra arguments for every node, such as --connect tcp/10.0.0.5:7447.
    #[arg(last = true)]
    node_arguments: Vec<String>,
}

/// Runs until Ctrl-C; then the device nodes stay until their guards have closed the enclosures.
pub async fn run(options: Options) -> anyhow::Result<()> {
    let (config, _) = bus::node::read_config(&options.file)?;
    // the nodes of one host meet here even where multicast does not work, and are introduced to each other by gossip
    let meeting = config::Bus { listen: vec!["tcp/127.0.0.1:0".to_owned()], ..config.bus.clone() };
    let bus = Bus::open(&meeting, Clock::machine_clock()).await?;
    let mut arguments = options.node_arguments.clone();
    for locator in bus.locators().await {
        arguments.extend(["--connect".to_owned(), locator]);
    }
    let node = |role, id: &str| NodeProcess {
        role,
        id: id.to_owned(),
        config: options.file.clone(),
        arguments: arguments.clone(),
        log: None,
        with_parent: role != Role::Device,
    };
    let ids: BTreeSet<String> = config
        .devices()
        .iter()
        .map(|(_, common)| common.node.as_ref().map_or("main".to_owned(), ToString::to_string))
        .collect();
    let (brains, hands) = (Stop::default(), Stop::default());
    let mut devices = tokio::task::JoinSet::new();
    for id in ids {
        let (node, stop) = (node(Role::Device, &id), hands.clone());
        devices.spawn(async move { node.keep(stop).await });
    }
    let mut others = tokio::task::JoinSet::new();
    let shared = config.place.telescope.as_str() == contract::Address::SHARED;
    let roles = [Role::Observatory, Role::Archive, Role::Web];
    for role in roles.into_iter().filter(|role| !(shared && *role == Role::Observatory)) {
        let (node, stop) = (node(role, "main"), brains.clone());
        others.spawn(async move { node.keep(stop).await });
    }
    println!("{}: nodes started; the page is at http://{}/ ; Ctrl-C stops", config.address(), config.web.listen);
    tokio::select! {
        interrupted = tokio::signal::ctrl_c() => interrupted?,
        // a node that cannot even be started ends the whole, with its reason
        Some(ended) = devices.join_next() => ended??,
        Some(ended) = others.join_next() => ended??,
    }
    println!("stopping; without an observatory node the guards close the enclosures");
    brains.stop();
    while others.join_next().await.is_some() {}
    wait_closed(&config, &bus).await?;
    hands.stop();
    while devices.join_next().await.is_some() {}
    bus.close().await;
    Ok(())
}

/// Waits until every enclosure of this telescope is closed, at most five minutes.
async fn wait_closed(config: &config::Observatory, bus: &Bus) -> anyhow::Result<()> {
    let mut domes = Vec::new();
    for dome in &config.dome {
        let key = Key::State(config.address().device(Kind::Dome, &dome.common.name));
        domes.push((dome.common.name.clone(), bus.latest::<DeviceState<Fields>>(&key).await?));
    }
    for _ in 0..300 {
        let fresh = Duration::from_secs(5);
        let open = domes.iter().find(|(_, dome)| {
            let shutter = dome.fresh(fresh).and_then(|heard| heard.said.body.fields.shutter.known().copied());
            shutter != Some(Shutter::Closed)
        });
        let Some((name, _)) = open else { return Ok(()) };
        println!("waiting for {name} to close");
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    eprintln!("starmesh: an enclosure is still not verified closed; look at it");
    Ok(())
}
