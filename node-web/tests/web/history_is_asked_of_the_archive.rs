//! Questions about the past over HTTP: what is no question is refused here, and an archive that is away or answers
//! nonsense is reported.

use std::sync::{Arc, Mutex};

use contract::Key;
use contract::archive::{ArchiveQuestion, Ask};
use contract::frame_search::{FrameSearch, SkyPlace};
use contract::log_search::LogSearch;
use contract::node::Level;
use serde_json::{Value, json};

use crate::stage::{Stage, address};

const TELESCOPE: &str = "/api/v1/telescopes/paranal/callisto";

type Questions = Arc<Mutex<Vec<ArchiveQuestion>>>;

/// An archive that answers every question so, and the questions that it got.
async fn archive(stage: &Stage, answer: Value) -> (bus::Service, Questions) {
    let questions = Questions::default();
    let got = questions.clone();
    let serve = move |question: Result<ArchiveQuestion, String>| {
        got.lock().unwrap().push(question.unwrap());
        let answer = answer.clone();
        async move { answer }
    };
    (stage.bus.serve(&Key::History(address("callisto")), serve).await.unwrap(), questions)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_question_is_refused_with_a_problem_and_never_asked() {
    let stage = Stage::start().await;
    let (_archive, questions) = archive(&stage, json!({"rows": [], "truncated": false})).await;
    stage.until(&format!("{TELESCOPE}/frames"), |answer| answer["rows"].is_array()).await;
    let before = questions.lock().unwrap().len();
    for question in [
        "frames?covers=6h",
        "frames?covers=NaN,0",
        "frames?covers=361,0",
        "frames?covers=10,-90.1",
        "frames?covers=",
        "frames?fwhm_max_arcsec=NaN",
        "frames?fwhm_max_arcsec=inf",
        "frames?fwhm_max_arcsec=-inf",
        "frames?fwhm_max_arcsec=wide",
        "frames?stars_min=-1",
        "frames?stars_min=4294967296",
        "frames?limit=-1",
        "frames?limit=1e3",
        "frames?from_utc=yesterday",
        "frames?to_utc=2026-02-29T00:00:00Z",
        "frames?with_calibration=maybe",
        "frames?night=20261121&night=20261122",
        "frames?colour=red",
        "log?level=loud",
        "log?around_utc=noon",
        "log?around_utc=2026-11-21T00:00:00Z&oldest=true",
        "log?limit=100001",
        "log?message=x",
        "series",
        "series?properties=",
        "series?properties=wx",
        "series?properties=observingconditions/wx",
        "series?properties=observingconditions//WindGust",
        "series?properties=fridge/wx/WindGust",
        "series?properties=observingconditions/wx/WindGust,",
        "series?properties=observingconditions/wx/WindGust&points=-1",
        "series?properties=observingconditions/wx/WindGust&points=4294967296",
    ] {
        let (status, problem) = stage.get(&format!("{TELESCOPE}/{question}")).await;
        assert_eq!((status.as_u16(), &problem["code"]), (400, &json!("malformed")), "{question}: {problem}");
        assert!(problem["detail"].as_str().is_some_and(|detail| !detail.is_empty()), "{question}: {problem}");
    }
    let long = "x".repeat(201);
    let (status, problem) = stage.get(&format!("{TELESCOPE}/log?text={long}")).await;
    assert!(status == 400 && problem["detail"].as_str().unwrap().contains("at most 200 bytes"), "{problem}");
    for night in ["x", "2026", "20261332", "20261121.html"] {
        let (status, problem) = stage.get(&format!("{TELESCOPE}/nights/{night}/alerts")).await;
        assert_eq!((status.as_u16(), &problem["code"]), (404, &json!("not-found")), "{night}: {problem}");
    }
    assert_eq!(questions.lock().unwrap().len(), before, "none of them was asked");
    for telescope in ["*/*", "**/callisto", "paranal%2Fx/callisto", "paranal/%24", "%20/%20"] {
        for about in ["frames", "series?properties=observingconditions/wx/WindGust"] {
            let (status, problem) = stage.get(&format!("/api/v1/telescopes/{telescope}/{about}")).await;
            assert_eq!((status.as_u16(), &problem["status"]), (404, &json!(404)), "{telescope} {about}: {problem}");
        }
    }
    assert_eq!(questions.lock().unwrap().len(), before, "none of them was asked");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_question_comes_to_the_archive_as_it_was_asked() {
    let stage = Stage::start().await;
    let (_archive, questions) = archive(&stage, json!({"rows": [], "truncated": true})).await;
    let everything = "night=20261121&camera=andor&object=%C3%93%20C%C3%A9u%2F1&filter=r%2B&image_type=Light+Frame\
                      &covers=359.99,-90&fwhm_max_arcsec=2.5&stars_min=7&with_calibration=true\
                      &from_utc=2028-02-29T00:00:00Z&to_utc=2026-11-21T03:00:00%2B02:00&limit=100000";
    let path = format!("{TELESCOPE}/frames?{everything}");
    let answer = stage.until(&path, |answer| answer["rows"].is_array()).await;
    assert_eq!(answer, json!({"rows": [], "truncated": true}));
    let text = |text: &str| Some(text.to_owned());
    let search = FrameSearch {
        night: text("20261121"),
        camera: text("andor"),
        object: text("Ó Céu/1"),
        filter: text("r+"),
        image_type: text("Light Frame"),
        covers: Some(SkyPlace { ra_deg: 359.99, dec_deg: -90.0 }),
        fwhm_max_arcsec: Some(2.5),
        stars_min: Some(7),
        with_calibration: true,
    };
    let expected = ArchiveQuestion {
        ask: Ask::FindFrames(Box::new(search)),
        from_utc: Some("2028-02-29T00:00:00Z".parse().unwrap()),
        to_utc: Some("2026-11-21T01:00:00Z".parse().unwrap()),
        limit: Some(100_000),
    };
    assert_eq!(questions.lock().unwrap().last(), Some(&expected));
    let path = format!("{TELESCOPE}/series?properties=observingconditions/wx/WindGust,dome/d/Azimuth");
    stage.until(&path, |answer| answer["rows"].is_array()).await;
    let newest = questions.lock().unwrap().last().cloned().unwrap();
    let Ask::Series { properties, points } = &newest.ask else { panic!("{newest:?}") };
    assert_eq!((properties.len(), *points), (2, 500));
    let moment = "2026-11-21T03:00:00Z";
    let search = LogSearch {
        text: text("50% O'Brien"),
        level: Some(Level::Warn),
        node: text("device"),
        around_utc: Some(moment.parse().unwrap()),
        oldest: false,
    };
    let asked = [
        (format!("text=50%25%20O'Brien&level=warn&node=device&around_utc={moment}&limit=9"), search, Some(9)),
        (String::new(), LogSearch::default(), None),
        (format!("oldest=true&from_utc={moment}"), LogSearch { oldest: true, ..LogSearch::default() }, None),
    ];
    for (query, search, limit) in asked {
        stage.until(&format!("{TELESCOPE}/log?{query}"), |answer| answer["rows"].is_array()).await;
        let newest = questions.lock().unwrap().last().cloned().unwrap();
        assert_eq!((newest.ask, newest.limit), (Ask::FindLog(Box::new(search)), limit), "{query}");
    }
    // From noon to noon, local mean time of the place.
    for night in ["20261121", "2026-11-21"] {
        let path = format!("{TELESCOPE}/nights/{night}/alerts");
        stage.until(&path, |answer| answer["rows"].is_array()).await;
        let [from_utc, to_utc] = ["2026-11-21", "2026-11-22"].map(|day| format!("{day}T16:41:36Z").parse().ok());
        let expected = ArchiveQuestion { ask: Ask::Alerts, from_utc, to_utc, limit: None };
        assert_eq!(questions.lock().unwrap().last(), Some(&expected), "{night}");
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_archive_that_is_away_or_answers_nonsense_is_reported_and_the_page_goes_on() {
    let stage = Stage::start().await;
    let (status, problem) = stage.get(&format!("{TELESCOPE}/frames")).await;
    assert_eq!((status.as_u16(), &problem["code"]), (504, &json!("archive")), "{problem}");
    for nonsense in [json!({"rows": 7, "truncated": false}), json!([]), json!("rows"), json!({"rows": [{"log": 1}]})] {
        let (_archive, questions) = archive(&stage, nonsense.clone()).await;
        let asked = || !questions.lock().unwrap().is_empty();
        let path = format!("{TELESCOPE}/frames");
        let problem = stage.until(&path, |problem| asked() && problem["code"] == "archive").await;
        assert_eq!(problem["status"], 504, "{nonsense}");
        assert!(problem["detail"].as_str().unwrap().contains("paranal/callisto"), "{problem}");
    }
    let (status, _) = stage.get("/healthz").await;
    assert!(status.is_success());
    stage.end().await;
}
