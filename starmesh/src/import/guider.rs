//! The predecessor's `guider` block: gains, interval, and the effect of its pulses on the stars.

use super::block::{Block, GuideStart};
use super::entry::{Entry, Notes};

/// Seconds between corrections where the block has no value.
const INTERVAL_S: f64 = 60.0;
/// Four lengths that agree to this share were never measured: the block is still that of the template.
const UNTOUCHED: f64 = 1e-3;
/// Axes and signs of the detector, as the predecessor writes them, with the way (x, y) that a star goes.
const WAYS: [(&str, [f64; 2]); 4] = [("+x", [1.0, 0.0]), ("-x", [-1.0, 0.0]), ("+y", [0.0, 1.0]), ("-y", [0.0, -1.0])];

/// Reads the block; its gains hold once somebody chooses `pid`.
pub fn guider(block: &mut Block, guider: &mut Entry<'_>, notes: &mut Notes) {
    let lines = block.tables.entry("guiding").or_default();
    let interval_s = guider.number("MIN_GUIDE_INTERVAL", notes).unwrap_or(INTERVAL_S);
    lines.of(guider.last).key(
        "interval_min_s",
        interval_s,
        "between the frames that are guided on; 0: on every one, the default here",
    );
    let ra_axis = guider.text("RA_AXIS", notes).unwrap_or_else(|| "x".to_owned());
    if let Some(mut gains) = guider.entry("PID_COEFFS", notes) {
        for axis in ["x", "y"] {
            let Some(mut of_axis) = gains.entry(axis, notes) else { continue };
            let gain = ["p", "i", "d"].map(|key| of_axis.number(key, notes).unwrap_or(0.0));
            let key = if axis == ra_axis { "pid_ra" } else { "pid_dec" };
            let value = format!("{{ p = {}, i = {}, d = {} }}", gain[0], gain[1], gain[2]);
            lines.of(of_axis.line).key(
                key,
                value,
                "for control_ra, control_dec = \"pid\"; by default drift and worm are foreseen",
            );
        }
        let [x, y] = ["set_x", "set_y"].map(|set| gains.number(set, notes).unwrap_or(0.0));
        if [x, y] != [0.0, 0.0] {
            // There a shift is how far the stars must go, here how far they went.
            let what = format!("set_x = {x}, set_y = {y}: from where the field was found to where it is held");
            lines.of(gains.last).key("hold_offset_px", format!("[{:?}, {:?}]", 0.0 - x, 0.0 - y), &what);
        }
    }
    let anew = "it is learned from the first solved frame, or by calibrate_guiding";
    let (mut lengths, mut directions) = match (guider.entry("PIX2TIME", notes), guider.entry("DIRECTIONS", notes)) {
        (Some(lengths), Some(directions)) => (lengths, directions),
        (None, None) => return,
        _ => {
            let what = "only one of PIX2TIME and DIRECTIONS is given, which does not describe pulses";
            return notes.add(guider.line, format!("{}: {what}; {anew}", guider.place));
        }
    };
    let line = lengths.line;
    match calibration(&mut lengths, &mut directions, notes) {
        Ok(text) => {
            let lines = block.tables.entry("guiding").or_default().of(line);
            let why = "Astra turned East and West round beyond the pier, and never North and South";
            lines.key("dec_reversed_after_flip", true, why);
            block.guide_start = Some(GuideStart { line, text });
        }
        Err(why) => notes.add(line, format!("{}: {why}; {anew}", lengths.place)),
    }
}

/// `guide_calibration` of a camera. The predecessor measured at declination 0 an hour west of the meridian: a German
/// mount is east of its pier then, and looks west.
fn calibration(lengths: &mut Entry<'_>, directions: &mut Entry<'_>, notes: &mut Notes) -> Result<String, String> {
    let mut moves: Vec<(String, [f64; 2])> = Vec::new();
    let mut all_ms = Vec::new();
    for (way, [x, y]) in WAYS {
        let (ms_per_px, word) = (lengths.number(way, notes), directions.text(way, notes));
        let (Some(ms_per_px), Some(word)) = (ms_per_px, word) else {
            return Err(format!("PIX2TIME and DIRECTIONS do not both contain {way}"));
        };
        if !(0.01..=1e6).contains(&ms_per_px) {
            return Err(format!("PIX2TIME {way} = {ms_per_px}: no length of a pulse for a pixel"));
        }
        let px_per_s = 1000.0 / ms_per_px;
        moves.push((word.to_ascii_lowercase(), [x * px_per_s, y * px_per_s]));
        all_ms.push(ms_per_px);
    }
    let least = all_ms.iter().copied().fold(f64::INFINITY, f64::min);
    let most = all_ms.iter().copied().fold(0.0, f64::max);
    if most - least < UNTOUCHED * least {
        return Err("four like values, as in Astra's template, were never measured".to_owned());
    }
    let along = |word: &str| moves.iter().find(|(known, _)| known == word).map(|(_, way)| *way);
    // There and back again: half of the difference, as play of the gear hides in either.
    let mean = |there: &str, back: &str| {
        let (there, back) = along(there).zip(along(back))?;
        let mean = [0, 1].map(|n| 0.5 * (there[n] - back[n]));
        // On one axis and opposite, or they cancel.
        (there[0] * back[0] + there[1] * back[1] < 0.0).then_some(mean)
    };
    let [east, north] = [mean("east", "west"), mean("north", "south")];
    let (Some([east_x, east_y]), Some([north_x, north_y])) = (east, north) else {
        return Err("DIRECTIONS do not separate East from West and North from South".to_owned());
    };
    let text = |[x, y]: [f64; 2]| format!("[{:.4}, {:.4}]", x + 0.0, y + 0.0);
    Ok(format!(
        "{{ east_px_per_s = {}, north_px_per_s = {}, pier_side = \"east\" }}",
        text([east_x, east_y]),
        text([north_x, north_y])
    ))
}

#[cfg(test)]
mod tests {
    use super::super::yaml;
    use super::*;

    fn made(yaml: &str) -> (Result<String, String>, Notes) {
        let node = yaml::read(yaml).unwrap();
        let mut notes = Notes::default();
        let mut top = Entry::of("guider", &node, &mut notes).unwrap();
        let (mut lengths, mut directions) =
            (top.entry("PIX2TIME", &mut notes).unwrap(), top.entry("DIRECTIONS", &mut notes).unwrap());
        (calibration(&mut lengths, &mut directions, &mut notes), notes)
    }

    const PLAIN: &str = "DIRECTIONS: {+x: East, -x: West, +y: North, -y: South}";

    #[test]
    fn a_pulse_moves_the_stars_along_the_axis_that_names_it() {
        // The camera stands on its side: East moves stars to smaller y, North to smaller x; play makes South slower.
        let turned =
            "PIX2TIME: {+x: 90, -x: 80, +y: 62.5, -y: 62.5}\nDIRECTIONS: {+x: South, -x: North, +y: West, -y: East}";
        let (text, notes) = made(turned);
        let text = text.unwrap();
        assert_eq!(
            text,
            "{ east_px_per_s = [0.0000, -16.0000], north_px_per_s = [-11.8056, 0.0000], pier_side = \"east\" }"
        );
        assert!(notes.lines.is_empty());
        let toml = format!(
            "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\nelevation_m = 0\n\
             [[camera]]\nname = \"c\"\nserver = \"a:1\"\nguide_calibration = {text}\n"
        );
        let config = config::parse(&toml, std::path::Path::new("/x")).unwrap();
        assert_eq!(config.camera[0].guide_calibration.unwrap().east_px_per_s, [0.0, -16.0]);
    }

    #[test]
    fn what_was_never_measured_or_makes_no_sense_is_reported_and_not_carried_over() {
        for (yaml, words) in [
            (format!("PIX2TIME: {{+x: 71.629, -x: 71.629, +y: 71.628, -y: 71.628}}\n{PLAIN}"), "never measured"),
            (format!("PIX2TIME: {{+x: 80, -x: 81, +y: 0, -y: 82}}\n{PLAIN}"), "PIX2TIME +y = 0"),
            (format!("PIX2TIME: {{+x: 80, -x: 81, +y: 82}}\n{PLAIN}"), "do not both contain -y"),
            (
                "PIX2TIME: {+x: 80, -x: 81, +y: 82, -y: 83}\nDIRECTIONS: {+x: East, -x: North, +y: West, -y: South}"
                    .to_owned(),
                "do not separate East from West",
            ),
            (
                "PIX2TIME: {+x: 80, -x: 81, +y: 82, -y: 83}\nDIRECTIONS: {+x: East, -x: West, +y: Up, -y: South}"
                    .to_owned(),
                "North from South",
            ),
        ] {
            let why = made(&yaml).0.unwrap_err();
            assert!(why.contains(words), "{yaml}: {why}");
        }
    }
}
