//! The deliberate differences from a night of the predecessor that apply to this site, each with the key that restores
//! the old behaviour.

use contract::Kind;
use serde_json::Value;

use super::schedule::Piece;
use super::telescopes::File;

/// Dwells from here on are listed: they keep the dome closed for a part of the first night.
const LONG_MIN: f64 = 60.0;

/// The sentences that apply.
pub fn of(files: &[File], pieces: &[Piece]) -> Vec<String> {
    let values: Vec<Value> = pieces.iter().filter_map(Piece::value).collect();
    let rows = |action: &str| values.iter().filter(|value| value["action_type"] == action).count();
    let asks = |key: &str| values.iter().filter(|value| value["action_value"][key] == true).count();
    let mut lines = Vec::new();
    let (pointing, models, guiding) = (asks("pointing"), rows("pointing_model"), asks("guiding"));
    if pointing > 0 {
        lines.push(format!(
            "{pointing} rows with \"pointing\": a frame counts only once a solved frame has shown where the telescope looks; one \
             that is off by more than pointing.tolerance_arcmin does not count. Astra observes all the same: \
             on_failure = \"observe\" and tolerance_arcmin = 600 under [pointing]"
        ));
    }
    if models > 0 {
        lines.push(format!(
            "{models} rows pointing_model: what is learned stays with Starmesh, which corrects each slew, and the mount is not synchronised. \
             Astra synchronises the mount: \"sync\": true in the row"
        ));
    }
    if guiding > 0 {
        lines.push(format!(
            "{guiding} rows with \"guiding\": drift and worm are predicted. Astra's controller with your PID_COEFFS: \
             control_ra = \"pid\" and control_dec = \"pid\" under [guiding]"
        ));
    }
    if rows("flats") > 0 {
        lines.push(
            "flats: the telescope is shifted between frames, and a frame off the level does not count. Without the shift: \
             flats.dither_arcsec = 0 of the camera"
                .to_owned(),
        );
    }
    for file in files {
        let limits =
            file.blocks.iter().flat_map(|block| block.limits.iter().map(|(_, limit)| limit)).chain(&file.limits);
        let longest = limits.filter_map(|limit| Some((dwell_min(limit)?, limit))).max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((dwell_min, limit)) = longest.filter(|(dwell_min, _)| *dwell_min >= LONG_MIN) {
            lines.push(format!(
                "{}: a dwell must have been seen before the dome opens for the first time: {dwell_min} min for {limit}. Astra opens at the \
                 first good sample after a start. Start the device nodes so long before the night (they remember what they saw when \
                 only the observatory node starts again), or give the limit a shorter dwell_min",
                file.telescope
            ));
        }
    }
    if files.iter().flat_map(|file| &file.blocks).any(|block| block.kind == Kind::Dome) {
        lines.push(
            "the dome is closed while the Sun is up, whatever the schedule says. As Astra, which has no such rule: \
             sun_altitude_max_deg = 90 under [safety]"
                .to_owned(),
        );
    }
    lines
}

/// The dwell of a limit, as [`super::devices`] has written it.
pub fn dwell_min(limit: &str) -> Option<f64> {
    let (_, rest) = limit.split_once("dwell_min = ")?;
    rest.split([',', ' ', '}']).next()?.parse().ok()
}
