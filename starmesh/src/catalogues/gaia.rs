//! Stars of Gaia DR3 in a circle, from a TAP service (IVOA Table Access Protocol 1.1), with a cache of the answers.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use catalogue::Band;
use clap::ValueEnum;
use sha2::{Digest as _, Sha256};

use super::http;

/// Stars of one answer; the services end at three million.
const MOST_STARS: u64 = 2_900_000;

/// The servers that have Gaia's stars.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Service {
    /// The Gaia archive of ESA.
    Esa,
    /// VizieR at CDS, Strasbourg.
    Vizier,
}

impl Service {
    /// The endpoint that answers at once.
    pub fn url(self) -> &'static str {
        match self {
            Self::Esa => "https://gea.esac.esa.int/tap-server/tap/sync",
            Self::Vizier => "https://tapvizier.cds.unistra.fr/TAPVizieR/tap/sync",
        }
    }
}

/// The circle that is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    /// ICRS right ascension of the centre, degrees.
    pub ra_deg: f64,
    /// ICRS declination of the centre, degrees.
    pub dec_deg: f64,
    /// Radius, degrees.
    pub radius_deg: f64,
    /// Faintest magnitude G.
    pub faintest_mag: f64,
}

/// The question in ADQL. Stars without proper motion are in the answer, with empty cells.
pub fn query(service: Service, cone: &Cone, band: Option<Band>) -> anyhow::Result<String> {
    let Cone { ra_deg, dec_deg, radius_deg, faintest_mag } = *cone;
    ensure!((0.0..=360.0).contains(&ra_deg), "--gaia-tap: right ascension is {ra_deg}, expected 0 to 360 degrees");
    ensure!((-90.0..=90.0).contains(&dec_deg), "--gaia-tap: declination is {dec_deg}, expected -90 to 90 degrees");
    ensure!(
        radius_deg > 0.0 && radius_deg <= 30.0,
        "--gaia-tap: radius is {radius_deg}, expected up to 30 degrees; take a Gaia-2MASS file for more of the sky"
    );
    ensure!(faintest_mag.is_finite(), "--faintest is {faintest_mag}, expected a magnitude");
    let (ra, dec, motion, [g, bp, rp], table) = match service {
        Service::Esa => (
            "ra",
            "dec",
            "pmra, pmdec, ref_epoch",
            ["phot_g_mean_mag", "phot_bp_mean_mag", "phot_rp_mean_mag"],
            "gaiadr3.gaia_source",
        ),
        Service::Vizier => ("RA_ICRS", "DE_ICRS", "pmRA, pmDE", ["Gmag", "BPmag", "RPmag"], "\"I/355/gaiadr3\""),
    };
    let also = match band {
        None | Some(Band::G) => String::new(),
        Some(Band::Bp) => format!(", {bp}"),
        Some(Band::Rp) => format!(", {rp}"),
        Some(Band::J | Band::H | Band::Ks) => {
            bail!("Gaia has no magnitude J, H or Ks: take G, BP or RP with --gaia-tap, or a Gaia-2MASS file")
        }
    };
    Ok(format!(
        "SELECT {ra}, {dec}, {motion}, {g}{also} FROM {table} WHERE 1 = CONTAINS(POINT('ICRS', {ra}, {dec}), \
         CIRCLE('ICRS', {ra_deg}, {dec_deg}, {radius_deg})) AND {g} <= {faintest_mag}"
    ))
}

/// The folder of answers.
pub fn cache(asked: Option<&Path>) -> anyhow::Result<PathBuf> {
    if let Some(folder) = asked {
        return Ok(folder.to_owned());
    }
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let caches = set("XDG_CACHE_HOME").or_else(|| Some(set("HOME")?.join(".cache")));
    Ok(caches.context("neither XDG_CACHE_HOME nor HOME is set: give --cache")?.join("starmesh/gaia"))
}

/// The file with the answer; from the folder when it is there, else from the service.
pub async fn ask(url: &str, query: &str, cone: &Cone, folder: &Path, timeout: Duration) -> anyhow::Result<PathBuf> {
    let sum: String = Sha256::digest(format!("{url}\n{query}")).iter().take(8).map(|b| format!("{b:02x}")).collect();
    let file = folder.join(format!("gaia_{}_{}_{}_{sum}.csv", cone.ra_deg, cone.dec_deg, cone.radius_deg));
    if file.exists() {
        return Ok(file);
    }
    std::fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    let part = file.with_extension(format!("{}.part", std::process::id()));
    let form = [
        ("REQUEST", "doQuery"),
        ("LANG", "ADQL"),
        ("FORMAT", "csv"),
        ("MAXREC", &(MOST_STARS + 1).to_string()),
        ("QUERY", query),
    ];
    let fetched = async {
        http::post(url, &form, &part, timeout).await?;
        check(&part)
    };
    let renamed = match fetched.await {
        Ok(()) => std::fs::rename(&part, &file).with_context(|| format!("{} cannot be written", file.display())),
        Err(error) => Err(error.context(format!("Gaia's stars could not be fetched from {url}"))),
    };
    if renamed.is_err() {
        let _ = std::fs::remove_file(&part); // It may never have been there.
    }
    renamed.map(|()| file)
}

/// Whether an answer is a table, and whole. TAP reports its errors as VOTable, with any HTTP status.
fn check(file: &Path) -> anyhow::Result<()> {
    use std::io::{BufRead as _, BufReader};
    let mut lines = BufReader::new(std::fs::File::open(file)?).lines();
    let head = lines.next().transpose()?.unwrap_or_default();
    if head.trim_start().starts_with('<') {
        let text: String = lines.map_while(Result::ok).take(200).collect::<Vec<_>>().join(" ");
        bail!("the service answers: {}", http::plain(&format!("{head} {text}")));
    }
    let names = head.to_ascii_lowercase();
    ensure!(names.contains("ra") && names.contains(','), "the service answers no table, but {:?}", http::short(&head));
    let stars = lines.try_fold(0_u64, |count, line| line.map(|_| count + 1))?;
    ensure!(
        stars <= MOST_STARS,
        "more than {MOST_STARS} stars: the answer is cut off there; take a smaller radius or a brighter --faintest"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_question_names_circle_columns_and_limit_in_the_words_of_each_service() {
        let cone = Cone { ra_deg: 269.45, dec_deg: -4.7, radius_deg: 0.5, faintest_mag: 16.5 };
        let esa = query(Service::Esa, &cone, Some(Band::Rp)).unwrap();
        assert!(
            esa.starts_with("SELECT ra, dec, pmra, pmdec, ref_epoch, phot_g_mean_mag, phot_rp_mean_mag FROM gaiadr3")
        );
        assert!(esa.contains("CIRCLE('ICRS', 269.45, -4.7, 0.5)) AND phot_g_mean_mag <= 16.5"), "{esa}");
        let vizier = query(Service::Vizier, &cone, None).unwrap();
        assert!(vizier.contains("FROM \"I/355/gaiadr3\"") && vizier.contains("POINT('ICRS', RA_ICRS, DE_ICRS)"));
        assert!(query(Service::Esa, &cone, Some(Band::J)).unwrap_err().to_string().contains("Gaia-2MASS"));
        for bad in [
            Cone { ra_deg: -1.0, ..cone },
            Cone { dec_deg: 91.0, ..cone },
            Cone { radius_deg: 0.0, ..cone },
            Cone { radius_deg: f64::NAN, ..cone },
        ] {
            assert!(query(Service::Esa, &bad, None).unwrap_err().to_string().contains("expected"));
        }
    }
}
