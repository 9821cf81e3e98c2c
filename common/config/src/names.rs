//! `[names]`: where names of targets are looked up.

use serde::Deserialize;

/// The services that know names; rows with coordinates, elements or names of planets need none.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Names {
    /// Ask them at all.
    pub online: bool,
    /// Sesame of the CDS: stars and deep-sky objects.
    pub sesame_url: String,
    /// Horizons of JPL: asteroids and comets.
    pub horizons_url: String,
}

impl Default for Names {
    fn default() -> Self {
        Self {
            online: true,
            sesame_url: "https://cds.unistra.fr/cgi-bin/nph-sesame".to_owned(),
            horizons_url: "https://ssd.jpl.nasa.gov/api/horizons.api".to_owned(),
        }
    }
}

impl Names {
    /// What does not hold, in words.
    pub(crate) fn faults(&self) -> Vec<String> {
        let urls = [("sesame_url", &self.sesame_url), ("horizons_url", &self.horizons_url)];
        let is_web = |url: &str| {
            (url.starts_with("https://") || url.starts_with("http://")) && !url.contains(char::is_whitespace)
        };
        let wrong = urls.into_iter().filter(|(_, url)| !is_web(url));
        wrong.map(|(key, url)| format!("names.{key} = {url:?}: expected https://...")).collect()
    }
}
