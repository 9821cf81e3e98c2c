//! `starmesh check` of a schedule: every finding with its place, a caret under it, and the exit code.

use std::collections::BTreeMap;
use std::fs;

use bus::Clock;
use contract::device::DeviceDescription;
use contract::device::filter_wheel::Capabilities;
use contract::{Address, Key, Kind};

use crate::command::starmesh;

const SITE: &str = concat!(
    include_str!("../../../common/config/tests/paranal.toml"),
    r#"[[telescope]]
name = "mount"
server = "10.0.0.5:11111"
horizon = "wall.txt"
[[camera]]
name = "main"
server = "10.0.0.5:11111"
[[filterwheel]]
name = "wheel"
server = "10.0.0.5:11111"
"#
);

fn row(value: &str, end: &str) -> String {
    format!(
        "{{\"device_name\": \"main\", \"action_type\": \"object\", \"action_value\": {value}, \
         \"start_time\": \"2026-11-21 03:00:00\", \"end_time\": \"2026-11-21 {end}\"}}\n"
    )
}

#[test]
fn findings_are_printed_with_their_places_and_only_errors_fail() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    fs::write(file("observatory.toml"), SITE).unwrap();
    fs::write(file("wall.txt"), "# the wall of the next dome\n0 10\n180 10\n270 40\n").unwrap();
    let check = |name: &str| starmesh(["check", file(name).as_str(), "--at", "2026-11-20T12:00:00Z"]);

    fs::write(file("night.jsonl"), format!("// night\n{}", row(r#"{"object": "x", "exptime": -1, "twirl": 2}"#, "x")))
        .unwrap();
    let output = check("night.jsonl");
    assert!(!output.success && output.err.contains("3 errors"), "{}\n{}", output.out, output.err);
    for message in [
        ":2:93: error: exptime: expected",
        ":2:97: error: twirl",
        ":2:159: error: end_time: \"2026-11-21 x\" is no time",
    ] {
        assert!(output.out.contains(message), "{message}: {}", output.out);
    }
    let lines: Vec<&str> = output.out.lines().collect();
    let caret = lines.iter().position(|line| line.trim() == "^").unwrap();
    assert!(lines[caret - 1][lines[caret].len() - 1..].starts_with("-1"), "{}", output.out);

    fs::write(
        file("night.jsonl"),
        row(r#"{"object": "x", "exptime": 60, "ra": 50, "dec": -30, "filter": "V"}"#, "09:00:00"),
    )
    .unwrap();
    let output = check("night.jsonl");
    assert!(output.success, "{}\n{}", output.out, output.err);
    assert!(
        output.out.contains("warning: end_time: x stands behind the horizon of the site from 2026-11-21T0"),
        "{}",
        output.out
    );
    assert!(output.out.contains("not checked: filters of wheel"), "{}", output.out);
    assert!(output.out.contains("valid (1 rows, 1 warnings)"), "{}", output.out);

    fs::rename(file("night.jsonl"), file("schedule.jsonl")).unwrap();
    let output = check("observatory.toml");
    assert!(
        output.success && output.out.contains("schedule.jsonl: valid (1 rows, 1 warnings)"),
        "{}\n{}",
        output.out,
        output.err
    );

    fs::write(file("wall.txt"), "0 ten\n").unwrap();
    let output = check("observatory.toml");
    assert!(
        !output.success && output.out.contains("telescope \"mount\": horizon") && output.out.contains("line 1"),
        "{}{}",
        output.out,
        output.err
    );
}

#[test]
fn the_rows_of_a_schedule_are_read_also_where_the_configuration_is_not_valid() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    let wrong = SITE.replace("horizon = \"wall.txt\"", "horizon = 5");
    fs::write(file("observatory.toml"), wrong).unwrap();
    let night = row(r#"{"object": "x", "exptime": -1, "n": 5,}"#, "05:00:00").replace("main", "unknown");
    fs::write(file("schedule.jsonl"), night).unwrap();
    for name in ["observatory.toml", "schedule.jsonl"] {
        let output = starmesh(["check", file(name).as_str()]);
        let all = format!("{}{}", output.out, output.err);
        assert!(!output.success && all.contains("horizon") && all.contains("is not a valid configuration"), "{all}");
        let told = ["leave out the comma before it", "error: exptime: expected", "not checked: devices and sky"];
        assert!(told.iter().all(|words| output.out.contains(words)), "{name}: {all}");
        assert!(!all.contains("no camera is named"), "its name may be what is wrong: {all}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_filter_is_looked_for_in_the_wheel_itself_where_the_bus_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    fs::write(file("observatory.toml"), SITE.replace("horizon = \"wall.txt\"\n", "")).unwrap();
    let with_filter = r#"{"object": "x", "exptime": 60, "ra": 50, "dec": -30, "filter": "V"}"#;
    fs::write(file("night.jsonl"), row(with_filter, "05:00:00")).unwrap();
    let bus = test_support::private_bus(Clock::machine_clock()).await;
    let connect = bus.locators().await.first().unwrap().clone();
    let wheel = Address::new("paranal", "callisto").unwrap().device(Kind::FilterWheel, &"wheel".parse().unwrap());
    let publisher = bus.publisher::<DeviceDescription<Capabilities>>(&Key::Capabilities(wheel)).await.unwrap();
    let description = DeviceDescription {
        server: "10.0.0.5:11111".to_owned(),
        number: 0,
        device_name: "wheel".to_owned(),
        driver: "1".to_owned(),
        interface_version: 3,
        simulated: false,
        can: Capabilities { names: vec!["B".to_owned(), "R".to_owned()], focus_offsets: vec![0, 0] },
        unread: BTreeMap::new(),
    };
    publisher.put(description).await.unwrap();
    let check = async |more: &[&str]| {
        let mut arguments = vec!["check".to_owned(), file("night.jsonl")];
        arguments.extend(more.iter().map(|word| (*word).to_owned()));
        tokio::task::spawn_blocking(move || starmesh(arguments)).await.unwrap()
    };
    let alone = check(&[]).await;
    assert!(alone.success && alone.out.contains("not checked: filters of wheel"), "{}{}", alone.out, alone.err);
    let asked = check(&["--no-multicast", "--connect", connect.as_str()]).await;
    let all = format!("{}{}", asked.out, asked.err);
    assert!(!asked.success && all.contains("filter: wheel has no filter \"V\"; "), "{all}");
    assert!(!all.contains("not checked"), "{all}");
}
