//! `starmesh solve` and an installed `solve-field`: its input, the checks of its answer, and its bounded time. The
//! program itself is not part of the test machine; scripts stand at its place, and the real one is run where it is
//! installed with index files and `STARMESH_REAL_SKY` is set.
#![cfg(unix)]

use std::ffi::OsString;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

use crate::command::number;

/// The geometric centre of the frame below, deg, and its scale, arcsec/px (tests/golden/centres.csv).
const CENTRE_DEG: (f64, f64) = (120.114_861_0, 50.074_343_0);
const SCALE_ARCSEC_PX: f64 = 0.825_059;

/// A golden frame; its header contains neither place nor scale.
fn frame() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/imaging/tests/golden/f02_wide_undersampled.fits.gz")
}

fn golden_stars() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/stars.csv.gz")
}

/// Puts a script at the place of `solve-field`; answers the PATH with it.
fn stand_in(folder: &Path, script: &str) -> OsString {
    let file = folder.join("solve-field");
    std::fs::write(&file, format!("#!/bin/sh\n{script}\n")).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755)).unwrap();
    let others = std::env::var_os("PATH").unwrap();
    std::env::join_paths([folder.to_owned()].into_iter().chain(std::env::split_paths(&others))).unwrap()
}

fn solve(path: &OsString, catalogue: &Path, more: &[&str]) -> (bool, Value) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_starmesh"));
    command.args(["solve", "--json", "--catalogue"]).arg(catalogue).args(more).arg(frame()).env("PATH", path);
    let output = command.output().unwrap();
    let printed = String::from_utf8(output.stdout).unwrap();
    let words = String::from_utf8(output.stderr).unwrap();
    (output.status.success(), serde_json::from_str(printed.trim()).unwrap_or_else(|_| panic!("{printed}{words}")))
}

/// The solution that the program would write: the frame's own, a pixel and a half off.
fn write_wcs(file: &Path) {
    let step = SCALE_ARCSEC_PX / 3600.0;
    let cards = [
        "SIMPLE  =                    T".to_owned(),
        "BITPIX  =                    8".to_owned(),
        "NAXIS   =                    0".to_owned(),
        "CTYPE1  = 'RA---TAN-SIP'".to_owned(),
        "CTYPE2  = 'DEC--TAN-SIP'".to_owned(),
        format!("CRVAL1  = {}", CENTRE_DEG.0),
        format!("CRVAL2  = {}", CENTRE_DEG.1),
        "CRPIX1  = 161.5".to_owned(),
        "CRPIX2  = 161.0".to_owned(),
        format!("CD1_1   = {step}"),
        "CD1_2   = 0.0".to_owned(),
        "CD2_1   = 0.0".to_owned(),
        format!("CD2_2   = {}", -step),
        "END".to_owned(),
    ];
    let mut text: String = cards.iter().map(|card| format!("{card:80}")).collect();
    while text.len() < 2880 {
        text.push(' ');
    }
    std::fs::write(file, text).unwrap();
}

#[test]
fn its_place_is_verified_with_our_own_catalogue_or_called_what_it_is() {
    let folder = TempDir::new().unwrap();
    let (wcs, arguments, list) =
        (folder.path().join("a.wcs"), folder.path().join("arguments"), folder.path().join("list"));
    write_wcs(&wcs);
    let script = format!(
        "echo \"$@\" > {}\nwhile [ $# -gt 1 ]; do [ \"$1\" = --wcs ] && cp {} \"$2\"; shift; done\ncp \"$1\" {}",
        arguments.display(),
        wcs.display(),
        list.display()
    );
    let path = stand_in(folder.path(), &script);
    let (success, answer) = solve(&path, &golden_stars(), &["--scale-arcsec-px=0.83"]);
    assert!(success && answer["solved"] == true && answer["reason"].is_null(), "{answer}");
    assert!(number(&answer, "matched") >= 10.0 && number(&answer, "false_alarm") < 1e-6, "{answer}");
    let east = (number(&answer, "ra_deg") - CENTRE_DEG.0) * CENTRE_DEG.1.to_radians().cos();
    let off_px = east.hypot(number(&answer, "dec_deg") - CENTRE_DEG.1) * 3600.0 / SCALE_ARCSEC_PX;
    assert!(off_px < 0.4, "our own place, not the other program's: {off_px} px off");
    let arguments = std::fs::read_to_string(arguments).unwrap();
    for words in ["--width 320 --height 320", "--scale-low 0.74700 --scale-high 0.91300", "--cpulimit 30"] {
        assert!(arguments.contains(words), "{words:?} in {arguments}");
    }
    // The list of stars is a table that others can read.
    let mut table = fits::Table::open(&list).unwrap();
    let (x, flux) = (table.column("X").unwrap().clone(), table.column("FLUX").unwrap().clone());
    assert!(table.rows() > 20);
    let mut last = f64::INFINITY;
    while let Some(row) = table.next_row().unwrap() {
        assert!((0.5..320.5).contains(&x.value(row).unwrap()));
        assert!(flux.value(row).unwrap() <= last, "the brightest first");
        last = flux.value(row).unwrap();
    }
    // A catalogue that does not know this field.
    let other = folder.path().join("other.csv");
    std::fs::write(&other, "ra,dec,mag\n10,10,5\n").unwrap();
    let (success, answer) = solve(&path, &other, &["--scale-arcsec-px=0.83"]);
    assert!(success && answer["solved"] == true && answer["matched"].is_null(), "{answer}");
    assert!(answer["reason"].as_str().unwrap().starts_with("by solve-field alone"), "{answer}");
    assert!((number(&answer, "scale_arcsec_px") / SCALE_ARCSEC_PX - 1.0).abs() < 1e-3);
}

#[test]
fn it_is_ended_with_all_that_it_started() {
    end_it();
}

/// How long the search and the program took.
fn end_it() -> Duration {
    let folder = TempDir::new().unwrap();
    let pid = folder.path().join("pid");
    let path = stand_in(folder.path(), &format!("sleep 300 & echo $! > {}; wait", pid.display()));
    let started = Instant::now();
    // Too narrow for a search of our own: the time is that of the program.
    let (success, answer) = solve(&path, &golden_stars(), &["--blind-s=5", "--scale-arcsec-px=0.83"]);
    let took = started.elapsed();
    assert!(!success && answer["solved"] == false);
    let reason = answer["reason"].as_str().unwrap();
    assert!(reason.starts_with("no hint: ") && reason.ends_with("; solve-field found nothing either"), "{reason}");
    let pid = std::fs::read_to_string(pid).unwrap();
    let is_gone = || {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", pid.trim())).unwrap_or_default();
        // Ended, though no process may have waited for its end yet.
        stat.is_empty() || stat.rsplit(") ").next().unwrap_or_default().starts_with('Z')
    };
    while !is_gone() {
        // By itself it would end after 300 s.
        assert!(started.elapsed() < Duration::from_secs(250), "its child goes on");
        std::thread::sleep(Duration::from_millis(50));
    }
    // And never asked where that is wanted.
    let (_, answer) = solve(&path, &golden_stars(), &["--blind-s=0"]);
    assert!(!answer["reason"].as_str().unwrap().contains("solve-field"), "{answer}");
    took
}

#[test]
fn the_real_program_finds_a_real_frame_whose_hint_is_wrong() {
    let path = std::env::var_os("PATH").unwrap();
    let is_there = std::env::split_paths(&path).any(|folder| folder.join("solve-field").is_file());
    let real = std::env::var_os("STARMESH_REAL_SKY").map(|folder| PathBuf::from(folder).join("2mass/gc_2mass_j.fits"));
    let Some(real) = real.filter(|_| is_there) else { return println!("solve-field: 0 of 1 run") };
    // Its index files may not cover the field: then it must report that.
    let mut command = Command::new(env!("CARGO_BIN_EXE_starmesh"));
    command.args(["solve", "--json", "--ra-deg=80", "--dec-deg=60", "--scale-arcsec-px=5", "--blind-s=30"]).arg(real);
    let answer: Value = serde_json::from_slice(&command.output().unwrap().stdout).unwrap();
    if answer["solved"] == true {
        assert!((number(&answer, "ra_deg") - 266.399_978).abs() < 0.01, "{answer}");
        assert!((number(&answer, "dec_deg") + 28.933_319).abs() < 0.01, "{answer}");
    } else {
        assert!(answer["reason"].as_str().unwrap().ends_with("solve-field found nothing either"), "{answer}");
    }
    println!("solve-field: 1 of 1 run: {answer}");
}

mod proof {
    use super::*;

    /// A bound in seconds on a real clock.
    #[test]
    fn it_is_ended_in_time() {
        let took = end_it();
        assert!(took < Duration::from_secs(60), "{took:?}");
    }
}
