//! Failures around an archive: spools that send very slowly, a database that is older than the files, a disk that is
//! full.

use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::routing::get;
use bus::Catch;
use contract::Key;
use contract::archive::{Ask, Stored};
use futures_util::StreamExt as _;
use test_support::{join, serve, until};

use super::{Spool, address, archive, ask, files, recv_stored, run, two_buses};

#[tokio::test(flavor = "multi_thread")]
async fn two_spools_that_dribble_do_not_stop_a_third() {
    let folder = tempfile::tempdir().unwrap();
    let (device_bus, archive_bus) = two_buses().await;
    let spool = Spool::start(device_bus.clone()).await;
    let mut slow = Vec::new();
    for _ in 0..2 {
        // One byte a second, for ever.
        let dribble = || async {
            let bytes = futures_util::stream::repeat(()).then(|()| async {
                tokio::time::sleep(Duration::from_secs(1)).await;
                Ok::<_, std::io::Error>(Bytes::from_static(&[7]))
            });
            Body::from_stream(bytes)
        };
        slow.push(format!("http://{}/frame", serve(axum::Router::new().route("/frame", get(dribble))).await));
    }
    let running = run(archive(folder.path(), archive_bus));
    let stored = spool.bus.subscribe::<Stored>(&Key::Stored(address()).to_string(), Catch::All, 100).await.unwrap();
    for number in 0..20 {
        let mut frame = spool.frame(&format!("slow-{number}"), device_bus.clock().utc());
        frame.url = slow[number % 2].clone();
        spool.frames.put(frame).await.unwrap();
    }
    tokio::time::sleep(Duration::from_millis(500)).await;
    spool.frames.put(spool.frame("frame-1", device_bus.clock().utc())).await.unwrap();
    assert_eq!(recv_stored(&stored, false).await.frame.0, "frame-1");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_archive_that_starts_while_its_disk_is_away_writes_nothing_into_the_place_of_the_disk() {
    let folder = tempfile::tempdir().unwrap();
    let (images, away) = (folder.path().join("images"), folder.path().join("away"));
    let (device_bus, archive_bus) = two_buses().await;
    let spool = Spool::start(device_bus.clone()).await;
    let stored = spool.bus.subscribe::<Stored>(&Key::Stored(address()).to_string(), Catch::All, 100).await.unwrap();
    let running = run(archive(folder.path(), archive_bus));
    spool.frames.put(spool.frame("frame-1", device_bus.clock().utc())).await.unwrap();
    recv_stored(&stored, false).await;
    running.stop().await;
    std::fs::rename(&images, &away).unwrap();
    std::fs::create_dir(&images).unwrap();
    let running = run(archive(folder.path(), join(&device_bus).await));
    let alerts = running.node.alerts.watch();
    until("the alert", || {
        let is_away = "is missing or empty: its disk may be away. Mount it";
        alerts.borrow().alerts.iter().any(|alert| alert.cause.contains(is_away))
    })
    .await;
    assert_eq!(std::fs::read_dir(&images).unwrap().count(), 0);
    assert_eq!(ask(&spool.bus, Ask::Frames).await.len(), 1, "what needs no disk goes on");
    running.stop().await;
    // A person says that the folder is a new one.
    std::fs::create_dir(images.join(".part")).unwrap();
    let running = run(archive(folder.path(), join(&device_bus).await));
    until("it is taken", || images.join(".part/paranal-callisto.lock").exists()).await;
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_that_an_older_database_does_not_know_are_recorded_from_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let (images, database) = (folder.path().join("images"), folder.path().join("data/archive.db"));
    let (device_bus, archive_bus) = two_buses().await;
    let spool = Spool::start(device_bus.clone()).await;
    let stored = spool.bus.subscribe::<Stored>(&Key::Stored(address()).to_string(), Catch::All, 100).await.unwrap();
    let running = run(archive(folder.path(), archive_bus));
    let taken = device_bus.clock().utc();
    for id in ["frame-1", "frame-2"] {
        spool.frames.put(spool.frame(id, taken)).await.unwrap();
        recv_stored(&stored, false).await;
    }
    running.stop().await;
    // The database of an evening on which nothing was stored yet is put back.
    for ending in ["", "-wal", "-shm"] {
        let file = folder.path().join(format!("data/archive.db{ending}"));
        if file.exists() {
            std::fs::remove_file(file).unwrap();
        }
    }
    let requests = spool.requests.load(Ordering::SeqCst);
    let running = run(archive(folder.path(), join(&device_bus).await));
    let rows = || {
        let open = rusqlite::Connection::open(&database);
        let rows = open.and_then(|open| {
            let mut ask =
                open.prepare("SELECT frame_id, sha256, camera_name, complete_hdr FROM images ORDER BY frame_id")?;
            let rows =
                ask.query_map([], |row| Ok((row.get::<_, String>(0)?, row.get::<_, String>(1)?, row.get(2)?)))?;
            rows.collect::<rusqlite::Result<Vec<(String, String, String)>>>()
        });
        rows.unwrap_or_default()
    };
    until("both are recorded", || rows().len() == 2).await;
    let wanted = spool.frame("frame-1", taken).sha256;
    let row = |id: &str| (id.to_owned(), wanted.clone(), "andor".to_owned());
    assert_eq!(rows(), [row("frame-1"), row("frame-2")]);
    // The spool still has one, and is asked to delete it; nothing is fetched or written again.
    let releases = spool.releases("frame-2");
    // A device node announces a frame again until it is released: the first time the new archive may not be subscribed
    // yet.
    let announced = async {
        loop {
            spool.frames.put(spool.frame("frame-2", taken)).await.unwrap();
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    };
    tokio::select! {
        () = until("released", || spool.releases("frame-2") > releases) => {}
        () = announced => {}
    }
    assert_eq!(files(&images).len(), 2);
    assert_eq!(spool.requests.load(Ordering::SeqCst), requests);
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn many_frames_that_cannot_be_written_are_one_alert() {
    let folder = tempfile::tempdir().unwrap();
    let (device_bus, archive_bus) = two_buses().await;
    let spool = Spool::start(device_bus.clone()).await;
    let node = archive(folder.path(), archive_bus);
    let alerts = node.alerts.watch();
    let running = run(node);
    // As a disk that takes nothing: a file is in the place of the folder.
    let parts = folder.path().join("images/.part/paranal-callisto");
    spool.frames.put(spool.frame("before", device_bus.clock().utc())).await.unwrap();
    until("the node stores frames", || spool.releases("before") >= 1).await;
    std::fs::remove_dir(&parts).unwrap();
    std::fs::write(&parts, "").unwrap();
    for number in 0..6 {
        spool.frames.put(spool.frame(&format!("frame-{number}"), device_bus.clock().utc())).await.unwrap();
    }
    until("all six are reported", || {
        alerts.borrow().alerts.iter().any(|alert| alert.cause.starts_with("6 frames cannot be stored"))
    })
    .await;
    let frames = |alert: &&contract::observatory::Alert| alert.id.starts_with("archive/frame");
    assert_eq!(alerts.borrow().alerts.iter().filter(frames).count(), 1);
    std::fs::remove_file(&parts).unwrap();
    std::fs::create_dir(&parts).unwrap();
    until("it is over", || alerts.borrow().alerts.iter().all(|alert| !frames(&alert) || alert.returned_utc.is_some()))
        .await;
    running.stop().await;
}
