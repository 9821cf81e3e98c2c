//! `starmesh solve` on frames of the real sky with the catalogue that Starmesh ships; the frames stay where
//! `STARMESH_REAL_SKY` points to. Where it is not set, nothing is run, and the test prints that.

use std::io::Write as _;
use std::path::PathBuf;

use crate::command::{number, starmesh};

/// A frame, the options that it needs in addition to its header (degrees, arcsec/px), and the truth: centre (deg),
/// arcsec/px, whether it is a mirror image (astrometry.net's parity "neg").
struct Frame {
    file: &'static str,
    more: &'static [&'static str],
    centre_deg: (f64, f64),
    scale_arcsec_px: f64,
    mirrored: bool,
}

/// Truth by astrometry.net (panoptes) and by the mosaic's own header (2MASS). The DSLR's header contains the direction
/// of the mount, 2 deg off, and no scale; the infrared mosaic's contains both, so the test gives a place 0.3 deg off.
const FRAMES: [Frame; 5] = [
    Frame {
        file: "panoptes/unsolved.fits",
        more: &["--scale-arcsec-px=10.2"],
        centre_deg: (303.210_962, 46.019_547),
        scale_arcsec_px: 10.3066,
        mirrored: true,
    },
    // The hint is 73 deg off.
    Frame {
        file: "panoptes/unsolved.fits",
        more: &["--scale-arcsec-px=10.2", "--ra-deg=303", "--dec-deg=-27", "--within-deg=75"],
        centre_deg: (303.210_962, 46.019_547),
        scale_arcsec_px: 10.3066,
        mirrored: true,
    },
    Frame {
        file: "panoptes/solved.fits.fz",
        more: &["--scale-arcsec-px=10.4"],
        centre_deg: (303.204_653, 46.018_036),
        scale_arcsec_px: 10.3070,
        mirrored: true,
    },
    Frame {
        file: "2mass/gc_2mass_j.fits",
        more: &["--ra-deg=266.7", "--dec-deg=-29.0"],
        centre_deg: (266.399_978, -28.933_319),
        scale_arcsec_px: 5.0,
        mirrored: true,
    },
    Frame {
        file: "2mass/gc_2mass_h.fits",
        more: &["--ra-deg=266.2", "--dec-deg=-28.8"],
        centre_deg: (266.399_978, -28.933_319),
        scale_arcsec_px: 5.0,
        mirrored: true,
    },
];

/// Prints how many were run, past the test's own capture of output.
fn print(run: usize) {
    let _ = writeln!(std::io::stderr(), "real sky: {run} of {} run", FRAMES.len() + 1);
}

#[test]
fn real_frames_are_solved_within_a_pixel_or_refused_for_the_right_reason() {
    let Some(folder) = std::env::var_os("STARMESH_REAL_SKY").map(PathBuf::from) else { return print(0) };
    let file = |name: &str| folder.join(name).display().to_string();
    for frame in &FRAMES {
        let mut arguments = vec!["solve".to_owned(), "--json".to_owned(), file(frame.file)];
        arguments.extend(frame.more.iter().map(|&word| word.to_owned()));
        let output = starmesh(&arguments);
        assert!(output.success, "{}: {}{}", frame.file, output.out, output.err);
        let answer = &output.json()[0];
        let (ra, dec) = frame.centre_deg;
        let east = (number(answer, "ra_deg") - ra) * dec.to_radians().cos();
        let off = east.hypot(number(answer, "dec_deg") - dec) * 3600.0 / frame.scale_arcsec_px;
        println!("{}: {off:.2} px off; {answer}", frame.file);
        assert!(off < 1.0, "{}: {off} px off", frame.file);
        assert!((number(answer, "scale_arcsec_px") / frame.scale_arcsec_px - 1.0).abs() < 1e-3, "{answer}");
        assert_eq!(answer["mirrored"], frame.mirrored, "{answer}");
        assert!(number(answer, "false_alarm") < 1e-6, "{answer}");
    }
    let unsolved = file("panoptes/unsolved.fits");
    let near = ["solve", "--json", "--scale-arcsec-px=10.2", "--ra-deg=303", "--dec-deg=-27", "--within-deg=70"];
    let answer = starmesh(near.iter().chain([&unsolved.as_str()]));
    assert!(!answer.success, "the frame lies beyond 70 deg: {}", answer.out);
    let output = starmesh(["solve".to_owned(), "--json".to_owned(), file("sdss/reprojected_sdss_g.fits.bz2")]);
    assert!(!output.success);
    let answer = &output.json()[0];
    let reason = answer["reason"].as_str().unwrap();
    println!("sdss: {reason}");
    assert!(answer["solved"] == false && reason.starts_with("catalogue too shallow: "), "{answer}");
    assert!(reason.contains(" stars in this field"), "{reason}");
    print(FRAMES.len() + 1);
}
