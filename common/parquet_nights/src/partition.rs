//! Where a file is, by table, site, telescope and night.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::ParquetError;
use crate::table::Table;

/// The files of one telescope below a folder.
#[derive(Debug, Clone)]
pub struct Partition {
    /// The folder of all tables, sites and telescopes.
    pub root: PathBuf,
    /// The site.
    pub site: String,
    /// The telescope whose archive wrote the rows.
    pub telescope: String,
}

/// The only file of a night's folder.
const PART: &str = "part-0.parquet";

impl Partition {
    fn of_table(&self, table: &Table) -> PathBuf {
        let site = self.root.join(table.name).join(format!("site={}", self.site));
        site.join(format!("telescope={}", self.telescope))
    }

    /// The file of a night, such as `20261121`.
    pub fn part(&self, table: &Table, night: &str) -> PathBuf {
        self.of_table(table).join(format!("night={night}")).join(PART)
    }

    /// What each file of a night has in itself, too.
    pub fn about<'a>(&'a self, night: &'a str) -> [(&'a str, &'a str); 3] {
        [("site", &self.site), ("telescope", &self.telescope), ("night", night)]
    }

    /// The nights that have a file of this table, the oldest first.
    ///
    /// # Errors
    /// A folder cannot be read.
    pub fn nights(&self, table: &Table) -> Result<BTreeSet<String>, ParquetError> {
        let nights = values(&self.of_table(table), "night=")?;
        Ok(nights.into_iter().filter(|night| self.part(table, night).is_file()).collect())
    }

    /// Which telescopes there are, for people.
    pub(crate) fn others(&self, tables: &[Table]) -> Result<String, ParquetError> {
        let mut found = BTreeSet::new();
        for table in tables {
            let folder = self.root.join(table.name);
            for site in values(&folder, "site=")? {
                let telescopes = values(&folder.join(format!("site={site}")), "telescope=")?;
                found.extend(telescopes.into_iter().map(|telescope| format!("{site}/{telescope}")));
            }
        }
        let found: Vec<String> = found.into_iter().collect();
        Ok(match found.as_slice() {
            [] => "it has no night of any telescope: name the folder that has the folders `telemetry`, `images` \
                   and so on"
                .to_owned(),
            all => format!("it has nights of {}", all.join(", ")),
        })
    }
}

/// The values of the folders `NAME=VALUE` in a folder; none where there is no such folder.
fn values(folder: &Path, name: &str) -> Result<BTreeSet<String>, ParquetError> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(BTreeSet::new()),
        entries => entries.map_err(ParquetError::io("read the folder", folder))?,
    };
    let mut found = BTreeSet::new();
    for entry in entries {
        let entry = entry.map_err(ParquetError::io("read the folder", folder))?;
        found.extend(entry.file_name().to_str().and_then(|text| text.strip_prefix(name)).map(str::to_owned));
    }
    Ok(found)
}
