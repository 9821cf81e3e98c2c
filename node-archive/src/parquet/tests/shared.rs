//! Two telescopes with one database: each has its own nights.

use contract::archive::{ArchiveAnswer, ArchiveQuestion, Ask};
use contract::frame_search::FrameSearch;

use super::*;
use crate::database::stamp;
use crate::reader::Reader;

/// The number of the first night of the other telescope: no frame of it has the id of one of ours.
const OTHER: u64 = 100;

/// Adds five nights of another telescope: its frames, and what its nodes published.
async fn add_io(config: &config::Observatory) {
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (database, writer) = Database::open(&config.archive.database, "io", alerts).unwrap();
    let boot = BootId::fresh();
    for number in 0..5 {
        let writes = night(i64::try_from(number).unwrap() * DAY_S + 40_000, OTHER + number, &boot);
        // The others say themselves whose they are.
        let named = |write: &Write| {
            matches!(write, Write::Reading { .. } | Write::Log { .. } | Write::Correction(_) | Write::Audit(_))
        };
        database.commit(writes.into_iter().filter(|write| !named(write)).collect()).await.unwrap();
    }
    drop(database);
    writer.end().await;
}

fn of_io(config: &config::Observatory) -> config::Observatory {
    let mut config = config.clone();
    config.place.telescope = "io".parse().unwrap();
    config
}

#[tokio::test(flavor = "multi_thread")]
async fn the_nights_of_a_telescope_are_the_same_whether_another_one_shares_its_database_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    database(&config).await;
    let alone = write_all(&config, &files);
    add_io(&config).await;
    let shared = write_all(&config, &files);
    assert!(shared.iter().all(|part| part.outcome == Outcome::Unchanged), "{shared:#?}");
    assert_eq!(alone.len(), shared.len());
    let io = of_io(&config);
    let rows = |table: &str| -> usize {
        write_all(&io, &files).iter().filter(|part| part.table == table).map(|part| part.rows).sum()
    };
    // Facts of two frames; of the values only those of the site's devices.
    for (table, expected) in
        [("images", 5), ("facts", 10), ("focus_runs", 5), ("states", 5), ("guiding", 0), ("telemetry", 50)]
    {
        assert_eq!(rows(table), expected, "{table}");
    }
    let made = folder.path().join("made.db");
    refill(&io, &files, &made).await.unwrap();
    let all: Vec<String> = everything(&made).into_iter().flat_map(|(_, rows)| rows).collect();
    assert!(all.iter().all(|row| !row.contains("callisto") && !row.contains("frame-1\"")), "{all:#?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_question_about_a_night_is_answered_for_one_telescope() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    database(&config).await;
    add_io(&config).await;
    // The disk is there, and the files have left.
    fs::create_dir_all(config.folders.images.join(crate::folder::PART_FOLDER)).unwrap();
    let of_night = Night::at(at(40_000), &config.place);
    let alerts = golden::<Alerts>("alerts").alerts.iter().filter(|alert| alert.returned_utc.is_none()).count();
    for (config, first) in [(config.clone(), 0), (of_io(&config), OTHER)] {
        let telescope = config.place.telescope.as_str();
        let reader = Reader::open(&config.archive.database, telescope).unwrap();
        let (from, to, now) = (of_night.from, of_night.to, at(10 * DAY_S));
        let ids = |ids: Vec<CommandId>| ids.into_iter().map(|id| id.0).collect::<Vec<_>>();
        let own = vec![format!("frame-{first}")];
        let frames = reader.frames(from, to).unwrap().into_iter().map(|frame| frame.image.frame.id).collect();
        assert_eq!(ids(frames), own, "{telescope}");
        assert_eq!(reader.count_frames(from, to).unwrap(), 1);
        assert_eq!(reader.image_counts().unwrap().0, 5);
        assert_eq!(reader.newest_images(100).unwrap().len(), 5);
        let incomplete = reader.incomplete(100).unwrap().len();
        assert_eq!(incomplete, if first == 0 { 4 } else { 5 });
        let found = reader.search(&FrameSearch::default(), (Some(from), Some(to)), 10).unwrap().frames;
        assert_eq!(ids(found.into_iter().map(|frame| frame.id).collect()), own);
        let question = ArchiveQuestion { ask: Ask::Frames, from_utc: None, to_utc: None, limit: None };
        let answer: ArchiveAnswer = reader.answer(&question, now).unwrap();
        assert_eq!(answer.rows.len(), 5);
        let events = reader.night_events(&of_night, now).unwrap();
        assert_eq!((events.frames.len(), events.focus.len(), events.alerts.len()), (1, 1, alerts));
        // Its state is one of a test, which no report can read: it is named, once, and everything else is there.
        let unreadable: Vec<&str> = events.unreadable.iter().map(|what| what.split(": ").next().unwrap()).collect();
        assert_eq!(unreadable, [format!("the state `night` of {}", stamp(at(40_110)))]);
        let export = folder.path().join(telescope);
        let exported = crate::export::export(&config, &config.archive.database, &of_night, &export, now).unwrap();
        assert_eq!((exported.frames + exported.gone.len(), exported.rows[3].1), (1, 1), "{exported:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_telescope_without_alerts_clears_none_of_another_one_and_states_of_two_do_not_alternate() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    database(&config).await;
    let connection = open(&config.archive.database).unwrap();
    let count = |sql: &str| connection.query_row(sql, [], |row| row.get::<_, i64>(0)).unwrap();
    let active = "SELECT count(*) FROM alerts WHERE cleared IS NULL";
    let (alerts_of_callisto, states_of_before) = (count(active), count("SELECT count(*) FROM states"));
    let alerts = || NodeAlerts::new(Clock::machine_clock());
    let both =
        ["callisto", "io"].map(|telescope| Database::open(&config.archive.database, telescope, alerts()).unwrap());
    let (boots, second) = ([BootId::fresh(), BootId::fresh()], 10 * DAY_S);
    for seq in 0..20 {
        for ((database, _), boot) in both.iter().zip(&boots) {
            let (at, origin) = (at(second + i64::try_from(seq).unwrap()), (boot.clone(), seq));
            let (same, state) = (boot.to_string(), "{}".to_owned());
            let state = StoredState { part: "safety", same, state, at, gap_s: 15.0, origin };
            database.commit(vec![Write::State(Box::new(state))]).await.unwrap();
        }
    }
    let none = StoredAlerts { alerts: vec![], at: at(second), origin: (boots[1].clone(), 99) };
    both[1].0.commit(vec![Write::Alerts(Box::new(none))]).await.unwrap();
    for (database, writer) in both {
        drop(database);
        writer.end().await;
    }
    assert_eq!(count("SELECT count(*) FROM states") - states_of_before, 2);
    assert!(alerts_of_callisto > 0);
    assert_eq!(count(active), alerts_of_callisto);
}

/// The records of two databases that follow each other: the second one began anew when the first one was lost.
#[tokio::test(flavor = "multi_thread")]
async fn the_audit_of_two_databases_comes_back_in_the_order_of_its_chains() {
    let folder = tempfile::tempdir().unwrap();
    let (mut config, files) = (config(folder.path()), folder.path().join("network"));
    let nodes = ["device/callisto/main", "observatory/callisto/main"];
    for (part, numbers) in [("a.db", 0..40), ("b.db", 30..80)] {
        config.archive.database = folder.path().join(part);
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
        for number in numbers {
            // Three a night, of the last one of each the clock is an hour behind.
            let second = number / 3 * DAY_S + 100 * (number % 3) - if number % 3 == 2 { 3600 } else { 0 };
            database.commit(nodes.map(|node| record(node, number, Some(40_000 + second))).to_vec()).await.unwrap();
        }
        drop(database);
        writer.end().await;
        write_all(&config, &files);
    }
    let made = folder.path().join("made.db");
    refill(&config, &files, &made).await.unwrap();
    let connection = open(&made).unwrap();
    for node in nodes {
        let mut statement = connection.prepare("SELECT number FROM audit WHERE node = ? ORDER BY rowid").unwrap();
        let numbers: Vec<i64> = statement.query_map([node], |row| row.get(0)).unwrap().map(Result::unwrap).collect();
        assert_eq!(numbers, (0..80).collect::<Vec<_>>(), "{node}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_is_written_again_when_an_alert_of_it_is_cleared_weeks_later_or_a_frame_comes_late() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    database(&config).await;
    write_all(&config, &files);
    let due = |day: i64| -> Vec<String> {
        let written = partition(&config, &files).nights(&parquet_nights::NIGHTS).unwrap();
        let nights = crate::care::nights_to_write(&config, &written, at(day * DAY_S)).unwrap();
        nights.into_iter().map(|night| night.date.to_string()).collect()
    };
    assert_eq!(due(30), [""; 0]);
    let boot = BootId::fresh();
    let none = StoredAlerts { alerts: vec![], at: at(29 * DAY_S), origin: (boot.clone(), 900) };
    let frame = Frame { id: CommandId("late".to_owned()), started_utc: at(10 * DAY_S), ..golden("camera.frame") };
    let (path, file) = ("/images/late.fits".into(), "late.fits".to_owned());
    let late = StoredImage { frame, file, bytes: 5760, stored: at(29 * DAY_S) };
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
    database.commit(vec![Write::Alerts(Box::new(none)), Write::Stored(Box::new(late), path)]).await.unwrap();
    drop(database);
    writer.end().await;
    // The alerts of the other nights were cleared by those of the night after each.
    assert_eq!(due(30), ["20261125", "20261201"]);
    assert_eq!(due(60), ["20261201"], "which has no file yet");
    write_all(&config, &files);
    let made = folder.path().join("made.db");
    refill(&config, &files, &made).await.unwrap();
    let active: i64 = open(&made)
        .unwrap()
        .query_row("SELECT count(*) FROM alerts WHERE cleared IS NULL", [], |row| row.get(0))
        .unwrap();
    assert_eq!(active, 0);
}
