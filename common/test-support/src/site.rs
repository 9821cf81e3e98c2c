//! Parts of `observatory.toml`.

use std::fmt::Display;

use contract::Address;

/// The section `[observatory]` of the telescope `paranal/callisto`.
pub const PARANAL: &str = "[observatory]\nsite = \"paranal\"\ntelescope = \"callisto\"\nlatitude_deg = -24.6\n\
                           longitude_deg = -70.4\nelevation_m = 2500.0\n";
/// The section of the telescope `site/alpha`, on the equator.
pub const ALPHA: &str = "[observatory]\nsite = \"site\"\ntelescope = \"alpha\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\n\
                         elevation_m = 0.0\n";

/// The section `[observatory]` of a telescope at the place of a simulated observatory.
pub fn section(address: &Address, options: &simulator::Options) -> String {
    let (latitude, longitude) = (options.latitude.degrees(), options.longitude.degrees());
    format!(
        "[observatory]\nsite = \"{}\"\ntelescope = \"{}\"\nlatitude_deg = {latitude}\nlongitude_deg = {longitude}\n\
         elevation_m = {}\n",
        address.site, address.telescope, options.elevation_m
    )
}

/// The block of a device with more lines of it.
pub fn block(kind: &str, name: &str, server: impl Display, more: &str) -> String {
    format!("[[{kind}]]\nname = \"{name}\"\nserver = \"{server}\"\n{more}\n")
}
