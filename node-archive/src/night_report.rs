//! The report of a night: made of the database on request, and written next to the frames when the night has ended.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use config::Observatory;
use node::Node;
use report::Report;
use sky::{NightDate, Observer};
use units::Utc;

use crate::database::Database;
use crate::folder::put;
use crate::night::Night;
use crate::reader::Reader;

/// Folder of the reports, inside the folder of images.
const FOLDER: &str = "reports";
/// How often it is looked whether a night has ended, machine time.
const EVERY: Duration = Duration::from_secs(20);
/// After the end of a night so long for its last frames, headers and log lines to arrive, sky s.
const AFTER_S: f64 = 60.0;
/// Nights whose reports are written late, as when the archive node was away in the morning.
const NIGHTS_BACK: u32 = 7;

/// The report of a night until `now`.
///
/// # Errors
/// The database cannot be read, or the sky over the site cannot be computed.
pub fn make(config: &Observatory, reader: &Reader, night: &Night, now: Utc) -> anyhow::Result<Report> {
    let mut events = reader.night_events(night, now)?;
    events.site = config.place.site.to_string();
    events.telescope = config.place.telescope.to_string();
    events.dark = dark(&config.place, night)?;
    // `as` saturates.
    events.free_bytes = node::free_gb(config.folders.images.clone()).map(|free_gb| (free_gb * 1e9) as u64);
    Ok(report::make(&events))
}

/// Sunset and sunrise; the noons where the Sun does not rise, absent where it does not set.
fn dark(place: &config::Place, night: &Night) -> anyhow::Result<Option<(Utc, Utc)>> {
    let (site, orientation) = place.on_earth()?;
    let middle = Utc::from_micros(i64::midpoint(night.from.micros(), night.to.micros()));
    let sun = sky::night(&site, &orientation, middle)?;
    if let (Some(sunset), Some(sunrise)) = (sun.sunset, sun.sunrise) {
        return Ok(Some((sunset, sunrise)));
    }
    let is_down = |at: Utc| -> anyhow::Result<bool> {
        Ok(Observer::new(&site, &orientation, at)?.sun().altitude.degrees() < sky::Night::SUNSET.degrees())
    };
    // Around the first and last night of the polar day only one of both is there.
    Ok(match (sun.sunset, sun.sunrise) {
        (Some(sunset), None) => Some((sunset, night.to)),
        (None, Some(sunrise)) => Some((night.from, sunrise)),
        _ => is_down(middle)?.then_some((night.from, night.to)),
    })
}

/// The files of a night's report, below the folder of images.
pub fn files(images: &Path, night: &Night) -> [PathBuf; 2] {
    ["html", "json"].map(|ending| images.join(FOLDER).join(format!("{}.{ending}", night.date)))
}

/// Writes a report next to the frames, each file whole or not at all.
///
/// # Errors
/// The folder does not take it.
pub fn write(images: &Path, night: &Night, report: &Report) -> io::Result<()> {
    let [page, json] = files(images, night);
    put(images, &json, &serde_json::to_vec_pretty(report)?)?;
    put(images, &page, report::html::page(report).as_bytes())
}

/// Writes the report of each night that has ended, once it has: when the schedule has ended and everything is closed,
/// and again after the night's last second, since what happens in between belongs to it.
pub async fn keep(node: Node, database: Database) -> anyhow::Result<()> {
    let mut written: BTreeMap<NightDate, Ending> = BTreeMap::new();
    loop {
        let now = node.bus.clock().utc();
        let (config, file) = (node.config.clone(), database.path().to_owned());
        let before = written.clone();
        let look = move || -> anyhow::Result<Option<(Night, Ending)>> {
            let reader = Reader::open(&file, config.place.telescope.as_str())?;
            let Some((night, ending)) = due(&config, &reader, now, &before)? else { return Ok(None) };
            let report = make(&config, &reader, &night, now)?;
            for what in &report.unreadable {
                tracing::warn!(night = %night.date, what, "a row is left out of the report: it cannot be read");
            }
            write(&config.folders.images, &night, &report)?;
            Ok(Some((night, ending)))
        };
        match tokio::task::spawn_blocking(look).await? {
            Ok(None) => {}
            Ok(Some((night, ending))) => {
                written.insert(night.date, ending);
                tracing::info!(night = %night.date, "the report of the night is written");
            }
            Err(error) => tracing::warn!(
                error = format!("{error:#}"),
                "the report of the night is not written; it is tried again, and `starmesh night report` makes it too"
            ),
        }
        tokio::time::sleep(EVERY).await;
    }
}

/// What ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ending {
    /// The schedule, when everything was closed at this instant.
    Schedule(Utc),
    /// The night.
    Night,
}

/// The newest night that has ended and whose report is not written, of those of which anything is known.
fn due(
    config: &Observatory,
    reader: &Reader,
    now: Utc,
    written: &BTreeMap<NightDate, Ending>,
) -> anyhow::Result<Option<(Night, Ending)>> {
    let mut next = Night::at(now, &config.place);
    for back in 0..=NIGHTS_BACK {
        let night = next;
        next = Night::new(night.date.previous(), &config.place);
        if !reader.is_recorded(&night)? {
            continue;
        }
        let Some(ending) = ended(config, reader, &night, now)? else { continue };
        // A node that has started again writes the newest night again; older ones only where they are missing.
        let is_there = || files(&config.folders.images, &night).iter().all(|file| file.exists());
        if written.get(&night.date) != Some(&ending) && (back <= 1 || !is_there()) {
            return Ok(Some((night, ending)));
        }
    }
    Ok(None)
}

/// How a night has ended; absent while it lasts.
fn ended(config: &Observatory, reader: &Reader, night: &Night, now: Utc) -> anyhow::Result<Option<Ending>> {
    let over = dark(&config.place, night)?.map_or(night.to, |(_, sunrise)| sunrise);
    if now.seconds_since(over) >= AFTER_S {
        return Ok(Some(Ending::Night));
    }
    // A schedule that has ended the day before has not ended this night.
    let Some(newest) = reader.newest_doing(Some(now))?.filter(|newest| newest.state.ended) else { return Ok(None) };
    let is_over = now.seconds_since(newest.from) >= AFTER_S && reader.has_happened(night)?;
    Ok(is_over.then_some(Ending::Schedule(newest.from)))
}

/// The time of the telescope as its archive knows it: that of the newest state where it is simulated, else the clock's.
///
/// # Errors
/// The database cannot be read.
pub fn now(reader: &Reader, clock: Utc) -> anyhow::Result<Utc> {
    let newest = reader.newest_doing(None)?.filter(|newest| newest.state.simulated);
    Ok(newest.map_or(clock, |newest| newest.until))
}

#[cfg(test)]
mod tests;
