//! A focus run is kept with all its points, once, and drawn, also by an archive that was away when it ended.

use bus::Clock;
use contract::observatory::FocusRun;
use contract::{Address, CommandId, Key, Role};
use node::Node;
use test_support::{PARANAL, RunningNode, block, join, private_bus, until};

#[tokio::test(flavor = "multi_thread")]
async fn runs_are_stored_once_with_their_points_and_a_plot() {
    let folder = tempfile::tempdir().unwrap();
    let observatory = private_bus(Clock::machine_clock()).await;
    let text = PARANAL.to_owned() + &block("camera", "andor", "localhost:1", "");
    let config = config::parse(&text, folder.path()).unwrap();
    let (address, database) = (Address::new("paranal", "callisto").unwrap(), config.archive.database.clone());
    let line = observatory.publisher::<FocusRun>(&Key::FocusRun(address)).await.unwrap();
    let sample: FocusRun =
        serde_json::from_str(include_str!("../../../common/contract/golden/v1/observatory.focus_run.json")).unwrap();
    // Published before the archive runs, and published twice.
    line.put(sample.clone()).await.unwrap();
    line.put(sample.clone()).await.unwrap();

    let table: config::header::HeaderTable =
        "header,dtype,fixed,device_type,device_command,comment\nDATE,str,false,astra,,written\n".parse().unwrap();
    let node = Node::new(Role::Archive, "main".parse().unwrap(), config, table, join(&observatory).await);
    let running = RunningNode::work(node, node_archive::run);
    let second = FocusRun { id: CommandId("second".to_owned()), filter: None, ..sample.clone() };
    line.put(second).await.unwrap();

    let plots = folder.path().join("images/autofocus/20261120");
    // A plot that is being written has another ending, and the first one is written twice.
    let is_plot = |file: &std::fs::DirEntry| file.path().extension().is_some_and(|ending| ending == "svg");
    until("two plots", || std::fs::read_dir(&plots).is_ok_and(|files| files.flatten().filter(is_plot).count() == 2))
        .await;
    running.stop().await;
    let svg = std::fs::read_to_string(plots.join("andor_focuser_V_20261121_030800.svg")).unwrap();
    assert!(svg.contains("callisto andor, V") && svg.ends_with("</svg>\n"), "{svg}");
    let database = rusqlite::Connection::open(database).unwrap();
    let runs: i64 = database.query_row("SELECT count(*) FROM focus_runs", [], |row| row.get(0)).unwrap();
    let points: i64 = database.query_row("SELECT count(*) FROM focus_points", [], |row| row.get(0)).unwrap();
    assert_eq!((runs, points), (2, 2 * sample.points.len() as i64));
    let query = "SELECT outcome, best_position, operator, temperature_c, run FROM focus_runs WHERE run_id = ?";
    let row: (String, f64, String, f64, String) = database
        .query_row(query, [&sample.id.0], |r| Ok((r.get(0)?, r.get(1)?, r.get(2)?, r.get(3)?, r.get(4)?)))
        .unwrap();
    assert_eq!((row.0.as_str(), row.1, row.2.as_str(), row.3), ("failed", 23150.4, "tenengrad", 11.2));
    assert_eq!(serde_json::from_str::<FocusRun>(&row.4).unwrap(), sample);
    let query = "SELECT position, pass, value, reason FROM focus_points WHERE run_id = ? AND number = 1";
    let row: (i64, String, Option<f64>, String) =
        database.query_row(query, [&sample.id.0], |r| Ok((r.get(0)?, r.get(1)?, r.get(2)?, r.get(3)?))).unwrap();
    assert_eq!((row.0, row.1.as_str(), row.2), (22800, "coarse", None));
}
