//! `starmesh simulator`: a simulated observatory over Alpaca, to try a configuration against.

use std::net::SocketAddr;

use clap::Args;
use simulator::{Simulator, Transit};
use units::{Angle, Utc};

/// Options of `starmesh simulator`.
#[derive(Debug, Args)]
pub struct Options {
    /// Where the Alpaca server listens.
    #[arg(long, default_value = "127.0.0.1:11111", value_parser = address)]
    bind: SocketAddr,
    /// Sky time at the start, such as 2026-11-21T01:00:00Z; now where absent.
    #[arg(long)]
    start: Option<Utc>,
    /// Hours by which the sky is ahead of this machine's clock: so simulators on several hosts agree, and it can be night by day.
    #[arg(long, allow_negative_numbers = true, conflicts_with = "start", value_parser = shift)]
    shift_h: Option<f64>,
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
    /// Side of a pixel, um; with the telescope's 1055 mm, 54 um and 512 pixels a field of 1.5 deg.
    #[arg(long)]
    pixel_um: Option<f64>,
    /// Full width of the stars that the optics alone give, arcsec.
    #[arg(long)]
    optics_fwhm_arcsec: Option<f64>,
    /// Time the dome's shutter takes from end to end, sky seconds.
    #[arg(long)]
    shutter_s: Option<f64>,
    /// Turning speed of the dome, degrees per sky second.
    #[arg(long)]
    turn_deg_per_s: Option<f64>,
    /// A roof instead of a dome: nothing turns, and there is no slit.
    #[arg(long)]
    roof: bool,
    /// The dome closes by itself when it is not fed for so long, machine seconds (its action `feedwatchdog`); never where absent.
    #[arg(long)]
    watchdog_s: Option<f64>,
    /// Speed of each axis of the mount, degrees per sky second.
    #[arg(long)]
    slew_deg_per_s: Option<f64>,
    /// Play of the mount's declination gear, arcsec.
    #[arg(long)]
    dec_backlash_arcsec: Option<f64>,
    /// Play of the focuser's gear, steps.
    #[arg(long)]
    focus_backlash_steps: Option<f64>,
    /// A guide scope on the same mount, as camera 1.
    #[arg(long)]
    guide_camera: bool,
    /// A star whose light falls and returns, as when a planet passes before it: its place (ICRS, degrees), depth, mid-time, duration from
    /// the first loss of light to the last, and duration of either slope, such as
    /// ra=24.3543,dec=-45.6779,depth-mmag=15,mid=2026-11-21T01:20:00Z,duration-min=50,ingress-min=8; may be given several times.
    #[arg(long)]
    transit: Vec<Transit>,
    /// Answer Alpaca discovery on this UDP port (32227 is Alpaca's).
    #[arg(long)]
    discovery_port: Option<u16>,
}

/// Serves until Ctrl-C.
pub async fn run(options: Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.speed > 0.0 && options.speed <= 5000.0, "--speed {}: expected 0 to 5000", options.speed);
    for (name, value) in [
        ("--pixel-um", options.pixel_um),
        ("--optics-fwhm-arcsec", options.optics_fwhm_arcsec),
        ("--shutter-s", options.shutter_s),
        ("--turn-deg-per-s", options.turn_deg_per_s),
        ("--slew-deg-per-s", options.slew_deg_per_s),
        ("--watchdog-s", options.watchdog_s),
    ] {
        anyhow::ensure!(value.is_none_or(|v| v > 0.0 && v.is_finite()), "{name}: expected a number greater than 0");
    }
    for (name, play) in [
        ("--dec-backlash-arcsec", options.dec_backlash_arcsec),
        ("--focus-backlash-steps", options.focus_backlash_steps),
    ] {
        anyhow::ensure!(play.is_none_or(|v| (0.0..=3600.0).contains(&v)), "{name}: expected 0 to 3600");
    }
    let mut chosen = simulator::Options { bind: options.bind, speed: options.speed, ..Default::default() };
    chosen.discovery_port = options.discovery_port;
    chosen.start = options.start.unwrap_or(chosen.start).plus_seconds(options.shift_h.unwrap_or(0.0) * 3600.0);
    chosen.latitude = options.latitude_deg.map_or(chosen.latitude, Angle::from_degrees);
    chosen.longitude = options.longitude_deg.map_or(chosen.longitude, Angle::from_degrees);
    chosen.dome.shutter_s = options.shutter_s.unwrap_or(chosen.dome.shutter_s);
    chosen.dome.turn_deg_per_s = options.turn_deg_per_s.unwrap_or(chosen.dome.turn_deg_per_s);
    chosen.dome.watchdog_s = options.watchdog_s;
    if options.roof {
        chosen.dome.slit = None;
    }
    chosen.mount.slew_deg_per_s = options.slew_deg_per_s.unwrap_or(chosen.mount.slew_deg_per_s);
    chosen.mount.dec_backlash_arcsec = options.dec_backlash_arcsec.unwrap_or(chosen.mount.dec_backlash_arcsec);
    chosen.focus.backlash_steps = options.focus_backlash_steps.unwrap_or(chosen.focus.backlash_steps);
    chosen.guide_camera = options.guide_camera.then(Default::default);
    if let Some(size) = options.size_px {
        (chosen.camera.width, chosen.camera.height) = (size, size);
    }
    chosen.transits = options.transit;
    chosen.camera.pixel_um = options.pixel_um.unwrap_or(chosen.camera.pixel_um);
    chosen.camera.optics_fwhm_arcsec = options.optics_fwhm_arcsec.unwrap_or(chosen.camera.optics_fwhm_arcsec);
    let simulator = Simulator::start(chosen).await?;
    println!("simulated observatory at http://{}/ ; Ctrl-C stops", simulator.address());
    tokio::signal::ctrl_c().await?;
    simulator.stop().await;
    Ok(())
}

fn shift(text: &str) -> Result<f64, String> {
    let hours = text.parse().ok().filter(|hours| (-87_600.0..=87_600.0).contains(hours));
    hours.ok_or_else(|| "expected hours from -87600 to 87600".to_owned())
}

fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| "expected an address and a port, such as 127.0.0.1:11111".to_owned())
}
