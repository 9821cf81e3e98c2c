//! Compares the rows of a schedule with the devices, the clock and the sky, before anything moves.
//!
//! Pure: text and configuration in, findings out; `now` is given. docs/decisions/0027-what-refuses-a-schedule.md lists
//! which findings refuse a file and which are only reported.

mod device;
mod duration;
mod overlap;
mod sky_table;
mod twice;
mod visibility;
mod window;

use std::collections::BTreeMap;
use std::sync::Arc;

use config::{Horizon, Observatory};
use contract::Name;
use contract::observatory::{Finding, ScheduleFindings};
use units::Utc;

use self::sky_table::SkyTable;
use crate::fault::{Fault, MOST_FINDINGS, in_order};
use crate::fields::defaults_of;
pub use crate::horizon_limits::read as horizon;
use crate::names;
use crate::parse::{Reading, read_with};
use crate::row::{PartOfRow, Row};

/// The facts with which rows are compared.
#[derive(Debug, Clone)]
pub struct KnownFacts {
    config: Arc<Observatory>,
    /// Filters of each wheel that are known.
    pub filters: BTreeMap<Name, Vec<String>>,
    horizons: BTreeMap<Name, Horizon>,
    /// The sources that could not be read.
    unread: Vec<String>,
    /// The positions of the names that were looked up.
    pub names: names::KnownNames,
    /// Windows that ended before this have passed; where absent, they are not reported.
    now: Option<Utc>,
}

impl KnownFacts {
    /// From the configuration alone; reads the horizon files that it names, and the names that were looked up.
    pub fn of(config: Arc<Observatory>) -> Self {
        let names = names::KnownNames::read(&names::KnownNames::path(&config));
        Self::with_names(config, names)
    }

    /// From the configuration and the names that are known now; reads the horizon files that it names.
    pub fn with_names(config: Arc<Observatory>, names: names::KnownNames) -> Self {
        let named = |wheel: &config::FilterWheel| (wheel.common.name.clone(), wheel.filters.clone());
        let filters = config.filterwheel.iter().filter(|wheel| !wheel.filters.is_empty()).map(named).collect();
        let (mut horizons, mut unread) = (BTreeMap::new(), Vec::new());
        for mount in &config.telescope {
            let name = &mount.common.name;
            match mount.horizon.as_ref().map(horizon) {
                None => {}
                Some(Ok(horizon)) => drop(horizons.insert(name.clone(), horizon)),
                Some(Err(why)) => unread.push(format!("horizon of {name}: {why}")),
            }
        }
        Self { config, filters, horizons, unread, names, now: None }
    }

    /// With the filters that a wheel reports, which count before those of the configuration. It has the latter where it
    /// reports none, or has not been read yet.
    pub fn with_filters(mut self, wheel: &Name, filters: Vec<String>) -> Self {
        if !filters.is_empty() {
            self.filters.insert(wheel.clone(), filters);
        }
        self
    }

    /// With an instant before which windows have passed.
    pub fn at(mut self, now: Utc) -> Self {
        self.now = Some(now);
        self
    }

    fn cameras(&self) -> Vec<Name> {
        self.config.camera.iter().map(|camera| camera.common.name.clone()).collect()
    }

    fn camera(&self, name: &Name) -> Option<&config::Camera> {
        self.config.camera.iter().find(|camera| camera.common.name == *name)
    }

    fn mount(&self, row: &Row) -> Option<&config::Telescope> {
        let name = self.camera(&row.camera)?.telescope.as_ref();
        self.config.telescope.iter().find(|mount| Some(&mount.common.name) == name)
    }
}

/// Reads a schedule and refuses it if its rows cannot be executed; the sky is not checked.
///
/// # Errors
/// All findings that refuse the file.
pub fn accept(text: &str, known: &KnownFacts) -> Result<Vec<Row>, Fault> {
    let Reading { rows, parts, mut findings } = read_with(text, &known.cameras(), &defaults_of(&known.config.camera));
    findings.extend(device::check(&rows, &parts, known));
    in_order(&mut findings, MOST_FINDINGS);
    if findings.is_empty() { Ok(rows) } else { Err(Fault { findings }) }
}

/// All findings of a schedule.
pub fn validate(text: &str, known: &KnownFacts) -> ScheduleFindings {
    let Reading { rows, parts, mut findings } = read_with(text, &known.cameras(), &defaults_of(&known.config.camera));
    let (found, unchecked) = compared(&rows, &parts, known);
    findings.extend(found);
    let (errors, warnings) = in_order(&mut findings, MOST_FINDINGS);
    let rows = u32::try_from(rows.len()).unwrap_or(u32::MAX);
    ScheduleFindings { valid: errors == 0, rows, errors, warnings, findings, unchecked }
}

/// The findings of rows that were read, in the order of the file, and what could not be checked.
pub fn survey(rows: &[Row], known: &KnownFacts) -> (Vec<Finding>, Vec<String>) {
    compared(rows, &[], known)
}

/// As [`survey`], also of rows that could be read in part.
fn compared(rows: &[Row], parts: &[PartOfRow], known: &KnownFacts) -> (Vec<Finding>, Vec<String>) {
    let mut unchecked = known.unread.clone();
    unchecked.extend(device::unchecked(rows, parts, known));
    unchecked.extend(visibility::unchecked(rows, known));
    let mut findings = device::check(rows, parts, known);
    findings.extend(window::check(rows, parts, known.now));
    findings.extend(duration::check(rows, known));
    findings.extend(overlap::check(rows, known));
    match SkyTable::new(&known.config.place) {
        Ok(mut sky) => {
            findings.extend(visibility::check(rows, known, &mut sky));
            findings.extend(twice::check(rows, known, &mut sky));
            unchecked.extend(sky.unchecked());
        }
        Err(error) => unchecked.push(format!("the sky: {error}")),
    }
    in_order(&mut findings, usize::MAX);
    (findings, unchecked)
}
