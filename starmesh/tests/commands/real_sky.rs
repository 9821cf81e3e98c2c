//! `starmesh measure` and `starmesh shift` on frames of the real sky, which stay where `STARMESH_REAL_SKY` points to:
//! other people's data are not copied into the project. Where it is not set, nothing is run, and the test prints that.

use std::io::Write as _;
use std::path::PathBuf;

use serde_json::Value;

use crate::command::{number, starmesh};

/// The frames, and the least and the most stars in them.
const FRAMES: [(&str, usize, usize); 5] = [
    ("panoptes/unsolved.fits", 60, 2000),
    ("panoptes/solved.fits.fz", 60, 2000),
    ("2mass/gc_2mass_j.fits", 500, 50_000),
    ("2mass/gc_2mass_h.fits", 500, 50_000),
    ("sdss/reprojected_sdss_g.fits.bz2", 30, 5000),
];

/// Prints how many were run, past the test's own capture of output.
fn print(run: usize) {
    let _ = writeln!(std::io::stderr(), "real sky: {run} of {} run", FRAMES.len() + 1);
}

#[test]
fn real_frames_are_measured_and_the_real_pair_is_registered() {
    let Some(folder) = std::env::var_os("STARMESH_REAL_SKY").map(PathBuf::from) else { return print(0) };
    let file = |name: &str| folder.join(name).into_os_string();
    let mut arguments = vec!["measure".into(), "--json".into()];
    arguments.extend(FRAMES.map(|(name, ..)| file(name)));
    let output = starmesh(arguments);
    assert!(output.success, "{}", output.err);
    let answers = output.json();
    for ((name, least, most), answer) in FRAMES.iter().zip(&answers) {
        let count = answer["stars"].as_array().unwrap().len();
        println!("{name}: {count} stars, FWHM {} px, noise {} ADU", answer["fwhm_px"], answer["noise_adu"]);
        assert!((*least..*most).contains(&count), "{name}: {count} stars");
        assert!(number(answer, "noise_adu") > 0.0 && (1.0..8.0).contains(&number(answer, "fwhm_px")), "{name}");
    }
    // Truth: two solutions by astrometry.net, solved.fits.fz against unsolved.fits at the centre.
    let output = starmesh(["shift".into(), file(FRAMES[0].0), file(FRAMES[1].0), "--json".into()]);
    assert!(output.success, "{}", output.err);
    let shift = &output.json()[0];
    println!("panoptes: {shift}");
    let (dx, dy) = (number(shift, "dx_px"), number(shift, "dy_px"));
    assert!((dx - 0.52).abs() < 0.3 && (dy - 1.53).abs() < 0.3, "{shift}");
    assert!(number(shift, "sigma_px") < 0.15 && number(shift, "stars") >= 20.0, "{shift}");
    // Stars that are well visible in one frame of the mosaic are in the other one too: they are sky, not pattern.
    let share = common(&answers[0], &answers[1], (dx, dy));
    println!("panoptes: {:.0} % of the stars of S/N 15 are in both frames", 100.0 * share);
    assert!(share > 0.9, "{share}");
    print(FRAMES.len() + 1);
}

/// Share of the stars of S/N 15 and more, 20 px from the edge, that the other frame has within 2.5 px.
fn common(from: &Value, to: &Value, (dx, dy): (f64, f64)) -> f64 {
    let place = |star: &Value| (number(star, "x_px"), number(star, "y_px"));
    let inside = |at: f64| (20.0..680.0).contains(&at);
    let stars = |answer: &Value| answer["stars"].as_array().unwrap().clone();
    let there: Vec<(f64, f64)> = stars(to).iter().map(place).collect();
    let bright: Vec<(f64, f64)> = stars(from)
        .iter()
        .filter(|star| number(star, "snr") >= 15.0 && !star["flags"].as_array().unwrap().contains(&"cosmic".into()))
        .map(place)
        .filter(|(x, y)| inside(*x) && inside(*y))
        .collect();
    let both = bright.iter().filter(|(x, y)| there.iter().any(|(u, v)| (u - x - dx).hypot(v - y - dy) < 2.5));
    both.count() as f64 / bright.len().max(1) as f64
}
