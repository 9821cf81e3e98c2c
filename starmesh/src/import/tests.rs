use std::fs;

use contract::Name;

use super::*;

const CONFIG: &str = r#"
Telescope:
  - {device_name: mount_a, ip: "10.0.0.5:11111", device_number: 0, equatorial_system: JNow, pointing_treshold: 0.2}
  - {device_name: mount_b, ip: "10.0.0.5:11111", device_number: 1, pointing_threshold: 0.2, meridian_flip: true, meridian_flip_min: 12, settle_factor: 0.5, guider: {PIX2TIME: {+x: 80, -x: 82, +y: 79, -y: 79.5}, DIRECTIONS: {+x: North, -x: South, +y: East, -y: West}, RA_AXIS: y, MIN_GUIDE_INTERVAL: 30, PID_COEFFS: {x: {p: 0.6, i: 0.01, d: 0}, y: {p: 0.7, i: 0.02, d: 0}, set_x: 0.0, set_y: 0}}}
Camera:
  - device_name: cam a
    ip: http://10.0.0.6:11111/
    device_number: 0
    temperature: -30
    temperature_tolerance: 1.5
    cooling_timeout: 20
    flats: {target_adu: 28000, bias_offset: 500, lower_exptime_limit: 2, upper_exptime_limit: 45}
    paired_devices: {Telescope: mount_a, Dome: roof, FilterWheel: fw_a, Focuser: foc_a, ObservingConditions: wx, Camera: cam a}
  - device_name: cam_b
    ip: 10.0.0.6:11111
    device_number: 1
    paired_devices: {Telescope: mount_b, Dome: roof, SafetyMonitor: safe}
FilterWheel: [{device_name: fw_a, ip: "10.0.0.6:11111"}]
Focuser: [{device_name: foc_a, ip: "10.0.0.6:11111", focus_position: 12500, focus_tolerance: 5, settle_time: 2}]
Dome:
  - {device_name: roof, ip: "10.0.0.7:11111", device_number: 0, telescopes: [mount_a, mount_b]}
SafetyMonitor: [{device_name: safe, ip: "10.0.0.8:11111", max_safe_duration: 20, polling_interval: 2}]
ObservingConditions:
  - device_name: wx
    ip: 10.0.0.8:11111
    connectable: false
    closing_limits:
      WindSpeed: [{upper: 12, max_safe_duration: 20}, {upper: 16, max_safe_duration: 60}]
      Temperature: [{lower: -5, upper: 35}]
Guider: [{device_name: g, ip: "10.0.0.9:11111"}]
Misc:
  backup_time: "11:30"
  Webcam: http://localhost:8888/inside
  filename_templates: {object: "{action_date}/{device}_{timestamp}.fits"}
"#;

const SCHEDULE: &str = r#"// first night
{"device_name": "cam a", "action_type": "object", "action_value": {"object": "x", "exptime": 30, "ra": 1, "dec": 2},
 "start_time": "2026-01-01 02:00:00", "end_time": "2026-01-01 03:00:00"}
{"device_name": "cam_b", "action_type": "close", "action_value": {}, "start_time": "2026-01-01T05:00:00", "end_time": "2026-01-01T06:00:00"}
{"device_name": "cam_c", "action_type": "close", "action_value": {}, "start_time": "2026-01-01T05:00:00", "end_time": "2026-01-01T06:00:00"}
"#;

fn old_site(config: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (file, text) in [
        ("observatory_config/twins_config.yml", config),
        ("observatory_config/twins_fits_header_config.csv", config::header::DEFAULT_CSV),
        ("schedules/twins.jsonl", SCHEDULE),
        ("astra_config.yml", "observatory_name: twins\n"),
    ] {
        let path = folder.path().join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    folder
}

fn options(folder: &Path) -> Options {
    Options {
        folder: folder.to_owned(),
        out: folder.join("new"),
        name: None,
        site: None,
        latitude_deg: Some(-24.6),
        longitude_deg: Some(-70.4),
        elevation_m: Some(2500.0),
        offline: true,
        simulator: None,
    }
}

#[tokio::test]
async fn an_observatory_of_two_telescopes_becomes_a_file_for_each_and_one_for_what_they_share() {
    let old = old_site(CONFIG);
    run(options(old.path())).await.unwrap();
    let read = |name: &str| {
        let folder = old.path().join("new").join(name);
        config::parse(&fs::read_to_string(folder.join("observatory.toml")).unwrap(), &folder).unwrap()
    };
    let a = read("mount-a");
    assert_eq!((a.place.site.as_str(), a.camera[0].common.name.as_str()), ("twins", "cam_a"));
    assert_eq!(a.camera[0].common.server, "10.0.0.6:11111");
    assert_eq!((a.camera[0].temperature_c, a.camera[0].cooling_timeout_min), (Some(-30.0), 20.0));
    let flats = a.camera[0].flats;
    assert_eq!((flats.target_adu, flats.tolerance_adu, flats.bias_adu), (Some(28_000.0), None, Some(500.0)));
    assert_eq!((flats.exposure_min_s, flats.exposure_max_s), (2.0, 45.0));
    assert_eq!(a.camera[0].focuser.as_ref().map(Name::as_str), Some("foc_a"));
    assert_eq!(a.telescope[0].equatorial_system, config::EquatorialChoice::Topocentric);
    assert_eq!((a.focuser[0].best_position, a.focuser[0].tolerance_steps), (Some(12_500), 5));
    assert_eq!(a.shared.dwell_min, 20.0);
    assert_eq!(a.shared.limit.len(), 3);
    assert_eq!((a.shared.limit[1].upper, a.shared.limit[1].dwell_min), (Some(16.0), 60.0));
    assert_eq!(a.archive.filename["object"], "{action_date}/{device}_{timestamp}.fits");
    assert!(!a.schedule.robotic, "a person switches it on");
    let b = read("mount-b");
    assert_eq!(b.focuser.len(), 0);
    assert_eq!((b.pointing.threshold_arcmin, b.guiding.interval_min_s), (0.2, 30.0));
    assert_eq!((b.guiding.pid_ra.p, b.guiding.pid_dec.p), (0.7, 0.6), "right ascension lies along y");
    assert_eq!((b.telescope[0].settle_factor, a.telescope[0].settle_factor), (0.5, 0.0));
    assert_eq!((b.telescope[0].meridian_flip, b.telescope[0].meridian_flip_min), (true, 12.0));
    let pulses = b.camera[0].guide_calibration.unwrap();
    assert!((pulses.east_px_per_s[1] - 12.62).abs() < 0.01 && pulses.north_px_per_s[0] > 12.0, "{pulses:?}");
    assert!(b.guiding.dec_reversed_after_flip && !a.guiding.dec_reversed_after_flip);
    assert_eq!(a.camera[0].guide_calibration, None);
    assert_eq!(b.shared.dome[0].as_str(), "roof");
    let shared = read("shared");
    assert!(a.web.listen != b.web.listen && b.web.listen != shared.web.listen && shared.web.listen != a.web.listen);
    assert_eq!(shared.dome[0].follow, config::Follow::Off, "as before");
    assert_eq!(shared.dome[0].telescopes.len(), 2);
    assert_eq!(shared.dome[0].close_with_mount, config::CloseWithMount::ParkedWithinS);
    assert_eq!((shared.safetymonitor[0].common.period_s, shared.observingconditions[0].common.connect), (2.0, false));

    let schedule = fs::read_to_string(old.path().join("new/mount-a/schedule.jsonl")).unwrap();
    let cameras = ["cam_a".parse().unwrap()];
    assert_eq!(::schedule::parse(&schedule, &cameras).unwrap().len(), 1);
    assert!(schedule.starts_with("// first night\n"), "{schedule}");
    assert!(a.archive.fits_header.is_some_and(|table| table.exists()));

    let again = run(options(old.path())).await.unwrap_err().to_string();
    assert!(again.contains("stays as it is"), "{again}");
}

#[test]
fn what_is_not_carried_over_is_listed_with_its_line() {
    let old = old_site(CONFIG);
    let mut notes = Notes::default();
    read_config(&old.path().join("observatory_config/twins_config.yml"), &mut notes).unwrap();
    let assert_note = |line: usize, words: &str| {
        assert!(notes.lines.iter().any(|(at, what)| *at == line && what.contains(words)), "{words}: {notes:#?}");
    };
    assert_note(3, "pointing_treshold");
    assert_note(6, "is named \"cam_a\" here");
    assert_note(21, "parked_only");
    assert_note(29, "max_safe_duration");
    assert_note(30, "Guider");
    assert_note(33, "Webcam");
    assert!(!notes.lines.iter().any(|(_, what)| what.contains("backup_time")));
}

#[tokio::test]
async fn one_telescope_is_one_file_and_an_unknown_place_is_left_to_be_filled_in() {
    let config = "Telescope: [{device_name: M, ip: \"h:1\"}]\nSafetyMonitor: [{device_name: s, ip: \"h:1\"}]\n\
                  Dome: [{device_name: d, ip: \"h:1\", close_dome_on_telescope_error: true}]\n";
    let old = old_site(config);
    run(Options { latitude_deg: None, ..options(old.path()) }).await.unwrap();
    let folder = old.path().join("new");
    let text = fs::read_to_string(folder.join("observatory.toml")).unwrap();
    let error = config::parse(&text, &folder).unwrap_err().to_string();
    assert!(error.contains("latitude_deg"), "{error}");
    let known =
        text.replace("# latitude_deg = ?", "latitude_deg = 1").replace("# longitude_deg = ?", "longitude_deg = 1");
    let site = config::parse(&known.replace("# elevation_m = ?", "elevation_m = 1"), &folder).unwrap();
    assert_eq!(site.safetymonitor[0].dwell_min, 30.0, "what Astra takes where nothing is set");
    assert_eq!(site.dome[0].close_with_mount, config::CloseWithMount::Alongside);
}

#[tokio::test]
async fn a_device_without_server_is_reported_with_its_line() {
    let old = old_site("Camera:\n  - {device_name: c}\n");
    let error = format!("{:#}", run(options(old.path())).await.unwrap_err());
    assert!(error.contains("line 2: Camera c: ip is missing"), "{error}");
    let nothing = tempfile::tempdir().unwrap();
    let error = format!("{:#}", run(options(nothing.path())).await.unwrap_err());
    assert!(error.contains("_config.yml"), "{error}");
}

#[tokio::test]
async fn a_site_can_be_tried_on_a_simulator_in_the_place_of_its_devices() {
    let config =
        "Telescope: [{device_name: M, ip: \"h:1\", device_number: 3}]\nCamera: [{device_name: c, ip: \"h:2\"}]\n";
    let old = old_site(config);
    let on = |old: &tempfile::TempDir| Options { simulator: Some("127.0.0.1:11111".to_owned()), ..options(old.path()) };
    run(on(&old)).await.unwrap();
    let folder = old.path().join("new");
    let site = config::parse(&fs::read_to_string(folder.join("observatory.toml")).unwrap(), &folder).unwrap();
    assert_eq!(site.clock.simulator.as_deref(), Some("http://127.0.0.1:11111"));
    assert!(site.devices().iter().all(|(_, common)| (common.server.as_str(), common.number) == ("127.0.0.1:11111", 0)));
    let two = run(on(&old_site(CONFIG))).await.unwrap_err().to_string();
    assert!(two.contains("line 4: Telescope mount_b is a second one"), "{two}");
}

#[tokio::test]
async fn a_limit_on_what_the_station_does_not_measure_holds_once_it_does() {
    let simulator = simulator::Simulator::start(simulator::Options::default()).await.unwrap();
    let (error, only) = (Some(0x400), vec!["skytemperature".to_owned()]);
    simulator
        .world()
        .fault(simulator::Kind::ObservingConditions, simulator::Fault { error, only, ..Default::default() });
    let station = simulator.address();
    // As the predecessor leaves them.
    for kind in ["telescope", "observingconditions"] {
        let connect = format!("http://{station}/api/v1/{kind}/0/connected");
        let answer =
            reqwest::Client::new().put(connect).body("Connected=true&ClientID=1&ClientTransactionID=1").send().await;
        assert!(answer.unwrap().status().is_success());
    }
    let config = format!(
        "Telescope: [{{device_name: m, ip: \"{station}\"}}]\nObservingConditions:\n  - device_name: wx\n    ip: {station}\n    closing_limits:\n      \
         Humidity: [{{upper: 80, max_safe_duration: 10}}]\n      RelativeSkyTemp: [{{upper: -20, max_safe_duration: 10}}]\n"
    );
    let old = old_site(&config);
    run(Options { offline: false, latitude_deg: None, ..options(old.path()) }).await.unwrap();
    let folder = old.path().join("new");
    let site = config::parse(&fs::read_to_string(folder.join("observatory.toml")).unwrap(), &folder).unwrap();
    let required: Vec<bool> = site.observingconditions[0].limit.iter().map(|limit| limit.required).collect();
    assert_eq!(required, [true, false], "{:#?}", site.observingconditions[0]);
    assert!(
        (site.place.latitude_deg - simulator::Options::default().latitude.degrees()).abs() < 1e-6,
        "{:?}",
        site.place
    );
    simulator.stop().await;
}
