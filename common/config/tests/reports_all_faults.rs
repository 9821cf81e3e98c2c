//! Wrong configurations are refused with the line, what was expected, and no word of a programmer; all faults at once.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod wrong;

use std::path::Path;

use contract::observatory::Severity;

use wrong::{FOREIGN, GOOD, WRONG, changed};

#[test]
fn each_wrong_file_is_refused_with_its_line_in_words_of_the_field() {
    let mut failed = Vec::new();
    for wrong in WRONG {
        let text = changed(wrong);
        let message = match config::parse(&text, Path::new("/site")) {
            Ok(_) => "taken".to_owned(),
            Err(error) => error.to_string(),
        };
        let (_, to, line, words) = wrong;
        let found = message.lines().find(|found| found.starts_with(&format!("line {line}: ")));
        let is_right = found.is_some_and(|found| words.iter().all(|word| found.contains(word)));
        let foreign = FOREIGN.iter().find(|word| message.contains(**word));
        if !is_right || foreign.is_some() || message.lines().count() > 1 {
            failed.push(format!("{to:?}, line {line}, {words:?}, {foreign:?}:\n{message}"));
        }
    }
    assert!(failed.is_empty(), "{} of {}:\n\n{}", failed.len(), WRONG.len(), failed.join("\n\n"));
}

#[test]
fn a_file_with_ten_faults_reports_ten_with_their_lines_in_order() {
    let text = GOOD
        .replace("paranal", "Paranal!")
        .replace("latitude_deg", "lat_deg")
        .replace("2518", "2518000")
        .replace("10.0.0.5:11111\"\nlimits", "10.0.0.5:70000\"\nlimits")
        .replace("number = 0", "number = \"0\"")
        .replace("= -60", "= 213")
        .replace("permit_valid_s", "permit_valid")
        .replace("dwell_min = 15", "dwell_min = \"long\"")
        .replace("upper = 80, reopen_upper = 75", "upper = 0.8")
        .replace("WindSpeed", "WindSpead");
    let (_, faults) = config::examine(&text, Path::new("/site"));
    let lines: Vec<usize> =
        faults.iter().filter(|fault| fault.severity == Severity::Error).map(|fault| fault.line).collect();
    assert_eq!(lines, [2, 4, 6, 16, 22, 23, 29, 34, 40, 41], "{faults:#?}");
}

#[test]
fn a_file_without_devices_has_nothing_to_run_and_one_without_monitor_is_warned_of() {
    let place = &GOOD[..GOOD.find("[safety]").unwrap()];
    let (_, faults) = config::examine(place, Path::new("/site"));
    assert!(faults[0].severity == Severity::Error && faults[0].what.contains("no device"), "{faults:?}");
    // a page for a whole network needs none
    config::parse(place, Path::new("/site")).unwrap();
    let cut = GOOD.find("[[safetymonitor]]").unwrap();
    let (values, faults) = config::examine(&GOOD[..cut], Path::new("/site"));
    assert!(values.is_some() && faults.len() == 1, "{faults:?}");
    assert!(
        faults[0].what.contains("no safety monitor") && faults[0].what.contains("a dome stays closed"),
        "{faults:?}"
    );
    let (values, faults) = config::examine(GOOD, Path::new("/site"));
    assert!(values.is_some() && faults.is_empty(), "{faults:?}");
}

/// A file with one more block at its end.
fn with(block: &str) -> Vec<String> {
    let (_, faults) = config::examine(&format!("{GOOD}{block}"), Path::new("/site"));
    faults.into_iter().map(|fault| fault.what).collect()
}

#[test]
fn what_each_telescope_decides_has_no_effect_at_a_shared_device_and_is_warned_of() {
    let shared = "[observatory]\nsite = \"paranal\"\ntelescope = \"shared\"\nlatitude_deg = -24.6\nlongitude_deg = -70.4\n\
                  elevation_m = 2518\n[[observingconditions]]\nname = \"wx\"\nserver = \"10.0.0.5:11111\"\nnumber = 0\n\
                  limit = [{ parameter = \"WindSpeed\", upper = 12.0 }]\n[[safetymonitor]]\nname = \"cloud\"\n\
                  server = \"10.0.0.5:11111\"\nnumber = 0\ndwell_min = 30\nmax_age_s = 20\n\
                  disabled = \"its head is wet\"\n[[switch]]\nname = \"ups\"\nserver = \"10.0.0.5:11111\"\n\
                  limit = [{ parameter = \"GetSwitchValue0\", lower = 50 }]\n";
    let (values, faults) = config::examine(shared, Path::new("/site"));
    assert!(values.is_some(), "{faults:?}");
    let warned: Vec<(usize, bool)> = faults
        .iter()
        .filter(|fault| fault.severity == Severity::Warning)
        .map(|fault| (fault.line, fault.what.contains("own file")))
        .collect();
    assert_eq!(warned, [(11, true), (16, true), (17, true), (18, true), (22, true)], "{faults:#?}");
    let (_, faults) =
        config::examine(&shared.replace("limit =", "# limit =").replace("= 30", "= 15"), Path::new("/site"));
    assert_eq!(faults.len(), 2, "{faults:#?}");
}

#[test]
fn one_device_under_two_names_of_its_server_is_one_device() {
    for (one, other) in [
        ("localhost:11111", "127.0.0.1:11111"),
        ("[::1]:11111", "LocalHost:11111"),
        ("dome-pc.example.org:80", "Dome-PC.example.org.:80"),
        ("[2001:db8::1]:80", "[2001:db8:0:0::1]:80"),
    ] {
        let block = |name: &str, server: &str| format!("[[focuser]]\nname = \"{name}\"\nserver = \"{server}\"\n");
        let faults = with(&(block("a", one) + &block("b", other)));
        assert!(
            faults.len() == 1 && faults[0].contains("is the same device as focuser \"a\""),
            "{one}, {other}: {faults:?}"
        );
        let faults = with(&(block("a", one) + &block("b", "10.9.9.9:11111")));
        assert!(faults.is_empty(), "{one}: {faults:?}");
    }
}

#[test]
fn a_mount_under_a_roof_that_closes_over_parked_mounts_only_is_to_be_read_often() {
    let mount = "limits = { altitude_min_deg = 20 }";
    let dome = "[[dome]]\nname = \"dome\"\nserver = \"10.0.0.5:11111\"\npermit_valid_s = 10\n";
    let faults = |period_s: &str, change: &str, to: &str| {
        let text = GOOD.replace(mount, &format!("{mount}\nperiod_s = {period_s}")).replace(change, to);
        config::examine(&text, Path::new("/site")).1
    };
    let closes =
        |period_s: &str, how: &str| faults(period_s, "permit_valid_s = 10", &format!("close_with_mount = \"{how}\""));
    let wrong = closes("10", "parked_only");
    assert!(wrong.len() == 1 && wrong[0].line == 18 && wrong[0].severity == Severity::Warning, "{wrong:#?}");
    for words in ["telescope \"mount\": period_s = 10", "at most 5 s", "dome \"dome\"", "leave period_s out"] {
        assert!(wrong[0].what.contains(words), "{wrong:#?}");
    }
    // The file of the shared roof is another one.
    let doubtful = faults("10", dome, "[shared]\ndome = [\"roof\"]\n");
    assert!(doubtful.len() == 1 && doubtful[0].severity == Severity::Warning, "{doubtful:#?}");
    assert!(doubtful[0].line == 18 && doubtful[0].what.contains("dome \"roof\""), "{doubtful:#?}");
    for fine in [closes("5", "parked_only"), closes("10", "parked_within_s"), closes("10", "alongside")] {
        assert!(fine.is_empty(), "{fine:#?}");
    }
}

#[test]
fn a_limit_from_the_wrong_side_or_that_closes_nothing_is_warned_of() {
    for (limit, words) in [
        ("parameter = \"SkyTemperature\", lower = -30", "is upper meant?"),
        ("parameter = \"RelativeSkyTemp\", lower = -20", "is upper meant?"),
        ("parameter = \"SkyQuality\", upper = 18", "is lower meant?"),
        ("parameter = \"DewPointMargin\", upper = 3", "is lower meant?"),
        ("parameter = \"Humidity\", upper = 100", "closes nothing"),
    ] {
        let text = GOOD.replace("parameter = \"WindSpeed\", upper = 12", limit);
        let (values, faults) = config::examine(&text, Path::new("/site"));
        assert!(values.is_some() && faults.len() == 1, "{limit}: {faults:?}");
        assert!(faults[0].severity == Severity::Warning && faults[0].what.contains(words), "{faults:?}");
    }
    for limit in ["parameter = \"SkyTemperature\", upper = -30", "parameter = \"Temperature\", lower = -5"] {
        let (_, faults) =
            config::examine(&GOOD.replace("parameter = \"WindSpeed\", upper = 12", limit), Path::new("/site"));
        assert!(faults.is_empty(), "{faults:?}");
    }
}

#[test]
fn what_follows_from_a_fault_is_not_reported_as_another_one() {
    for block in [
        "[guiding]\ncap_px = -1\n",
        "[pointing]\nthreshold_arcmin = 90\n",
        "[[focuser]]\nname = \"f\"\nserver = \"a:1\"\nbest_position = -5\n",
        "[guiding]\npid_ra = { p = 0.7, d = 0.0 }\n",
        "[names]\nsesame_url = \"http://a b\"\n",
        "[pointing]\nthreshold_arcsec = 3\n",
        "[[guider]]\nname = \"g\"\nthreshold_arcsec = 3\n",
    ] {
        let faults = with(block);
        assert!(faults.len() == 1, "{block}: {faults:?}");
        assert!(!faults[0].contains("a value"), "{faults:?}");
    }
    let spoilt = GOOD.replace("  { parameter = \"Humidity\", upper = 80, reopen_upper = 75 },\n", "");
    let text = spoilt.replace("{ parameter = \"WindSpeed\", upper = 12 }", "\"WindSpeed\"");
    let (_, faults) = config::examine(&text, Path::new("/site"));
    assert!(faults.len() == 1 && faults[0].what.contains("expected keys of its own"), "{faults:?}");
}

#[test]
fn lines_that_end_in_cr_alone_are_named_as_what_they_are() {
    let (_, faults) = config::examine(&GOOD.replace('\n', "\r"), Path::new("/site"));
    assert!(faults.len() == 1 && faults[0].what.contains("lines end in CR alone"), "{faults:?}");
    assert!(!faults[0].what.contains('\r'), "{faults:?}");
}

/// A change of the good file that runs, and words of the one warning that it causes.
type Doubtful = (&'static str, &'static str, &'static [&'static str]);

const DOUBTFUL: &[Doubtful] = &[
    (
        "limit = [\n  { parameter = \"Humidity\", upper = 80, reopen_upper = 75 },\n  { parameter = \"WindSpeed\", upper = 12 },\n]\n",
        "",
        &["observingconditions \"wx\": no limit", "close nothing", "add limit = [...]"],
    ),
    (
        "[safety]",
        "[shared]\nobservingconditions = [\"mast\"]\n[safety]",
        &["shared.observingconditions", "no [[shared.limit]]", "closes nothing here"],
    ),
    (
        "permit_valid_s = 10",
        "telescopes = [\"callisto\", \"io\"]",
        &["dome \"dome\": stands over several telescopes", "say follow = \"off\""],
    ),
    (
        "[archive]\n",
        "[archive]\nfilename = { objects = \"{object_name}.fits\" }\n",
        &["archive.filename.objects", "did you mean \"object\"?"],
    ),
    (
        "telescope = \"mount\"\n",
        "telescope = \"mount\"\nnode = \"left\"\n[[camera]]\nname = \"b\"\nserver = \"10.0.0.9:1\"\nnode = \"right\"\n\
         [spool]\nlisten = \"127.0.0.1:8888\"\n",
        &["spool.listen = \"127.0.0.1:8888\"", "2 device nodes", "choose port 0"],
    ),
];

#[test]
fn what_runs_and_is_hardly_meant_is_warned_of_once_with_what_to_do() {
    for (from, to, words) in DOUBTFUL {
        assert!(GOOD.contains(from), "{from:?}");
        let (values, faults) = config::examine(&GOOD.replacen(from, to, 1), Path::new("/site"));
        assert!(values.is_some(), "{to:?}: {faults:?}");
        let warned: Vec<_> = faults.iter().filter(|fault| words.iter().all(|word| fault.what.contains(word))).collect();
        assert!(warned.len() == 1 && warned[0].severity == Severity::Warning, "{to:?}: {faults:#?}");
        let foreign = FOREIGN.iter().find(|word| warned[0].what.contains(**word));
        assert_eq!(foreign, None, "{to:?}");
    }
}

#[test]
fn without_a_telescope_a_camera_or_a_monitor_the_warning_names_what_then_does_not_happen() {
    // From the block that is left out to the next one that stays.
    let without = |blocks: &[&str]| {
        let mut text = GOOD.to_owned();
        for block in blocks {
            let from = text.find(&format!("[[{block}]]")).unwrap();
            let length = text[from + 2..].find("\n[").map_or(text.len() - from, |length| length + 3);
            text.replace_range(from..from + length, "");
        }
        text = text.replace(
            "telescope = \"mount\"\n",
            if blocks.contains(&"telescope") { "" } else { "telescope = \"mount\"\n" },
        );
        let (values, faults) = config::examine(&text, Path::new("/site"));
        assert!(values.is_some(), "{blocks:?}: {faults:?}");
        faults.into_iter().map(|fault| fault.what).collect::<Vec<String>>()
    };
    for (blocks, words) in [
        (&["camera"][..], "no camera: nothing can be exposed; add a [[camera]]"),
        (&["safetymonitor"], "the weather limits and the Sun alone decide"),
        (&["safetymonitor", "observingconditions"], "a dome stays closed"),
        (&["dome", "safetymonitor", "observingconditions"], "nothing is observed"),
        (&["dome", "telescope"], "the schedule is not run; add a [[telescope]]"),
    ] {
        let warned = without(blocks);
        assert!(warned.len() == 1 && warned[0].contains(words), "{blocks:?}: {warned:#?}");
    }
    assert_eq!(without(&["dome"]), Vec::<String>::new(), "a telescope under the open sky");
}

#[test]
fn an_enclosure_in_the_file_of_the_shared_devices_names_its_telescopes() {
    let place = &GOOD[..GOOD.find("[safety]").unwrap()];
    let shared = place.replace("telescope = \"callisto\"", "telescope = \"shared\"");
    assert_ne!(shared, place, "the good file names its telescope");
    let faults = |dome: &str| {
        let text = format!("{shared}[[dome]]\nname = \"roof\"\nserver = \"10.0.0.5:1\"\nfollow = \"off\"\n{dome}\n");
        let (_, faults) = config::examine(&text, Path::new("/site"));
        faults.into_iter().map(|fault| fault.what).collect::<Vec<_>>()
    };
    assert!(faults("").iter().any(|fault| fault.contains("lists no telescopes")), "{:?}", faults(""));
    let twice = faults("telescopes = [\"callisto\", \"callisto\"]");
    assert!(twice.iter().any(|fault| fault.contains("lists one of them twice; keep one")), "{twice:?}");
    let good = faults("telescopes = [\"callisto\", \"io\"]");
    assert!(good.is_empty(), "{good:?}");
}
