//! Questions about one stored frame, asked over the bus of a real archive node.

use contract::archived_frame::{
    CardValue, FrameAnswer, FrameAsk, FrameGiven, FrameQuestion, NotGiven, PictureWanted, ReportAnswer, ReportForm,
    ReportGiven, ReportQuestion, Stretch,
};

use super::*;

async fn about(bus: &Bus, id: &str, ask: FrameAsk) -> FrameGiven {
    let question = FrameQuestion { frame: CommandId(id.to_owned()), ask };
    let answer: FrameAnswer = until_answered(bus, &Key::ArchivedFrame(address()), &question).await;
    answer.gives
}

async fn refusal(bus: &Bus, id: &str, ask: FrameAsk) -> NotGiven {
    match about(bus, id, ask).await {
        FrameGiven::Refused(refusal) => refusal.reason,
        given => panic!("{given:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stored_frame_is_described_drawn_and_given_over_the_bus() {
    let folder = tempfile::tempdir().unwrap();
    let (device_bus, archive_bus) = two_buses().await;
    let spool = Spool::start(device_bus.clone()).await;
    let stored = spool.bus.subscribe::<Stored>(&Key::Stored(address()).to_string(), Catch::All, 100).await.unwrap();
    let running = run(archive(folder.path(), archive_bus));
    tokio::time::sleep(Duration::from_secs(1)).await;
    spool.frames.put(spool.frame("frame-1", device_bus.clock().utc())).await.unwrap();
    let file = recv_stored(&stored, true).await.file;
    let path = folder.path().join("images").join(&file);

    let FrameGiven::About(found) = about(&device_bus, "frame-1", FrameAsk::About).await else { panic!() };
    assert_eq!((found.frame.file.as_str(), found.frame.width_px, found.frame.height_px), (file.as_str(), 64, 32));
    let FrameGiven::Header(header) = about(&device_bus, "frame-1", FrameAsk::Header { hdu: None }).await else {
        panic!()
    };
    let cards = &header.hdus[0].cards;
    let value = |keyword: &str| cards.iter().find(|card| card.keyword == keyword).map(|card| card.value.clone());
    assert_eq!(value("OBJECT"), Some(CardValue::Text("../Bar?/O'Neil".to_owned())));
    assert_eq!(value("NAXIS1"), Some(CardValue::Whole(64)));

    let whole = std::fs::read(&path).unwrap();
    let ask = FrameAsk::Bytes { from: 2880, most: 5000 };
    let FrameGiven::Bytes(piece) = about(&device_bus, "frame-1", ask).await else { panic!() };
    assert_eq!((piece.bytes.0.as_slice(), piece.file_bytes), (&whole[2880..7880], whole.len() as u64));
    assert_eq!((piece.name.as_str(), piece.version), (path.file_name().unwrap().to_str().unwrap(), header.version));

    let ask = FrameAsk::Pixels { x: 62, y: 31, width_px: 2, height_px: 1 };
    let FrameGiven::Pixels(given) = about(&device_bus, "frame-1", ask).await else { panic!() };
    let counts: Vec<u16> = pixels(7).as_chunks().0.iter().map(|bytes| u16::from_le_bytes(*bytes)).collect();
    assert_eq!(given.values, [Some(f32::from(counts[64 * 32 - 2])), Some(f32::from(counts[64 * 32 - 1]))]);
    let FrameGiven::Tile(tile) = about(&device_bus, "frame-1", FrameAsk::Tile { z: 0, x: 0, y: 0 }).await else {
        panic!()
    };
    assert_eq!((tile.width_px, tile.height_px, tile.bytes.0), (64, 32, pixels(7)));
    let wanted =
        PictureWanted { longest_px: 32, stretch: Stretch::Zscale, low_adu: None, high_adu: None, inverted: true };
    let FrameGiven::Picture(jpeg) = about(&device_bus, "frame-1", FrameAsk::Picture(wanted)).await else { panic!() };
    assert_eq!((jpeg.width_px, jpeg.height_px, &jpeg.bytes.0[..2]), (32, 16, &[0xFF, 0xD8][..]));

    assert_eq!(refusal(&device_bus, "frame-2", FrameAsk::About).await, NotGiven::Unknown);
    let night = sky::night_date(units::Angle::from_degrees(-70.4), found.frame.at_utc).to_string();
    let question = ReportQuestion { night, form: ReportForm::Json };
    let answer: ReportAnswer = until_answered(&device_bus, &Key::NightReport(address()), &question).await;
    let ReportGiven::Report(text) = answer.gives else { panic!() };
    assert!(text.contains("\"telescope\":\"callisto\""), "{text}");

    std::fs::rename(&path, path.with_extension("away")).unwrap();
    for ask in
        [FrameAsk::Header { hdu: None }, FrameAsk::Bytes { from: 0, most: 1 }, FrameAsk::Tile { z: 0, x: 0, y: 0 }]
    {
        assert_eq!(refusal(&device_bus, "frame-1", ask).await, NotGiven::FileAway);
    }
    running.stop().await;
}
