//! `starmesh solve` and `starmesh focus` on the golden frames, against the truth they were drawn from.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use rusqlite::{Connection, params};
use tempfile::TempDir;

use crate::command::{fields, number, starmesh};

fn frame(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/imaging/tests/golden").join(name)
}

fn stars() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/stars.csv.gz")
}

/// A piece of a frame whose place is known.
struct Golden {
    name: String,
    /// Geometric centre, deg.
    centre_deg: (f64, f64),
    scale_arcsec_px: f64,
    /// RA and DEC (deg), FOCALLEN (m) and XPIXSZ (um) of the whole frame's header.
    stated: [f64; 4],
}

fn golden() -> Vec<Golden> {
    let table = std::fs::read_to_string(stars().with_file_name("centres.csv")).unwrap();
    let row = |line: &str| {
        let (name, numbers) = line.split_once(',').unwrap();
        let n: Vec<f64> = numbers.split(',').map(|n| n.parse().unwrap()).collect();
        let stated = [n[3], n[4], n[5], n[6]];
        Golden { name: name.to_owned(), centre_deg: (n[0], n[1]), scale_arcsec_px: n[2], stated }
    };
    table.lines().skip(1).map(row).collect()
}

impl Golden {
    /// The piece with the whole frame's header, or with these cards alone.
    fn written(&self, folder: &Path, cards: Option<&[&str]>) -> PathBuf {
        let mut bytes = Vec::new();
        let packed = std::fs::File::open(frame(&format!("{}.fits.gz", self.name))).unwrap();
        flate2::read::GzDecoder::new(packed).read_to_end(&mut bytes).unwrap();
        let [ra, dec, focal_m, pixel_um] = self.stated;
        let own = [
            format!("RA      = {ra:20.6}"),
            format!("DEC     = {dec:20.6}"),
            format!("FOCALLEN= {focal_m:20.6} / [m] focal length of telescope"),
            format!("XPIXSZ  = {pixel_um:20.6}"),
            "DATE-OBS= '2026-11-21T03:00:00.000'".to_owned(),
        ];
        let cards: Vec<&str> = cards.map_or(own.iter().map(String::as_str).collect(), <[&str]>::to_vec);
        let end = bytes.chunks(80).position(|card| card.starts_with(b"END ")).unwrap();
        for (n, card) in cards.iter().chain([&"END"]).enumerate() {
            let at = 80 * (end + n);
            assert!(at < 2880, "room in the first block");
            bytes[at..at + 80].copy_from_slice(format!("{card:80}").as_bytes());
        }
        let path = folder.join(format!("{}.fits", self.name));
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

/// The same stars as sites have them: by degree of declination, an unknown motion as empty text.
fn sqlite(folder: &Path) -> PathBuf {
    let path = folder.join("gaia_tmass_16_jm_cut.db");
    let file = Connection::open(&path).unwrap();
    for d in -90..90 {
        let columns = "ra REAL, dec REAL, pmra REAL, pmdec REAL, phot_g_mean_mag REAL, j_m REAL";
        file.execute(&format!("CREATE TABLE `{d}_{}` ({columns})", d + 1), []).unwrap();
    }
    let mut table = String::new();
    flate2::read::GzDecoder::new(std::fs::File::open(stars()).unwrap()).read_to_string(&mut table).unwrap();
    for line in table.lines().skip(1) {
        let n: Vec<f64> = line.split(',').map(|n| n.parse().unwrap()).collect();
        let d = n[1].floor() as i32;
        let insert = format!("INSERT INTO `{d}_{}` VALUES (?,?,?,?,?,'')", d + 1);
        file.execute(&insert, params![n[0], n[1], n[2], n[3], n[4]]).unwrap();
    }
    path
}

/// Distance on the sky, arcsec; small ones.
fn apart_arcsec(a: (f64, f64), b: (f64, f64)) -> f64 {
    let east = ((a.0 - b.0 + 180.0).rem_euclid(360.0) - 180.0) * b.1.to_radians().cos();
    east.hypot(a.1 - b.1) * 3600.0
}

#[test]
fn golden_frames_are_solved_with_any_kind_of_catalogue() {
    let folder = TempDir::new().unwrap();
    let database = sqlite(folder.path());
    let built = folder.path().join("built.smcat");
    let output = starmesh(["catalogue".into(), "build".into(), "--out".into(), built.clone(), database.clone()]);
    assert!(output.success, "{}", output.err);
    assert!(output.out.contains(" stars, epoch 2016.0, HEALPix order "), "{}", output.out);
    let truths = golden();
    assert_eq!(truths.len(), 9);
    for catalogue in [stars(), database, built] {
        let mut arguments: Vec<PathBuf> = vec!["solve".into(), "--json".into(), "--catalogue".into(), catalogue];
        arguments.extend(truths.iter().map(|truth| truth.written(folder.path(), None)));
        let output = starmesh(arguments);
        assert!(
            !output.success && output.err.contains(" of 9 files are not solved"),
            "f11 shows two stars: {}",
            output.err
        );
        let answers = output.json();
        assert_eq!(answers.len(), truths.len());
        for (answer, Golden { name, centre_deg, scale_arcsec_px, .. }) in answers.iter().zip(&truths) {
            assert_eq!(fields(answer), PROMISED);
            if name == "f11_two_stars" {
                assert!(answer["solved"] == false && answer["ra_deg"].is_null(), "{answer}");
                assert!(answer["reason"].as_str().unwrap().starts_with("too few stars"), "{answer}");
                continue;
            }
            // The rest of the noisy frame shows four stars of the catalogue: the program may refuse it, but a wrong
            // answer fails.
            if name == "f04_noisy" && answer["solved"] == false {
                assert!(answer["reason"].is_string() && answer["ra_deg"].is_null(), "{answer}");
                continue;
            }
            assert!(answer["solved"] == true && answer["reason"].is_null(), "{name}: {answer}");
            let found = (number(answer, "ra_deg"), number(answer, "dec_deg"));
            let off_px = apart_arcsec(found, *centre_deg) / scale_arcsec_px;
            println!("{name}: {off_px:.3} px off, {} stars, rms {} px", answer["matched"], answer["rms_px"]);
            // The trailed frame's truth is that of shutter open: its stars went 7.4 px on, and are seen in the middle.
            let expected_px = if name == "f16_trailed" { 3.69 } else { 0.0 };
            assert!((off_px - expected_px).abs() < 0.4, "{name}: {off_px} px");
            assert!((number(answer, "scale_arcsec_px") / scale_arcsec_px - 1.0).abs() < 5e-3, "{answer}");
            assert!(number(answer, "false_alarm") < 1e-6 && number(answer, "rms_px") < 1.0, "{answer}");
        }
    }
}

const PROMISED: [&str; 13] = [
    "file",
    "solved",
    "ra_deg",
    "dec_deg",
    "scale_arcsec_px",
    "rotation_deg",
    "mirrored",
    "matched",
    "rms_px",
    "false_alarm",
    "reason",
    "hdu",
    "wcs",
];

#[test]
fn hints_come_from_options_or_from_many_a_header_and_a_missing_one_is_named() {
    let folder = TempDir::new().unwrap();
    let wide = golden().into_iter().find(|golden| golden.name == "f02_wide_undersampled").unwrap();
    let ((ra, dec), scale) = (wide.centre_deg, wide.scale_arcsec_px);
    let solve = |cards: &[&str], more: &[String]| {
        let file = wide.written(folder.path(), Some(cards)).display().to_string();
        let catalogue = stars().display().to_string();
        let all = ["solve", "--json", "--blind-s=0", "--catalogue", &catalogue].map(str::to_owned);
        starmesh(all.iter().chain(more).chain([&file]))
    };
    let near = |cards: &[&str], more: &[String]| {
        let output = solve(cards, more);
        assert!(output.success, "{cards:?} {more:?}: {}{}", output.out, output.err);
        let answer = &output.json()[0];
        let found = (number(answer, "ra_deg"), number(answer, "dec_deg"));
        assert!(apart_arcsec(found, (ra, dec)) < 0.4 * scale, "{cards:?} {more:?}: {answer}");
    };
    let place = [format!("--ra-deg={}", ra + 0.02), format!("--dec-deg={}", dec - 0.01)];
    let scaled = format!("--scale-arcsec-px={}", scale * 1.01);
    near(&[], &[&place[..], std::slice::from_ref(&scaled)].concat());
    // 120.0 deg and +50 deg as NINA, MaxIm and others write them.
    near(&["OBJCTRA = '08 00 01'", "OBJCTDEC= '+50 00 00'", "PIXSCALE= 0.82"], &[]);
    near(&["RA      = '08:00:01'", "DEC     = '+50:00:00'", "FOCALLEN= 2500.0", "XPIXSZ  = 10.0"], &[]);
    near(&["CRVAL1  = 120.01", "CRVAL2  = 50.01", "SECPIX  = 0.83"], &[]);
    near(
        &[
            "CTYPE1  = 'RA---TAN'",
            "CTYPE2  = 'DEC--TAN'",
            "CRVAL1  = 120.01",
            "CRVAL2  = 50.01",
            "CRPIX1  = 150.0",
            "CRPIX2  = 150.0",
            "CDELT1  = -0.000229",
            "CDELT2  = 0.000229",
        ],
        &[],
    );
    for (cards, more, words) in [
        (&[][..], &[][..], "no hint: the header has no place (RA/DEC"),
        (&[], &place[..], "no hint: the header has no scale (FOCALLEN and XPIXSZ"),
        (
            &["RA      = 'east'", "DEC     = 12.0"],
            std::slice::from_ref(&scaled),
            "no hint: the header has no place (RA/DEC",
        ),
        (
            &["RA      = 300.0", "DEC     = -60.0"],
            std::slice::from_ref(&scaled),
            "catalogue too shallow: 0 stars in this field",
        ),
    ] {
        let output = solve(cards, more);
        assert!(!output.success);
        let answer = &output.json()[0];
        assert_eq!(fields(answer), PROMISED);
        assert!(answer["wcs"].is_null(), "{answer}");
        let reason = answer["reason"].as_str().unwrap();
        assert!(reason.starts_with(words), "{words:?}: {answer}");
        assert!(
            !cards.iter().any(|card| card.contains("east"))
                || reason.contains("passed over in the header: RA/DEC ('east'"),
            "{reason}"
        );
    }
    let output = solve(&[], &place[..1]);
    assert!(!output.success && output.err.contains("give both --ra-deg and --dec-deg"), "{}", output.err);
}

#[test]
fn whole_golden_frames_are_solved() {
    let Some(folder) = std::env::var_os("STARMESH_GOLDEN").map(PathBuf::from) else {
        return println!("golden frames: 0 of 12 run");
    };
    let mut frames: Vec<PathBuf> =
        std::fs::read_dir(folder.join("frames")).unwrap().map(|file| file.unwrap().path()).collect();
    frames.retain(|file| file.to_string_lossy().ends_with(".fits.gz"));
    frames.sort();
    assert_eq!(frames.len(), 12);
    let catalogue = folder.join("catalogue_shared.db");
    let output =
        starmesh([PathBuf::from("solve"), "--json".into(), "--catalogue".into(), catalogue].iter().chain(&frames));
    for answer in output.json() {
        let file = answer["file"].as_str().unwrap();
        let truth = std::fs::read_to_string(file.replace(".fits.gz", ".truth.json")).unwrap();
        let truth: serde_json::Value = serde_json::from_str(&truth).unwrap();
        if file.contains("f11_two_stars") {
            assert_eq!(answer["solved"], false);
            continue;
        }
        // The truth's centre is that of pixel (width / 2, height / 2), half a pixel from ours in both axes.
        let centre = truth["image_centre_deg"].as_array().map(|c| (c[0].as_f64().unwrap(), c[1].as_f64().unwrap()));
        let found = (number(&answer, "ra_deg"), number(&answer, "dec_deg"));
        let off_px = apart_arcsec(found, centre.unwrap()) / number(&answer, "scale_arcsec_px");
        println!("{file}: {off_px:.3} px off the centre of pixel (width / 2, height / 2)");
        assert!((off_px - 0.5_f64.sqrt()).abs() < 0.4, "{file}: {off_px} px");
    }
    println!("golden frames: 12 of 12 run");
}

#[test]
fn the_focus_of_the_golden_sweeps_is_found() {
    for (sweep, truth) in [("s1", 10_000.0), ("s4", 9962.0)] {
        let folder = frame("focus");
        let mut files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().path()).collect();
        files.retain(|file| {
            let name = file.file_name().unwrap().to_str().unwrap();
            name.starts_with(&format!("{sweep}_")) && name.ends_with(".fits.gz")
        });
        assert_eq!(files.len(), 15);
        let output = starmesh([PathBuf::from("focus"), "--json".into()].iter().chain(&files));
        assert!(output.success, "{}", output.err);
        let answer = &output.json()[0];
        assert_eq!(fields(answer), ["best_position", "error", "model", "hfd_px", "critical_zone", "points", "reason"]);
        assert_eq!(answer["points"].as_array().unwrap().len(), 15);
        assert_eq!(fields(&answer["points"][0]), ["file", "position", "hfd_px", "error_px", "stars", "used"]);
        let (best, zone) = (number(answer, "best_position"), number(answer, "critical_zone"));
        println!("{sweep}: {best} +- {}, drawn {truth}", answer["error"]);
        assert!((best - truth).abs() < 0.2 * zone, "{sweep}: {best}, drawn {truth}");
        assert!(number(answer, "error") < 0.2 * zone);
        // One side of the V alone has no minimum that could be trusted.
        files.sort();
        let output = starmesh([PathBuf::from("focus"), "--json".into()].iter().chain(&files[..5]));
        assert!(!output.success && output.json()[0]["best_position"].is_null(), "{}", output.out);
        assert!(output.json()[0]["reason"].is_string());
    }
}

#[test]
fn a_frame_without_a_focus_position_is_named() {
    let output = starmesh(["focus".into(), frame("f01_nominal.fits.gz")]);
    assert!(!output.success);
    assert!(output.err.contains("f01_nominal.fits.gz has no FOCUSPOS in its header"), "{}", output.err);
}

#[test]
fn a_hint_that_cannot_be_is_passed_over_and_the_other_keywords_solve_the_frame() {
    // The same frame: next to good keywords a WCS of defaults, and zeros for the place and the scale.
    for name in ["f06_dummy_wcs", "f15_ra_dec_zero_placeholders"] {
        let file = stars().with_file_name("hints").join(format!("{name}.fits.gz"));
        let output = starmesh(["solve".into(), "--json".into(), file]);
        let answer = &output.json()[0];
        assert!(output.success && answer["solved"] == true, "{name}: {answer}");
        let found = (number(answer, "ra_deg"), number(answer, "dec_deg"));
        assert!(apart_arcsec(found, (60.021961, -30.013096)) < 60.0, "{name}: {answer}");
        assert!((number(answer, "scale_arcsec_px") - 10.56).abs() < 0.1, "{name}: {answer}");
    }
}
