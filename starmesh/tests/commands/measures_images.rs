//! `starmesh measure` and `starmesh shift` on the golden frames of `common/imaging/tests/golden`, against the truth
//! they were drawn from.

use std::path::{Path, PathBuf};

use fitsio::FitsFile;
use fitsio::images::{ImageDescription, ImageType};
use serde_json::Value;

use crate::command::{fields, number, starmesh};

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/imaging/tests/golden").join(name)
}

/// A folder of this test run, below cargo's own.
fn empty_folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn places(answer: &Value) -> Vec<(f64, f64, f64)> {
    let stars = answer["stars"].as_array().unwrap().iter();
    stars.map(|star| (number(star, "x_px"), number(star, "y_px"), number(star, "flux_adu"))).collect()
}

#[test]
fn a_frame_is_measured_in_the_fields_that_were_promised() {
    let output = starmesh(["measure", "--json", golden("f01_nominal.fits.gz").to_str().unwrap()]);
    assert!(output.success, "{}", output.err);
    let [answer] = &output.json()[..] else { panic!("{}", output.out) };
    assert_eq!(fields(answer), ["file", "background_adu", "noise_adu", "fwhm_px", "ellipticity", "stars"]);
    assert!(answer["file"].as_str().unwrap().ends_with("f01_nominal.fits.gz"));
    assert_eq!(fields(&answer["stars"][0]), ["x_px", "y_px", "flux_adu", "fwhm_px", "snr", "flags"]);
    assert!(answer["stars"][0]["flags"].is_array());
    assert!((300.0..400.0).contains(&number(answer, "background_adu")), "bias 300 ADU and some sky");
    assert!((1.0..30.0).contains(&number(answer, "noise_adu")));
    assert!(number(answer, "ellipticity") < 0.1, "round stars");
    let table = std::fs::read_to_string(golden("f01_nominal.csv")).unwrap();
    let drawn: f64 = table.split_once("fwhm_px=").unwrap().1.split_once(',').unwrap().0.parse().unwrap();
    assert!((number(answer, "fwhm_px") / drawn - 1.0).abs() < 0.05, "{} px, drawn {drawn}", answer["fwhm_px"]);
    // Each star that was drawn bright enough is found, in its place and brightness.
    let found = places(answer);
    let mut judged = 0;
    for line in table.lines().skip(1) {
        let truth: Vec<f64> = line.split(',').map(|n| n.parse().unwrap()).collect();
        if truth[2] > 5000.0 {
            judged += 1;
            let near = found.iter().find(|(x, y, _)| (x - truth[0]).hypot(y - truth[1]) < 0.3);
            let (_, _, flux) = near.unwrap_or_else(|| panic!("missed {line}"));
            assert!((flux / truth[2] - 1.0).abs() < 0.15, "{flux} ADU, drawn {line}");
        }
    }
    assert!(judged >= 4, "only {judged} bright stars");
}

/// Unpacks a golden frame and writes it once more with cfitsio, whose way to name a packing is `name`.
fn written_again(folder: &Path, name: &str) -> PathBuf {
    let image = fits::read(&golden("f02_wide_undersampled.fits.gz")).unwrap();
    let fits::Pixels::U16(counts) = &image.pixels else { panic!("no counts") };
    let dimensions = [image.height_px, image.width_px];
    let description = ImageDescription { data_type: ImageType::UnsignedShort, dimensions: &dimensions };
    let path = folder.join(name);
    let mut file = FitsFile::create(&path).with_custom_primary(&description).open().unwrap();
    let hdu = if name.contains('[') { file.hdu(1).unwrap() } else { file.primary_hdu().unwrap() };
    hdu.write_image(&mut file, counts).unwrap();
    drop(file);
    folder.join(name.split('[').next().unwrap())
}

#[test]
fn the_packing_of_a_file_changes_nothing() {
    let folder = empty_folder("packings");
    let mut files = vec![golden("f02_wide_undersampled.fits.gz")];
    files.extend(["a.fits", "b.fits.gz", "c.fits.fz[compress R]"].map(|name| written_again(&folder, name)));
    let mut arguments = vec![PathBuf::from("measure"), "--json".into()];
    arguments.extend(files);
    let output = starmesh(arguments);
    assert!(output.success, "{}", output.err);
    let mut answers = output.json();
    assert_eq!(answers.len(), 4);
    answers.iter_mut().for_each(|answer| answer["file"] = Value::Null);
    assert!(places(&answers[0]).len() > 20, "{}", answers[0]);
    assert!(answers.iter().all(|answer| *answer == answers[0]), "{}", output.out);
}

#[test]
fn shifts_of_the_golden_pairs_are_the_true_ones() {
    for (name, dx, dy) in
        [("p05_vlarge", 17.8, -9.15), ("p07_faint", -2.15, 0.85), ("p08_hot", 1.6, -1.1), ("p12_seeing_chg", 0.9, -0.4)]
    {
        let [reference, check] = ["ref", "check"].map(|part| golden(&format!("{name}_{part}.fits.gz")));
        let output = starmesh(["shift".into(), reference, check, "--json".into()]);
        assert!(output.success, "{name}: {}", output.err);
        let [answer] = &output.json()[..] else { panic!("{}", output.out) };
        assert_eq!(fields(answer), ["dx_px", "dy_px", "sigma_px", "rotation_deg", "stars", "method"]);
        let sigma = number(answer, "sigma_px");
        assert!(sigma < 0.05, "{name}: {answer}");
        let (off_x, off_y) = (number(answer, "dx_px") - dx, number(answer, "dy_px") - dy);
        assert!(off_x.abs() < 3.5 * sigma && off_y.abs() < 3.5 * sigma, "{name}: {answer}");
        assert!(number(answer, "rotation_deg").abs() < 0.1, "{name}: {answer}");
        assert_eq!(answer["method"], "stars");
        assert!(number(answer, "stars") >= 2.0);
    }
}

#[test]
fn a_bad_file_is_named_and_the_next_one_is_measured() {
    let folder = empty_folder("bad-files");
    let bad = |name: &str, bytes: &[u8]| {
        let file = folder.join(name);
        std::fs::write(&file, bytes).unwrap();
        file
    };
    let whole = std::fs::read(golden("f01_nominal.fits.gz")).unwrap();
    let mut arguments: Vec<PathBuf> = vec!["measure".into(), "--json".into()];
    arguments.push(bad("cut.fits.gz", &whole[..whole.len() / 2]));
    arguments.push(bad("page.fits", b"<html>not found</html>"));
    arguments.push(bad("empty.fits", b""));
    arguments.push(folder.join("none.fits"));
    arguments.push(golden("f01_nominal.fits.gz"));
    let output = starmesh(&arguments);
    assert!(!output.success);
    assert_eq!(output.json().len(), 1, "the good one: {}", output.out);
    for words in [
        "cut.fits.gz is damaged or cut short",
        "page.fits is not FITS: it is a web page",
        "empty.fits is empty (0 bytes)",
        "none.fits cannot be read",
        "4 of 5 files could not be used",
    ] {
        assert!(output.err.contains(words), "{words:?} in {}", output.err);
    }
}

#[test]
fn frames_that_do_not_belong_together_have_no_shift() {
    let output = starmesh(["shift".into(), golden("p07_faint_ref.fits.gz"), golden("f15_rect_bin2.fits.gz")]);
    assert!(!output.success && output.out.is_empty());
    assert!(output.err.contains("give two frames of one camera and binning"), "{}", output.err);
    let output = starmesh(["shift".into(), golden("p05_vlarge_ref.fits.gz"), golden("p07_faint_check.fits.gz")]);
    assert!(!output.success && output.out.is_empty(), "{}", output.out);
    assert!(output.err.contains("no shift from"), "{}", output.err);
}

#[test]
fn people_get_text() {
    let output = starmesh(["measure".into(), golden("f02_wide_undersampled.fits.gz")]);
    assert!(output.success, "{}", output.err);
    assert!(output.out.contains("background") && output.out.contains("FWHM px") && output.out.contains("fainter ones"));
    let pair = ["p05_vlarge_ref.fits.gz", "p05_vlarge_check.fits.gz"].map(golden);
    let output = starmesh([PathBuf::from("shift")].iter().chain(&pair));
    assert!(output.success, "{}", output.err);
    assert!(output.out.starts_with("the stars moved by +17.") && output.out.contains("stars"), "{}", output.out);
}
