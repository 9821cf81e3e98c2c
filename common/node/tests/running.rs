//! A node as others see it: on a bus of its own, by its files, and as a process whose lines nobody takes.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends by panicking")]

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use bus::{Bus, Catch, Clock};
use clap::Parser as _;
use contract::node::NodeState;
use contract::observatory::{AlertKind, Alerts};
use contract::{NodeTopic, Role, Scalar};
use node::{Node, NodeAlerts, NodeOptions, host_name, lines};

/// No step takes longer, also on a busy machine.
const LIMIT: Duration = Duration::from_secs(60);

async fn open(connect: Vec<String>) -> Bus {
    let config = config::Bus { listen: vec!["tcp/127.0.0.1:0".to_owned()], connect, multicast: false };
    Bus::open(&config, Clock::machine_clock()).await.unwrap()
}

/// Waits on a real clock, because the bus has threads of its own.
async fn soon<T>(work: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, work).await.unwrap()
}

/// The cause of the alert of this id, as published on the bus.
async fn cause(alerts: &bus::Subscriber<Alerts>, id: &str) -> String {
    let published = async {
        loop {
            let alerts = alerts.recv().await.sample.body.alerts;
            if let Some(alert) = alerts.into_iter().find(|alert| alert.id == id) {
                return alert.cause;
            }
        }
    };
    soon(published).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_publishes_its_figures_a_full_disk_and_a_twin_elsewhere_and_ends_only_when_it_is_asked_to() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[observatory]\nsite = \"site\"\ntelescope = \"alpha\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\n\
                elevation_m = 0.0\n[safety]\ndisk_free_min_gb = 1000000.0\n";
    let config = config::parse(text, folder.path()).unwrap();
    let data = config.folders.data.display().to_string();
    let own = open(Vec::new()).await;
    let node = Node::new(Role::Archive, "main".parse().unwrap(), config, Default::default(), own.clone());
    let other = open(own.locators().await).await;
    let states = other.subscribe::<NodeState>(node.key(NodeTopic::State), Catch::Newest, 100).await.unwrap();
    let alerts = other.subscribe::<Alerts>(node.key(NodeTopic::Alerts), Catch::Newest, 100).await.unwrap();
    let (living, stop) = (node.clone(), node.stop.clone());
    let task = tokio::spawn(living.live(None, async move {
        stop.wait().await;
        Ok(())
    }));

    node.clone().figure("queue_count", Scalar::Int(3));
    let published = async {
        loop {
            let state = states.recv().await.sample.body;
            if state.figures.contains_key("queue_count") && state.figures.contains_key("images_free_gb") {
                return state;
            }
        }
    };
    let state = soon(published).await;
    assert_eq!((state.role, state.host.clone(), state.pid), (Role::Archive, host_name(), std::process::id()));
    assert_eq!(state.figures["queue_count"], Scalar::Int(3));
    assert!(state.figures["data_free_gb"].number().is_some_and(|gb| gb > 0.0), "{state:?}");
    let full = cause(&alerts, "disk/data").await;
    assert!(full.starts_with(&data) && full.ends_with("GB left, needed are 1000000 GB"), "{full}");

    // Anybody may publish such a state; the second one names an innocent process of this host.
    let twins = other.publisher(&node.key(NodeTopic::State)).await.unwrap();
    for (host, pid) in [("elsewhere", 7), (&*host_name(), 1)] {
        twins.put(NodeState { host: host.to_owned(), pid, ..state.clone() }).await.unwrap();
        let wanted = format!("another archive node with id \"main\" runs on host \"{host}\"");
        while cause(&alerts, &AlertKind::Twin.id("")).await != wanted {}
    }
    assert!(!task.is_finished());
    node.stop.stop();
    soon(task).await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_is_asked_to_end_publishes_that_it_was_stopped_and_one_that_fails_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[observatory]\nsite = \"site\"\ntelescope = \"alpha\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\n\
                elevation_m = 0.0\n";
    for (closed, fails, wanted) in [
        (None, false, Some(None)),
        (Some(true), false, Some(Some(true))),
        (Some(false), true, Some(Some(false))),
        (None, true, None),
    ] {
        let config = config::parse(text, folder.path()).unwrap();
        let own = open(Vec::new()).await;
        let node = Node::new(Role::Device, "main".parse().unwrap(), config, Default::default(), own.clone());
        let other = open(own.locators().await).await;
        let states = other.subscribe::<NodeState>(node.key(NodeTopic::State), Catch::All, 100).await.unwrap();
        let (living, stop) = (node.clone(), node.stop.clone());
        let task = tokio::spawn(living.live(None, async move {
            stop.wait().await;
            anyhow::ensure!(!fails, "the dome is open");
            Ok(())
        }));
        assert_eq!(soon(states.recv()).await.sample.body.stopped, None, "it runs");
        if let Some(closed) = closed {
            node.ends_closed(closed);
        }
        node.ending.stop();
        node.stop.stop();
        if wanted.is_some() {
            let last = loop {
                if let Some(stopped) = soon(states.recv()).await.sample.body.stopped {
                    break stopped;
                }
            };
            assert_eq!(Some(last.closed), wanted);
            assert_eq!(last.by, format!("a signal on {}", host_name()));
        }
        assert_eq!(soon(task).await.unwrap().is_err(), fails);
    }
}

#[test]
fn an_alert_shows_no_control_characters_and_wakes_nobody_when_nothing_changed() {
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let mut published = alerts.watch();
    alerts.raise(AlertKind::Twin, "a", "answered\n\u{1b}[2J");
    assert!(published.has_changed().unwrap());
    let cause = published.borrow_and_update().alerts[0].cause.clone();
    assert!(cause.starts_with("answered") && !cause.contains(char::is_control), "{cause:?}");
    alerts.raise(AlertKind::Twin, "a", "answered\n\u{1b}[2J");
    assert!(!published.has_changed().unwrap());
    alerts.clear(AlertKind::Twin, "b");
    assert!(!published.has_changed().unwrap(), "there was no such alert");
    alerts.raise(AlertKind::Twin, "a", "another cause");
    assert_eq!(published.borrow_and_update().alerts[0].cause, "another cause");
}

#[test]
fn a_command_line_names_a_file_and_at_most_one_node_and_each_endpoint_counts() {
    let parse = |words: &str| NodeOptions::try_parse_from(format!("node {words}").split_whitespace());
    let options = parse("--config a.toml --id dome --listen tcp/1 --listen tcp/2 --connect tcp/3").unwrap();
    assert_eq!((options.listen.len(), options.connect.len(), options.id.unwrap().as_str()), (2, 1, "dome"));
    assert!(!(options.check || options.guarded || options.no_multicast || options.with_parent));
    for (words, wanted) in [
        ("", "--config <FILE>"),
        ("--config", "--config <FILE>"),
        ("--config a.toml --id dome/1", "--id"),
        ("--config a.toml --id a --id b", "--id"),
        ("--config a.toml surplus", "surplus"),
    ] {
        let error = parse(words).unwrap_err().to_string();
        assert!(error.contains(wanted), "{words}: {error}");
    }
    assert!(!parse("--help").unwrap_err().to_string().contains("--guarded"), "only a guard process sets it");
}

/// Lines that the process below writes: more than wait for a reader.
const LINES: usize = 20_000;

#[test]
#[ignore = "the next test starts it as a process"]
fn a_process_that_writes_more_lines_than_are_taken() {
    for number in 0..LINES {
        lines::complain(format_args!("line {number}"));
    }
    // Nothing has waited until here.
    fs::write(std::env::var_os("WRITTEN").unwrap(), "").unwrap();
    let _ = std::io::stdin().read_line(&mut String::new());
}

#[test]
fn a_process_whose_lines_nobody_takes_goes_on_and_each_line_that_was_left_out_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let written = folder.path().join("written");
    let mut process = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "a_process_that_writes_more_lines_than_are_taken"])
        .env("WRITTEN", &written)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let began = Instant::now();
    while !written.exists() {
        assert!(began.elapsed() < LIMIT, "it waits for somebody to take its lines");
        std::thread::sleep(Duration::from_millis(10));
    }
    let (lines, taken) = channel();
    let reader = BufReader::new(process.stderr.take().unwrap());
    std::thread::spawn(move || reader.lines().map_while(Result::ok).try_for_each(|line| lines.send(line)));
    let (mut received, mut left_out) = (0, 0);
    while received + left_out < LINES {
        let line = taken.recv_timeout(LIMIT).unwrap_or_else(|_| panic!("{received} and {left_out} of {LINES}"));
        match line.split_once(" lines were left out here") {
            Some((number, _)) => left_out += number.parse::<usize>().unwrap(),
            None => {
                assert!(line.starts_with("line "), "{line}");
                received += 1;
            }
        }
    }
    assert!(left_out > 0 && received + left_out == LINES, "{received} and {left_out}");
    drop(process.stdin.take());
    assert!(process.wait().unwrap().success());
}

#[cfg(unix)]
#[test]
fn images_are_for_others_as_the_system_lets_them_and_all_else_is_for_its_user() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mode = |name: &str| fs::metadata(at(name)).unwrap().permissions().mode() & 0o777;
    fs::write(at("as usual"), "").unwrap();
    fs::create_dir(at("usual folder")).unwrap();
    let usual = [mode("as usual"), mode("usual folder")];

    node::private::keep_files_private();
    fs::write(at("file"), "").unwrap();
    fs::create_dir(at("folder")).unwrap();
    assert_eq!([mode("file"), mode("folder")], [0o600, 0o700]);
    node::private::make_public_file(&at("file")).unwrap();
    node::private::make_public_folder(&at("images")).unwrap();
    assert_eq!([mode("file"), mode("images")], usual);
    node::private::make_public_folder(&at("folder")).unwrap();
    assert_eq!(mode("folder"), 0o700, "one that is there keeps its permissions");
    assert!(node::private::make_public_folder(&at("absent/images")).is_err());
}
