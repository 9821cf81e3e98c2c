//! The archive node: it stores the frames and the telemetry of a telescope.
//!
//! Frames come from the device nodes' spools ([`store`]): the archive fetches and proves them ([`download`]), names
//! them ([`name`]), writes them as FITS ([`fits`], [`header`]) under a temporary name, syncs, renames and records them,
//! and only then releases them. The values that devices poll and the lines of the nodes' diaries go into one SQLite
//! file ([`telemetry`], [`diary`], [`database`]), together with a copy of all nodes' audit ([`audit`]), the facts of
//! each frame ([`facts`]), the corrections of guiding ([`corrections`]), the fluxes of stars ([`photometry`]), and the focus runs with their plots
//! ([`focus`]), and what the observatory node did and why ([`happenings`]). From this file questions are answered ([`history`]), of single
//! frames and reports those in [`frames`], and headers completed ([`pass`], [`completion`])
//! with what was true when the exposure began ([`interpolate`], [`astronomy`]). The frames of one night ([`night`]) are what
//! is reported ([`night_report`]) and handed over.
//!
//! Values that are older than the site wants are left out of it, and it is copied each day ([`care`]). Finished nights are
//! written as Parquet into the network's archive, from which a database can be made again ([`parquet`]).
//! Each night is handed over to the destinations that the site names, and verified there ([`delivery`]), or copied by hand
//! with what is known of it ([`export`]).
//!
//! The samples of each publisher are followed by their numbers: what an archive that was away lacks comes from the
//! publishers, and what they hold no more is reported ([`streams`]).
//!
//! One archive of a telescope writes in a folder ([`folder`]); a slow spool delays no other ([`turns`]); files that an
//! older database does not know are found again ([`rebuild`]).
//!
//! Nothing here is in the safety path, and every step may be killed: a frame that was announced is stored once, a
//! header is the old one or the new one, a row counts once.
//!
//! # Invariants
//!
//! - A FITS file appears under its name only when it is whole, and a header is the old one or the new one:
//!   `a_kill_at_any_step_leaves_the_old_header_or_the_new_one`.
//! - A frame is released only after its file and its row are on disk:
//!   `a_frame_is_stored_once_released_completed_and_found_again_after_a_restart`.
//! - A database row counts a reading once: `a_reading_counts_once_and_keeps_its_type`.
//! - A plate solution is whole or not in the header at all:
//!   `a_table_with_a_word_of_its_own_gets_no_half_of_a_solution`.
//! - Measured facts are never replaced by a reason why there are none:
//!   `facts_are_stored_once_and_what_was_measured_never_gives_way_to_a_reason`.
//! - One archive of a telescope writes in a folder of images, and below that folder no link is followed (decision
//!   0064): `a_second_archive_of_one_telescope_is_refused_and_the_first_one_named`,
//!   `no_link_below_the_folder_of_images_is_followed`.
//! - A telescope is answered with its own rows, whoever shares its database (decision 0105):
//!   `every_question_about_a_night_is_answered_for_one_telescope`.
//! - A question about the past ends in time, and no frame waits for it (decision 0106):
//!   `frames_are_stored_while_the_largest_questions_are_looked_up`.
//! - The bytes, pictures and values of a frame are those of its own row's file, and no path or link leads elsewhere:
//!   `no_row_and_no_link_leads_out_of_the_folder_of_images`.
//! - A damaged database is put aside whole before a new one is written:
//!   `a_damaged_database_is_put_aside_and_a_new_one_takes_rows`.
//! - A file that is not there was removed only where its disk is there, and nothing is written into the place of one that is away:
//!   `a_file_that_is_not_there_was_removed_only_where_its_disk_is_there`,
//!   `an_archive_that_starts_while_its_disk_is_away_writes_nothing_into_the_place_of_the_disk`.
//! - The audit here is a copy: the archive asks the nodes, whose own files decide:
//!   `an_archive_that_was_away_has_every_record_in_its_order_afterwards`.

pub mod astronomy;
mod audit;
pub mod card;
mod care;
pub mod completion;
pub mod corrections;
pub mod database;
pub mod delivery;
mod diary;
pub mod export;
pub mod facts;
pub mod fits;
pub mod focus;
mod folder;
mod frames;
mod guided;
mod happenings;
pub mod header;
mod history;
pub mod interpolate;
pub mod keywords;
pub mod name;
pub mod night;
pub mod night_report;
mod pairing;
pub mod parquet;
pub mod pass;
mod photometry;
pub mod plan;
mod quality;
pub mod reader;
mod rebuild;
mod recompletion;
pub mod sensor;
pub mod solution;
mod store;
pub mod stored_header;
mod streams;
pub mod telemetry;
mod turns;

#[cfg(test)]
#[path = "../../common/contract/tests/shown/mod.rs"]
mod document;

use std::ops::ControlFlow::{self, Break, Continue};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicI64;
use std::time::Duration;

use anyhow::Context as _;
use contract::observatory::AlertKind;
use contract::{Address, Key, Scalar};
use node::Node;
use tokio::sync::{Notify, mpsc};
use tokio::task::{JoinError, JoinSet};

use crate::database::Database;
use crate::name::Namer;
use crate::reader::Reader;
use crate::telemetry::Newest;

/// Runs the archive of one telescope until the node is stopped.
pub async fn run(node: Node) -> anyhow::Result<()> {
    let config = node.config.clone();
    let (namer, wrong) =
        Namer::with_faults(&config.archive.filename, config.archive.profile, config.place.longitude_deg);
    for fault in wrong {
        // Frames under another name are better than no frames.
        let (key, why) =
            (format!("archive.filename.{}", fault.action), format!("{fault}; frames get their default names"));
        node.alerts.raise(AlertKind::Configuration, &key, &why);
    }
    for note in header::check(&node.header) {
        tracing::warn!(note, "a row of the FITS-header table is left out");
    }
    let Some(_claim) = claim_database(&node).await? else { return Ok(()) };
    let Some((database, writer)) = open_database(&node).await? else { return Ok(()) };
    let (stored_before, complete_before) =
        Reader::open(database.path(), config.place.telescope.as_str())?.image_counts()?;
    for (figure, count) in
        [("frames_stored", stored_before), ("headers_complete", complete_before), ("rows_written", 0)]
    {
        node.figure(figure, Scalar::Int(count));
    }
    let stored = Key::Stored(config.address());
    let stored = Arc::new(node.bus.publisher(&stored).await?);
    let (newest, incomplete) = (Newest::default(), Arc::new(Notify::new()));
    let _history = history::serve(&node).await?;
    let _frames = frames::serve(&node).await?;
    let stop = node.stop.clone();

    let (plots, to_draw) = mpsc::unbounded_channel();
    let mut tasks = JoinSet::new();
    tasks.spawn(telemetry::keep(node.clone(), database.clone(), newest.clone()));
    tasks.spawn(notify::keep_substituting(node.clone(), None));
    tasks.spawn(diary::keep(node.clone(), database.clone()));
    tasks.spawn(audit::keep(node.clone(), database.clone()));
    tasks.spawn(happenings::keep(node.clone(), database.clone()));
    tasks.spawn(facts::keep(node.clone(), database.clone(), incomplete.clone()));
    tasks.spawn(focus::keep(node.clone(), database.clone(), plots));
    tasks.spawn(corrections::keep(node.clone(), database.clone()));
    tasks.spawn(care::keep(node.clone(), database.clone()));
    // The disk of images may be away, or hang at the first look, which keeps nothing else waiting, and no stop.
    let claim = async {
        tokio::select! {
            ended = tasks.join_next() => first_to_end(ended).map(|()| None),
            claimed = claim_images(&node, database.path()) => claimed,
        }
    };
    let claimed = stop.or(claim).await.unwrap_or(Ok(None));
    let result = if let Ok(Some(_)) = &claimed {
        let (on_disk, found) = rebuild::OnDisk::new(node.bus.clock().utc());
        tasks.spawn(rebuild::keep(node.clone(), database.clone(), incomplete.clone(), found));
        tasks.spawn(night_report::keep(node.clone(), database.clone()));
        tasks.spawn(delivery::keep(node.clone(), database.path().to_owned()));
        tasks.spawn(recompletion::keep(node.clone(), database.clone(), incomplete.clone()));
        tasks.spawn(photometry::keep(node.clone(), database.clone()));
        tasks.spawn(focus::draw(node.clone(), to_draw));
        tasks.spawn(store::keep(store::Store {
            node: node.clone(),
            database: database.clone(),
            newest: newest.clone(),
            namer,
            stored: stored.clone(),
            incomplete: incomplete.clone(),
            count: AtomicI64::new(stored_before),
            naming: tokio::sync::Mutex::default(),
            on_disk,
            failing: store::Failing::default(),
        }));
        tasks.spawn(pass::keep(pass::Pass {
            node: node.clone(),
            database,
            newest,
            stored,
            incomplete,
            count: AtomicI64::new(complete_before),
        }));
        stop.or(tasks.join_next()).await.map_or(Ok(()), first_to_end)
    } else {
        drop(database);
        Ok(())
    };
    // The last clones of the database go with the tasks, and then the writer ends with everything written.
    tasks.shutdown().await;
    writer.end().await;
    claimed.and(result)
}

/// What the first part that ended says.
fn first_to_end(ended: Option<Result<anyhow::Result<()>, JoinError>>) -> anyhow::Result<()> {
    match ended {
        Some(Ok(ended)) => ended.context("a part of the archive ended"),
        Some(Err(error)) => Err(error).context("a part of the archive ended badly"),
        None => Ok(()),
    }
}

/// A database that cannot be opened is tried again after this.
const AGAIN: Duration = Duration::from_secs(15);

/// Takes the database, again and again while the disk refuses it; absent when the node is stopped before.
async fn claim_database(node: &Node) -> anyhow::Result<Option<folder::Claim>> {
    let (file, telescope, who) = (&node.config.archive.database, node.config.address(), node.signature());
    loop {
        let taken = folder::claim_database(file, &telescope, &who).await;
        if let Break(claim) = claimed(node, "archive.database", "nothing is archived", taken).await? {
            return Ok(claim);
        }
    }
}

/// Takes the folder of images, again and again while the disk refuses it or is away; absent when the node is stopped before.
async fn claim_images(node: &Node, database: &Path) -> anyhow::Result<Option<folder::Claim>> {
    let (images, telescope, who) = (&node.config.folders.images, node.config.address(), node.signature());
    loop {
        let (bare, file, name) = (images.clone(), database.to_owned(), telescope.clone());
        let taken = match tokio::task::spawn_blocking(move || disk_is_there(&bare, &file, &name)).await? {
            Ok(()) => folder::claim(images, &telescope, &who).await,
            Err(away) => Err(away.into()),
        };
        if let Break(claim) = claimed(node, "folders.images", "no frame is archived", taken).await? {
            return Ok(claim);
        }
    }
}

/// Goes on with what was taken of the configuration's entry `name`; where the disk refuses it, an alert tells what is
/// `missing`, and it is to be tried again after a pause. Absent when the node is stopped before.
///
/// # Errors
/// Another archive has it.
async fn claimed(
    node: &Node,
    name: &str,
    missing: &str,
    taken: anyhow::Result<folder::Claim>,
) -> anyhow::Result<ControlFlow<Option<folder::Claim>>> {
    let why = match taken {
        Ok(claim) => {
            node.alerts.clear(AlertKind::Configuration, name);
            return Ok(Break(Some(claim)));
        }
        Err(error) if error.chain().any(|cause| cause.is::<std::io::Error>()) => error,
        Err(taken) => return Err(taken),
    };
    let why = format!("{name}: {why:#}; {missing} until it can be used, which is tried each 15 s");
    node.alerts.raise(AlertKind::Configuration, name, &why);
    Ok(match node.stop.or(tokio::time::sleep(AGAIN)).await {
        Some(()) => Continue(()),
        None => Break(None),
    })
}

/// Proves that the folder of images is not the bare place of a disk: what was written there would lie under the disk later.
///
/// # Errors
/// It is missing or empty, although the database knows frames in it.
fn disk_is_there(images: &Path, database: &Path, telescope: &Address) -> std::io::Result<()> {
    // A database that is new, damaged or of an older Starmesh says nothing.
    let known = Reader::open(database, telescope.telescope.as_str()).and_then(|reader| reader.image_counts());
    match known {
        Ok((frames @ 1.., _)) if folder::is_bare(images) => Err(std::io::Error::other(format!(
            "the database has {frames} frames, and the folder of images {} is missing or empty: its disk may be away. Mount it; if \
             the folder is a new one, make the folder {} in it",
            images.display(),
            folder::PART_FOLDER
        ))),
        _ => Ok(()),
    }
}

/// Opens the database, again and again until that succeeds; absent when the node is stopped before.
async fn open_database(node: &Node) -> anyhow::Result<Option<(Database, database::Writer)>> {
    loop {
        let file = node.config.archive.database.clone();
        let why = match Database::open(&file, node.config.place.telescope.as_str(), node.alerts.clone()) {
            Ok(open) => {
                node.alerts.clear(AlertKind::Configuration, "archive.database");
                return Ok(Some(open));
            }
            Err(error) => error,
        };
        let why =
            format!("archive.database: {why}; no frame is archived until it can be opened, which is tried each 15 s");
        node.alerts.raise(AlertKind::Configuration, "archive.database", &why);
        if node.stop.or(tokio::time::sleep(AGAIN)).await.is_none() {
            return Ok(None);
        }
    }
}

/// Puts a copy in the place of the telescope's database; returns under which name the database of before is kept.
///
/// # Errors
/// An archive node uses the database, or the copy is no database of an archive.
pub async fn restore(config: &config::Observatory, copy: &Path) -> anyhow::Result<Option<PathBuf>> {
    let database = &config.archive.database;
    let who = "starmesh archive restore";
    let telescope = config.address();
    let _claim = folder::claim_database(database, &telescope, who).await?;
    let _others = folder::claim_from_others(database, &telescope, who).await?;
    let (copy, database) = (copy.to_owned(), database.clone());
    tokio::task::spawn_blocking(move || database::restore(&copy, &database)).await?
}
