//! `starmesh solve --write` and `--wcs`, files of several images and planes, and outputs that are inputs.

use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::command::{Output, number, starmesh};

const SCALE: &str = "--scale-arcsec-px=0.83";
const PLACE: [&str; 2] = ["--ra-deg=120.11", "--dec-deg=50.07"];

fn golden_stars() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/stars.csv.gz")
}

/// A golden frame with more cards in its header: those of an older solution of other conventions.
fn frame(more: &[&str]) -> Vec<u8> {
    let golden =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/imaging/tests/golden/f02_wide_undersampled.fits.gz");
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(std::fs::File::open(golden).unwrap()).read_to_end(&mut bytes).unwrap();
    let end = bytes.chunks(80).position(|card| card.starts_with(b"END ")).unwrap();
    for (n, card) in more.iter().chain([&"END"]).enumerate() {
        bytes[80 * (end + n)..80 * (end + n + 1)].copy_from_slice(format!("{card:80}").as_bytes());
    }
    bytes
}

const OLD: [&str; 10] = [
    "SURVEY  = 'M 1     '           / kept",
    "CTYPE1  = 'RA---TPV'",
    "CTYPE2  = 'DEC--TPV'",
    "CDELT1  = 0.5",
    "PC1_2   = 0.25",
    "PV1_1   = 1.0",
    "A_ORDER = 2",
    "A_2_0   = 0.001",
    "COMMENT = kept too",
    "EQUINOX = 2000.0",
];

fn solve(file: &Path, more: &[&str]) -> Output {
    let catalogue = golden_stars().display().to_string();
    let file = file.display().to_string();
    let first = ["solve", "--json", "--blind-s=0", "--catalogue", &catalogue];
    starmesh(first.iter().chain(more).chain([SCALE, PLACE[0], PLACE[1], &file].iter()))
}

#[test]
fn a_solution_is_written_into_the_frame_and_nothing_else_changes() {
    let folder = TempDir::new().unwrap();
    let old = frame(&OLD);
    let gzip = |bytes: &[u8]| {
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        packed.write_all(bytes).unwrap();
        packed.finish().unwrap()
    };
    for (name, bytes) in [("plain.fits", old.clone()), ("packed.fits.gz", gzip(&old))] {
        let file = folder.path().join(name);
        std::fs::write(&file, &bytes).unwrap();
        let output = solve(&file, &[]);
        assert!(output.success, "{}{}", output.out, output.err);
        assert_eq!(std::fs::read(&file).unwrap(), bytes, "nothing is written that was not asked for");
        let before = fits::read(&file).unwrap();
        let output = solve(&file, &["--write"]);
        assert!(output.success, "{}{}", output.out, output.err);
        let answer = &output.json()[0];
        let after = fits::read(&file).unwrap();
        assert!(before.pixels == after.pixels, "{name}: other pixels");
        let header = &after.header;
        assert_eq!((header.text("SURVEY"), header.number("EQUINOX")), (Ok("M 1"), Ok(2000.0)));
        for gone in ["CDELT1", "PC1_2", "PV1_1"] {
            assert!(header.value(gone).is_none(), "{name}: {gone} stayed");
        }
        let crval = answer["wcs"]["crval_deg"].as_array().unwrap();
        let crpix = answer["wcs"]["crpix_px"].as_array().unwrap();
        for (n, keyword) in ["1", "2"].iter().enumerate() {
            assert!((header.number(&format!("CRVAL{keyword}")).unwrap() - crval[n].as_f64().unwrap()).abs() < 1e-9);
            assert!((header.number(&format!("CRPIX{keyword}")).unwrap() - crpix[n].as_f64().unwrap()).abs() < 1e-9);
        }
        for (keyword, row, column) in [("CD1_1", 0, 0), ("CD1_2", 0, 1), ("CD2_1", 1, 0), ("CD2_2", 1, 1)] {
            let value = answer["wcs"]["cd_deg_px"][row][column].as_f64().unwrap();
            assert!((header.number(keyword).unwrap() - value).abs() < 1e-13, "{keyword}");
        }
        assert_eq!(header.text("CTYPE1").unwrap().ends_with("-SIP"), !answer["wcs"]["sip"].is_null());
        // A solved frame is solved again by its own header.
        let catalogue = golden_stars();
        let again = starmesh(["solve".into(), "--json".into(), "--catalogue".into(), catalogue, file.clone()]);
        assert!(again.success, "{}{}", again.out, again.err);
        assert!((number(&again.json()[0], "ra_deg") - number(answer, "ra_deg")).abs() < 1e-4);
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|file| file.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
}

#[test]
fn a_solution_is_written_into_a_header_of_its_own() {
    let folder = TempDir::new().unwrap();
    let (file, wcs) = (folder.path().join("a.fits"), folder.path().join("a.wcs"));
    std::fs::write(&file, frame(&[])).unwrap();
    let option = format!("--wcs={}", wcs.display());
    let output = solve(&file, &[&option]);
    assert!(output.success, "{}{}", output.out, output.err);
    let header = fits::table::primary_header(&wcs).unwrap();
    assert_eq!(std::fs::metadata(&wcs).unwrap().len() % 2880, 0);
    assert_eq!((header.whole("NAXIS"), header.whole("IMAGEW")), (Ok(0), Ok(320)));
    let value = output.json()[0]["wcs"]["crval_deg"][0].as_f64().unwrap();
    assert!((header.number("CRVAL1").unwrap() - value).abs() < 1e-9);
    let output = solve(&file, &[&format!("--wcs={}", file.display())]);
    assert!(!output.success && output.err.contains("is the frame itself"), "{}", output.err);
    assert!(fits::read(&file).is_ok());
}

#[cfg(unix)]
#[test]
fn a_read_only_frame_is_left_as_it_is() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.fits");
    std::fs::write(&file, frame(&[])).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o444)).unwrap();
    let output = solve(&file, &["--write"]);
    assert!(!output.success && output.err.contains("is read-only and is left as it is"), "{}", output.err);
    assert_eq!(std::fs::read(&file).unwrap(), frame(&[]));
}

#[test]
fn the_image_of_an_hdu_is_solved_and_written_and_the_others_are_reported() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("chips.fits");
    let cards = |cards: &[&str]| {
        let text: String = cards.iter().chain([&"END"]).map(|card| format!("{card:80}")).collect();
        format!("{text:2880}").into_bytes()
    };
    let primary =
        cards(&["SIMPLE  =                    T", "BITPIX  =                    8", "NAXIS   =                    0"]);
    let mut chip = frame(&[]);
    chip[..80].copy_from_slice(format!("{:80}", "XTENSION= 'IMAGE   '").as_bytes());
    let dark = cards(&["XTENSION= 'IMAGE   '", "BITPIX  = 8", "NAXIS   = 2", "NAXIS1  = 64", "NAXIS2  = 45"]);
    let whole = [primary, dark, vec![9; 2880], chip].concat();
    std::fs::write(&file, &whole).unwrap();
    let first = solve(&file, &[]);
    assert!(
        !first.success && first.err.contains("the image of HDU 2 is taken; --hdu takes that of HDU 3"),
        "{}",
        first.err
    );
    let output = solve(&file, &["--hdu=3", "--write"]);
    assert!(output.success && output.json()[0]["hdu"] == 3, "{}{}", output.out, output.err);
    let written = fits::read_part(&file, fits::Part::Hdu(3)).unwrap();
    assert!(written.header.text("CTYPE1").unwrap().starts_with("RA---TAN"));
    assert_eq!(std::fs::read(&file).unwrap()[..3 * 2880], whole[..3 * 2880], "the other parts are as they were");
    let output = solve(&file, &["--hdu=9"]);
    assert!(output.err.contains("has no image in HDU 9; images are in HDU 2, 3"), "{}", output.err);
}

#[test]
fn a_catalogue_is_never_built_over_its_own_source() {
    let folder = TempDir::new().unwrap();
    let source = folder.path().join("stars.csv");
    let table = "ra,dec,mag\n10.5,41.0,9.5\n10.6,41.1,10.5\n";
    std::fs::write(&source, table).unwrap();
    let (link, hard) = (folder.path().join("link.csv"), folder.path().join("hard.csv"));
    std::fs::hard_link(&source, &hard).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink(&source, &link).unwrap();
    let dotted = folder.path().join(".").join("stars.csv");
    for out in [&source, &dotted, &hard, &link] {
        if !out.exists() {
            continue;
        }
        let output = starmesh(["catalogue".into(), "build".into(), "--out".into(), out.clone(), source.clone()]);
        assert!(
            !output.success && output.err.contains("is the same file as the source"),
            "{}: {}",
            out.display(),
            output.err
        );
        assert_eq!(std::fs::read_to_string(&source).unwrap(), table);
    }
    let out = folder.path().join("new.smcat");
    std::fs::write(&out, "older").unwrap();
    let output = starmesh(["catalogue".into(), "build".into(), "--out".into(), out.clone(), source]);
    assert!(output.success, "{}", output.err);
    assert!(std::fs::read(&out).unwrap().len() > 100);
}
