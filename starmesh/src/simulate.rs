//! `starmesh simulator`: a simulated observatory over Alpaca, to try a configuration against.

use std::net::SocketAddr;

use clap::Args;
use simulator::Simulator;
use units::{Angle, Utc};

/// Options of `starmesh simulator`.
#[derive(Debug, Args)]
pub struct Options {
    /// Where the Alpaca server listens.
    #[arg(long, default_value = "127.0.0.1:11111")]
    bind: SocketAddr,
    /// Sky time at the start, such as 2026-11-21T01:00:00Z; now where absent.
    #[arg(long)]
    start: Option<Utc>,
    /// Sky seconds per machine second.
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
    /// Latitude, degrees, north positive.
    #[arg(long, allow_negative_numbers = true)]
    latitude_deg: Option<f64>,
    /// Longitude, degrees, east positive.
    #[arg(long, allow_negative_numbers = true)]
    longitude_deg: Option<f64>,
    /// Camera size, pixels along each side.
    #[arg(long)]
    size_px: Option<u32>,
    /// Time the dome's shutter takes from end to end, sky seconds.
    #[arg(long)]
    shutter_s: Option<f64>,
    /// Turning speed of the dome, degrees per sky second.
    #[arg(long)]
    turn_deg_per_s: Option<f64>,
    /// A roof instead of a dome: nothing turns, and there is no slit.
    #[arg(long)]
    roof: bool,
    /// Speed of each axis of the mount, degrees per sky second.
    #[arg(long)]
    slew_deg_per_s: Option<f64>,
    /// Answer Alpaca discovery on this UDP port (32227 is Alpaca's).
    #[arg(long)]
    discovery_port: Option<u16>,
}

/// Serves until Ctrl-C.
pub async fn run(options: Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.speed > 0.0 && options.speed <= 5000.0, "--speed {}: expected 0 to 5000", options.speed);
    for (name, value) in [
        ("--shutter-s", options.shutter_s),
        ("--turn-deg-per-s", options.turn_deg_per_s),
        ("--slew-deg-per-s", options.slew_deg_per_s),
    ] {
        anyhow::ensure!(value.is_none_or(|v| v > 0.0 && v.is_finite()), "{name}: expected a number greater than 0");
    }
    let mut chosen = simulator::Options { bind: options.bind, speed: options.speed, ..Default::default() };
    chosen.discovery_port = options.discovery_port;
    chosen.start = options.start.unwrap_or(chosen.start);
    chosen.latitude = options.latitude_deg.map_or(chosen.latitude, Angle::from_degrees);
    chosen.longitude = options.longitude_deg.map_or(chosen.longitude, Angle::from_degrees);
    chosen.dome.shutter_s = options.shutter_s.unwrap_or(chosen.dome.shutter_s);
    chosen.dome.turn_deg_per_s = options.turn_deg_per_s.unwrap_or(chosen.dome.turn_deg_per_s);
    if options.roof {
        chosen.dome.slit = None;
    }
    chosen.mount.slew_deg_per_s = options.slew_deg_per_s.unwrap_or(chosen.mount.slew_deg_per_s);
    if let Some(size) = options.size_px {
        (chosen.camera.width, chosen.camera.height) = (size, size);
    }
    let simulator = Simulator::start(chosen).await?;
    println!("simulated observatory at http://{}/ ; Ctrl-C stops", simulator.address());
    tokio::signal::ctrl_c().await?;
    simulator.stop().await;
    Ok(())
}
