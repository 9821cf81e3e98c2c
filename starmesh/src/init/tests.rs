use std::fs;

use super::*;

fn options(folder: &Path, server: Vec<String>) -> Options {
    let [site, telescope] = ["hill", "one"].map(|name| name.parse().unwrap());
    Options { folder: folder.join("new"), force: false, site, telescope, server, seconds: 0.1 }
}

#[tokio::test]
async fn the_first_files_are_made_of_the_devices_that_answer_and_are_valid() {
    let simulator = simulator::Simulator::start(simulator::Options::default()).await.unwrap();
    let home = tempfile::tempdir().unwrap();
    run(options(home.path(), vec![simulator.address().to_string()])).await.unwrap();
    let folder = home.path().join("new");
    let text = fs::read_to_string(folder.join(CONFIG)).unwrap();
    let config = config::parse(&text, &folder).unwrap();
    assert_eq!(config.devices().len(), 10, "{text}");
    assert!(config.clock.simulator.is_some() && !config.schedule.robotic, "{text}");
    assert!((config.place.latitude_deg - simulator::Options::default().latitude.degrees()).abs() < 1e-6);
    assert!(fs::read_to_string(folder.join(HEADER)).unwrap().parse::<config::header::HeaderTable>().is_ok());
    let schedule = fs::read_to_string(folder.join(SCHEDULE)).unwrap();
    let cameras = [config.camera[0].common.name.clone()];
    let rows = schedule::parse(&schedule, &cameras).unwrap();
    let status: Vec<&str> = rows.iter().map(|row| row.action.name()).collect();
    assert_eq!(status, ["open", "object", "object", "close", "calibration", "complete_headers"], "{schedule}");
    assert_eq!(config.bus.listen, [config::endpoints::THIS_HOST], "{text}");
    assert_eq!(config.alerts.send_when_observatory_silent_s, 20.0, "{text}");
    let again = run(options(home.path(), Vec::new())).await.unwrap_err().to_string();
    assert!(again.contains("stays as it is") && again.contains("--force"), "{again}");
    assert_eq!(fs::read_to_string(folder.join(CONFIG)).unwrap(), text);
    simulator.stop().await;
}

#[tokio::test]
async fn the_command_that_is_recommended_where_no_device_answers_makes_the_files_anew_and_keeps_the_old_ones() {
    use clap::Parser as _;
    #[derive(clap::Parser)]
    struct Command {
        #[command(flatten)]
        init: Options,
    }
    let simulator = simulator::Simulator::start(simulator::Options::default()).await.unwrap();
    let home = tempfile::tempdir().unwrap();
    let first = options(home.path(), Vec::new());
    let folder = first.folder.clone();
    fs::create_dir(&folder).unwrap();
    for name in [CONFIG, HEADER, SCHEDULE, "schedule.jsonl.1"] {
        fs::write(folder.join(name), format!("old {name}")).unwrap();
    }
    let command = command_for_server(&first).replace("HOST:PORT", &simulator.address().to_string());
    let words = command.strip_prefix("starmesh ").unwrap().split_whitespace();
    let again = Command::try_parse_from(words.chain(["--seconds", "0.1"])).unwrap().init;
    run(again).await.unwrap();
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    let config = config::parse(&read(CONFIG), &folder).unwrap();
    assert_eq!((config.address().to_string().as_str(), config.devices().len()), ("hill/one", 10));
    assert_eq!([read("observatory.toml.1"), read("schedule.jsonl.2")], ["old observatory.toml", "old schedule.jsonl"]);
    assert_eq!(read("schedule.jsonl.1"), "old schedule.jsonl.1");
    simulator.stop().await;
}

#[tokio::test]
async fn the_files_are_made_of_the_servers_that_are_named_alone_and_of_one_that_is_named_twice_once() {
    let simulator = simulator::Simulator::start(simulator::Options::default()).await.unwrap();
    let named = simulator.address().to_string();
    let others = async { Err(std::io::Error::other("nobody asked for others")) };
    assert_eq!(devices(&[named.clone(), named.clone()], others).await.unwrap().len(), 10);
    let mount = |server: &str, unique_id: &str| Found {
        server: server.to_owned(),
        kind: contract::Kind::Telescope,
        number: 0,
        name: "mount".to_owned(),
        unique_id: unique_id.to_owned(),
    };
    let answered = [mount("a:1", "u"), mount("b:1", "u"), mount("a:1", ""), mount("c:1", "")];
    let found = devices(&[], async { Ok(answered.to_vec()) }).await.unwrap();
    assert_eq!(found, [mount("a:1", "u"), mount("c:1", "")], "one device answers at two addresses");
    simulator.stop().await;
}

/// A mount that says where it stands.
async fn mount_at(latitude_deg: f64) -> Found {
    let answer = move |axum::extract::Path(property): axum::extract::Path<String>| async move {
        let value = match property.as_str() {
            "sitelatitude" => latitude_deg,
            "sitelongitude" => -70.5,
            _ => 2500.0,
        };
        axum::Json(serde_json::json!({ "Value": value, "ErrorNumber": 0, "ErrorMessage": "" }))
    };
    let routes = axum::Router::new().route("/api/v1/telescope/0/{property}", axum::routing::get(answer));
    let server = test_support::serve(routes).await.to_string();
    let (kind, name) = (contract::Kind::Telescope, "mount".to_owned());
    Found { server, kind, number: 0, name, unique_id: String::new() }
}

#[tokio::test]
async fn of_several_mounts_it_is_said_whose_place_is_taken_and_which_are_not() {
    let found = [mount_at(-24.5).await, mount_at(-24.5).await, mount_at(28.25).await];
    let around = place::ask(&found).await;
    assert_eq!(around.place.unwrap().latitude_deg, -24.5);
    let [taken, other] = &around.told[..] else { panic!("{:?}", around.told) };
    let (first, third) = (&found[0].server, &found[2].server);
    assert!(taken.starts_with("place: -24.5 deg north, -70.5 deg east, 2500 m") && taken.contains(first), "{taken}");
    assert!(other.starts_with("another place, which is not taken: 28.25") && other.contains(third), "{other}");
    let text = text::text(&options(Path::new("x"), Vec::new()), &found[..1], &around, &Before::default());
    assert!(text.contains(&format!("# {taken}\n# {other}\nlatitude_deg = -24.5\n")), "{text}");
}

#[tokio::test]
async fn the_names_of_an_earlier_file_are_kept_and_what_is_not_is_said_with_its_path() {
    let simulator = simulator::Simulator::start(simulator::Options::default()).await.unwrap();
    let home = tempfile::tempdir().unwrap();
    let server = vec![simulator.address().to_string()];
    let first = options(home.path(), server.clone());
    let folder = first.folder.clone();
    run(first).await.unwrap();
    let path = folder.join(CONFIG);
    let made = config::parse(&fs::read_to_string(&path).unwrap(), &folder).unwrap();
    let camera = made.camera[0].common.name.to_string();
    let edited = fs::read_to_string(&path).unwrap().replace(&format!("name = \"{camera}\""), "name = \"Old-Faithful\"");
    let another = test_support::block("switch", "by-hand", "10.0.0.9:11111", "number = 7");
    fs::write(&path, format!("{edited}\n{another}")).unwrap();
    let before = Before::read(&path);
    let again = Options { force: true, telescope: "two".parse().unwrap(), ..options(home.path(), server) };
    run(again).await.unwrap();
    let made = config::parse(&fs::read_to_string(&path).unwrap(), &folder).unwrap();
    assert_eq!(made.camera[0].common.name.as_str(), "Old-Faithful");
    let lost = before.lost(&made, &folder.join("observatory.toml.1"));
    let [renamed, gone, all] = &lost[..] else { panic!("{lost:?}") };
    assert!(renamed.contains("the telescope is hill/two now, and was hill/one"), "{renamed}");
    assert!(gone.contains("switch \"by-hand\" (10.0.0.9:11111 number 7) is not in use"), "{gone}");
    assert!(all.contains("observatory.toml.1 are not taken over"), "{all}");
    fs::write(&path, "old").unwrap();
    let unread = Before::read(&path).lost(&made, &folder.join("observatory.toml.2"));
    assert!(unread[0].contains("observatory.toml.2 cannot be read") && unread.len() == 1, "{unread:?}");
    simulator.stop().await;
}

#[tokio::test]
async fn a_telescope_is_not_called_as_the_shared_devices_are() {
    let home = tempfile::tempdir().unwrap();
    let shared = Options { telescope: "shared".parse().unwrap(), ..options(home.path(), Vec::new()) };
    assert!(run(shared).await.unwrap_err().to_string().contains("share"));
}

#[test]
fn without_any_device_there_are_examples_behind_a_hash_and_the_place_is_to_be_filled_in() {
    let options = options(Path::new("x"), Vec::new());
    let around = Surroundings::default();
    let text = text::text(&options, &[], &around, &Before::default());
    assert!(text.contains("# [[dome]]") && text.contains("# latitude_deg = ?"), "{text}");
    let config = text::prove(&text, None, Path::new("x")).unwrap();
    assert!(config.devices().is_empty());
    let schedule = night::schedule(&config, &around).unwrap();
    assert!(schedule.lines().all(|line| line.starts_with("//")), "{schedule}");
    // Without the # before each key the file is a telescope with all its devices.
    let whole: Vec<&str> =
        text.lines().map(|line| line.strip_prefix("# ").filter(|rest| is_toml(rest)).unwrap_or(line)).collect();
    let whole = whole.join("\n").replace("= ?", "= 1");
    let config = config::parse(&whole, Path::new("x")).unwrap_or_else(|error| panic!("{error}\n{whole}"));
    assert_eq!(config.devices().len(), 10);
}

#[test]
fn in_the_dark_the_example_begins_at_once_and_near_dawn_with_the_next_night() {
    let config = text::prove(
        &text::text(&options(Path::new("x"), Vec::new()), &[], &Surroundings::default(), &Before::default()),
        None,
        Path::new("x"),
    )
    .unwrap();
    let start_after_h = |now: &str| -> (f64, f64) {
        let now: units::Utc = now.parse().unwrap();
        let place =
            Some(crate::import::site::Location { latitude_deg: -24.6, longitude_deg: -70.4, elevation_m: 2500.0 });
        let around = Surroundings { place, simulated: Some(now), told: Vec::new() };
        let schedule = night::schedule(&config, &around).unwrap();
        let row: serde_json::Value =
            serde_json::from_str(schedule.lines().find(|line| line.contains("\"object\"")).unwrap()).unwrap();
        let time = |key: &str| row[key].as_str().unwrap().parse::<units::Utc>().unwrap();
        let [start, end] = ["start_time", "end_time"].map(time);
        (start.seconds_since(now) / 3600.0, end.seconds_since(start) / 3600.0)
    };
    for (now, hours) in
        [("2026-11-23T20:00:00Z", 3.0..6.0), ("2026-11-24T02:00:00Z", 0.1..0.2), ("2026-11-24T08:30:00Z", 14.0..18.0)]
    {
        let (after_h, length_h) = start_after_h(now);
        assert!(hours.contains(&after_h), "{now}: {after_h} h");
        // 25 min of a guide that reads at 12 times the speed of the sky.
        assert!((2.5..=8.0).contains(&length_h), "{now}: {length_h} h");
    }
    let (_, of_the_guide_h) = start_after_h("2026-11-22T00:14:00Z");
    assert!(of_the_guide_h >= 5.0, "{of_the_guide_h} h");
}

fn is_toml(line: &str) -> bool {
    line.starts_with("[[")
        || line.starts_with(']')
        || line.starts_with("    {")
        || line.contains(" = ") && !line.contains("only\"")
}
