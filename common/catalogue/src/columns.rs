//! Which column of a table is what.

use crate::error::CatalogueError;
use crate::reading::Reading;
use std::path::Path;

/// A magnitude of Gaia or 2MASS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Band {
    /// Gaia G.
    G,
    /// Gaia BP.
    Bp,
    /// Gaia RP.
    Rp,
    /// 2MASS J.
    J,
    /// 2MASS H.
    H,
    /// 2MASS Ks.
    Ks,
}

impl Band {
    /// All of them, in the order in which one stands in for another that a star does not have.
    pub const ALL: [Self; 6] = [Self::G, Self::J, Self::Rp, Self::Bp, Self::H, Self::Ks];

    /// The band of a word such as `G`, `BP` or `Ks`, whatever its case.
    pub fn named(word: &str) -> Option<Self> {
        Some(match word.trim().to_ascii_lowercase().as_str() {
            "g" => Self::G,
            "bp" => Self::Bp,
            "rp" => Self::Rp,
            "j" => Self::J,
            "h" => Self::H,
            "k" | "ks" => Self::Ks,
            _ => return None,
        })
    }

    /// What columns of this magnitude are called: by the Gaia archive, the Gaia-2MASS files, VizieR and 2MASS.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Self::G => &["phot_g_mean_mag", "gmag", "g_mag"],
            Self::Bp => &["phot_bp_mean_mag", "bpmag", "bp_mag"],
            Self::Rp => &["phot_rp_mean_mag", "rpmag", "rp_mag"],
            Self::J => &["j_m", "jmag", "j_mag"],
            Self::H => &["h_m", "hmag", "h_mag"],
            Self::Ks => &["ks_m", "k_m", "kmag", "ksmag", "ks_mag"],
        }
    }
}

const RA: &[&str] = &["ra", "ra_deg", "ra_icrs", "raj2000", "ra_j2000", "_ra"];
const DEC: &[&str] = &["dec", "dec_deg", "de_icrs", "dec_icrs", "dej2000", "decj2000", "dec_j2000", "_de"];
const PM_RA: &[&str] = &["pmra", "pm_ra", "pmra_mas", "pmra_cosdec"];
const PM_DEC: &[&str] = &["pmdec", "pm_dec", "pmde", "pmdec_mas"];
const EPOCH: &[&str] = &["epoch", "ref_epoch", "epoch_year"];
const MAG: &[&str] = &["mag", "magnitude", "vmag", "vtmag"];

/// The numbers of the columns of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Columns {
    /// Right ascension, degrees.
    pub ra: usize,
    /// Declination, degrees.
    pub dec: usize,
    /// Proper motion in right ascension times cos(dec), mas/yr.
    pub pm_ra: Option<usize>,
    /// Proper motion in declination, mas/yr.
    pub pm_dec: Option<usize>,
    /// Magnitude, and those that stand in where a star has none of it.
    pub mags: Vec<usize>,
    /// Epoch of the position, Julian year.
    pub epoch: Option<usize>,
    /// Whether its proper motion is known, where such a column tells.
    pub pm_known: Option<usize>,
    /// Whether the star is Gaia's (epoch 2016.0) or not (2000.0), where no column tells the epoch.
    pub gaia: Option<usize>,
}

impl Columns {
    /// Finds the columns by their names, whatever their case.
    ///
    /// # Errors
    /// [`CatalogueError::Content`] when there is no position or no magnitude, naming what there is.
    pub fn find(file: &Path, names: &[String], reading: &Reading) -> Result<Self, CatalogueError> {
        let first = |wanted: &[&str]| {
            wanted.iter().find_map(|word| names.iter().position(|name| name.trim().eq_ignore_ascii_case(word)))
        };
        let refuse = |what: String| {
            CatalogueError::content(file, format!("has no {what} among its columns {}", names.join(", ")))
        };
        let needed = |what: &str, wanted: &[&str]| {
            first(wanted).ok_or_else(|| refuse(format!("{what} (degrees; called {})", wanted.join(", "))))
        };
        let band = match reading.band {
            Some(band) => Some(
                first(band.names())
                    .ok_or_else(|| refuse(format!("magnitude {band:?} (called {})", band.names().join(", "))))?,
            ),
            None => first(MAG),
        };
        let stand_in = Band::ALL.iter().filter_map(|band| first(band.names()));
        let mut mags: Vec<usize> = Vec::new();
        for column in band.into_iter().chain(stand_in).chain(first(MAG)) {
            if !mags.contains(&column) {
                mags.push(column);
            }
        }
        if mags.is_empty() {
            return Err(refuse("magnitude (called mag, or as Gaia and 2MASS do)".to_owned()));
        }
        let columns = Self {
            ra: needed("right ascension", RA)?,
            dec: needed("declination", DEC)?,
            pm_ra: first(PM_RA),
            pm_dec: first(PM_DEC),
            mags,
            epoch: first(EPOCH),
            pm_known: first(&["pm_known"]),
            gaia: first(&["gaia"]),
        };
        if columns.pm_ra.is_some() != columns.pm_dec.is_some() {
            return Err(refuse("pair of proper motions: one of pmra and pmdec is missing".to_owned()));
        }
        Ok(columns)
    }
}
