//! Whole golden files, where `$STARMESH_GOLDEN` names a folder that has them (it is not in the repository): pieces of
//! some are in `tests/golden`.
//! What the predecessor's libraries found is the least that must be found here; where both differ, the truth decides.

use std::path::{Path, PathBuf};

use imaging::focus::{Image, Operator};
use imaging::shift::from_stars;
use imaging::{Camera, Frame, Measured, StarSearch, measure};
use serde_json::Value;

use crate::fits;

fn folder(part: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("STARMESH_GOLDEN").map(|folder| Path::new(&folder).join(part));
    if folder.is_none() {
        println!("golden {part}: not run, STARMESH_GOLDEN is not set");
    }
    folder
}

/// Names (without the ending) and contents of the JSON files with an ending, by name.
fn values_of(folder: &Path, ending: &str) -> Vec<(String, Value)> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
    names.retain(|name| name.ends_with(ending));
    names.sort();
    let read = |name: String| {
        let text = std::fs::read_to_string(folder.join(&name)).unwrap();
        (name.strip_suffix(ending).unwrap().to_owned(), serde_json::from_str(&text).unwrap())
    };
    names.into_iter().map(read).collect()
}

fn number(of: &Value) -> f64 {
    of.as_f64().unwrap_or_else(|| panic!("{of} is no number"))
}

fn measured(image: &fits::Image) -> Measured {
    let frame = Frame::new(image.width, image.height, image.pixels()).unwrap();
    measure(&frame, &Camera::default(), &StarSearch::default()).unwrap()
}

#[test]
fn whole_pairs_are_registered_at_least_as_well_as_before() {
    let Some(folder) = folder("donuts") else { return };
    let pairs = values_of(&folder, ".json");
    assert_eq!(pairs.len(), 8);
    for (name, pair) in pairs {
        let read = |part: &str| fits::read(&folder.join(format!("{name}_{part}.fits.gz"))).unwrap();
        let (reference, check) = (read("ref"), read("check"));
        let stars = [&reference, &check].map(|image| measured(image).stars);
        let shift = from_stars(&stars[0], &stars[1], reference.width, reference.height).unwrap();
        let truth = ["x", "y"].map(|axis| number(&pair["true_shift_check_minus_ref_px"][axis]));
        let off = (shift.dx_px - truth[0]).hypot(shift.dy_px - truth[1]);
        // its sign is the opposite
        let old = ["x", "y"].map(|axis| -number(&pair["answers"]["astra_guider"][axis]));
        let old_off = (old[0] - truth[0]).hypot(old[1] - truth[1]);
        let error = shift.error_px().0.hypot(shift.error_px().1);
        println!("{name}: off by {off:.4} +- {error:.4} px with {} stars; before {old_off:.4} px", shift.stars);
        assert!(off < 3.5 * error && off < old_off.max(0.02), "{name}: {shift:?}, truth {truth:?}");
    }
}

#[test]
fn whole_frames_show_every_true_star_that_was_found_before_and_the_same_sky() {
    let Some(folder) = folder("frames") else { return };
    let frames = values_of(&folder, ".astra.json");
    assert_eq!(frames.len(), 12);
    for (name, before) in frames {
        let truth = std::fs::read_to_string(folder.join(format!("{name}.truth.json"))).unwrap();
        let truth: Value = serde_json::from_str(&truth).unwrap();
        let measured = measured(&fits::read(&folder.join(format!("{name}.fits.gz"))).unwrap());
        let place = |star: &Value| (number(&star["x"]), number(&star["y"]));
        let places: Vec<(f64, f64)> = truth["stars"].as_array().unwrap().iter().map(place).collect();
        // places of a trailed frame are those of the shutter's opening
        let trail = truth["trail_px_start_to_end"]
            .as_array()
            .map_or((0.0, 0.0), |trail| (0.5 * number(&trail[0]), 0.5 * number(&trail[1])));
        let is_near = |(x, y): (f64, f64), (sx, sy): (f64, f64)| (x - sx).hypot(y - sy) < 3.0;
        let is_true = |at: (f64, f64)| places.iter().any(|(x, y)| is_near((x + trail.0, y + trail.1), at));
        let listed = before["astra_find_stars_xy"].as_array().unwrap().iter();
        let known: Vec<(f64, f64)> =
            listed.map(|at| (number(&at[0]), number(&at[1]))).filter(|at| is_true(*at)).collect();
        let is_found = |at: &&(f64, f64)| measured.stars.iter().any(|star| is_near(**at, (star.x_px, star.y_px)));
        let missed: Vec<_> = known.iter().filter(|at| !is_found(at)).collect();
        let quality = &measured.quality;
        println!("{name}: {} stars; of {} found before, {} are missed", quality.stars, known.len(), missed.len());
        assert!(missed.is_empty(), "{name}: {missed:?}");
        let of_sky = |key: &str| number(&before["background2d"][key]);
        let (sky, rms) = (of_sky("background_median"), of_sky("background_rms_median"));
        // the camera of f04 cut off the lower half of its noise: of such a sky mean and median differ by its rms
        let most = if name == "f04_noisy" { rms } else { 0.15 * rms };
        let found = quality.background_adu;
        println!("{name}: {found:.2} ADU, before {sky:.2}, rms {rms:.2}");
        assert!((found - sky).abs() < most, "{name}: {found} ADU, before {sky}, rms {rms}");
    }
}

#[test]
fn all_operators_agree_on_the_whole_golden_sweeps() {
    let Some(folder) = folder("focus") else { return };
    let sweeps = values_of(&folder, ".json");
    assert_eq!(sweeps.len(), 3);
    let mut compared = 0;
    for (name, sweep) in sweeps {
        let mut files: Vec<PathBuf> =
            std::fs::read_dir(folder.join(&name)).unwrap().map(|file| file.unwrap().path()).collect();
        files.sort();
        assert_eq!(files.len(), 15, "{name}");
        for (n, file) in files.iter().enumerate() {
            let image = fits::read(file).unwrap();
            let image = Image::raw(&Frame::new(image.width, image.height, image.pixels()).unwrap()).unwrap();
            for (operator, values) in sweep["measures"].as_object().unwrap() {
                // sizes of stars need the places they were measured at (focus_golden)
                if matches!(operator.as_str(), "hfr" | "gauss") {
                    continue;
                }
                let found = Operator::named(operator).unwrap().measure(&image, &[]).unwrap();
                let expected = number(&values["float64"][n]);
                assert!((found / expected - 1.0).abs() < 1e-9, "{name} {n} {operator}: {found}, golden {expected}");
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 3 * 15 * 11);
}
