//! Frames over HTTP: what the archive gives is passed on, what is no question is refused here, and what the archive does not
//! give is a problem that says why.

use std::sync::{Arc, Mutex};

use contract::Key;
use contract::archived_frame::{
    ArchiveRefusal, Base64, FilePiece, FrameAnswer, FrameAsk, FrameGiven, FramePicture, FrameQuestion, NotGiven,
    Stretch,
};
use reqwest::header::{self, HeaderName};
use reqwest::{Method, Response};
use serde_json::{Value, json};

use crate::stage::{Stage, address};

const FRAME: &str = "/api/v1/telescopes/paranal/callisto/frames/019aa520";
/// The file of this archive, which has some pieces.
const FILE_BYTES: u64 = 1_300_000;

type Questions = Arc<Mutex<Vec<FrameQuestion>>>;
type Give = fn(FrameAsk) -> FrameGiven;

/// An archive that gives this, and the questions that it got.
async fn archive(stage: &Stage, give: Give) -> (bus::Service, Questions) {
    let questions = Questions::default();
    let got = questions.clone();
    let serve = move |question: Result<FrameQuestion, String>| {
        let question = question.unwrap();
        got.lock().unwrap().push(question.clone());
        async move { FrameAnswer { gives: give(question.ask) } }
    };
    let service = stage.bus.serve(&Key::ArchivedFrame(address("callisto")), serve).await.unwrap();
    stage.until(&format!("{FRAME}/header"), |_| !questions.lock().unwrap().is_empty()).await;
    questions.lock().unwrap().clear();
    (service, questions)
}

fn bytes(from: u64, end: u64) -> Vec<u8> {
    (from..end).map(|at| (at % 251) as u8).collect()
}

/// A file of which pieces are given, and a picture.
fn sound(ask: FrameAsk) -> FrameGiven {
    match ask {
        FrameAsk::Bytes { from, most } => {
            let piece = bytes(from, (from + u64::from(most)).min(FILE_BYTES));
            let (version, name) = ("v1".to_owned(), "M 31_\u{e9}.fits".to_owned());
            FrameGiven::Bytes(FilePiece { version, name, file_bytes: FILE_BYTES, from, bytes: Base64(piece) })
        }
        FrameAsk::Picture(_) => {
            FrameGiven::Picture(FramePicture { width_px: 2, height_px: 1, bytes: Base64(vec![0xFF, 0xD8]) })
        }
        _ => FrameGiven::Refused(ArchiveRefusal { reason: NotGiven::Unknown, detail: "no such frame".to_owned() }),
    }
}

async fn ask(stage: &Stage, method: Method, path: &str, headers: &[(HeaderName, &str)]) -> Response {
    let request = stage.http.request(method, format!("{}{path}", stage.url));
    headers.iter().fold(request, |request, (name, value)| request.header(name, *value)).send().await.unwrap()
}

fn text(response: &Response, name: HeaderName) -> &str {
    response.headers().get(name).map_or("", |value| value.to_str().unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_comes_whole_in_ranges_or_not_at_all_when_the_caller_has_it() {
    let stage = Stage::start().await;
    let (_archive, questions) = archive(&stage, sound).await;
    let path = format!("{FRAME}/file");
    let whole = ask(&stage, Method::GET, &path, &[]).await;
    assert_eq!((whole.status().as_u16(), text(&whole, header::CONTENT_TYPE)), (200, "application/fits"));
    assert_eq!(text(&whole, header::CONTENT_LENGTH), FILE_BYTES.to_string());
    assert!(text(&whole, header::CONTENT_DISPOSITION).ends_with("filename*=UTF-8''M%2031_%C3%A9.fits"));
    let tag = text(&whole, header::ETAG).to_owned();
    assert_eq!(whole.bytes().await.unwrap(), bytes(0, FILE_BYTES));
    assert!(questions.lock().unwrap().len() >= 4, "it is sent in pieces");

    for (range, from, end) in
        [("bytes=0-0", 0, 1), ("bytes=600000-1200000", 600_000, 1_200_001), ("bytes=-7", FILE_BYTES - 7, FILE_BYTES)]
    {
        let part = ask(&stage, Method::GET, &path, &[(header::RANGE, range), (header::IF_RANGE, &tag)]).await;
        assert_eq!(part.status().as_u16(), 206, "{range}");
        assert_eq!(text(&part, header::CONTENT_RANGE), format!("bytes {from}-{}/{FILE_BYTES}", end - 1));
        assert_eq!(part.bytes().await.unwrap(), bytes(from, end), "{range}");
    }
    for whole_again in [
        [(header::RANGE, "bytes=0-9,20-29")].as_slice(),
        &[(header::RANGE, "bytes=5-9"), (header::IF_RANGE, "\"old\"")],
    ] {
        let whole = ask(&stage, Method::GET, &path, whole_again).await;
        assert_eq!((whole.status().as_u16(), whole.content_length()), (200, Some(FILE_BYTES)));
    }
    let beyond = ask(&stage, Method::GET, &path, &[(header::RANGE, "bytes=1300000-")]).await;
    assert_eq!((beyond.status().as_u16(), text(&beyond, header::CONTENT_RANGE)), (416, "bytes */1300000"));
    let problem: Value = serde_json::from_slice(&beyond.bytes().await.unwrap()).unwrap();
    assert_eq!(problem["code"], "range");

    let known = ask(&stage, Method::GET, &path, &[(header::IF_NONE_MATCH, &tag)]).await;
    assert_eq!((known.status().as_u16(), text(&known, header::ETAG)), (304, tag.as_str()));
    questions.lock().unwrap().clear();
    let head = ask(&stage, Method::HEAD, &path, &[]).await;
    assert_eq!((head.status().as_u16(), text(&head, header::CONTENT_LENGTH)), (200, "1300000"));
    assert_eq!(questions.lock().unwrap().len(), 1, "a HEAD reads no piece of the file");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_changes_while_it_is_sent_is_never_taken_for_a_whole_one() {
    let stage = Stage::start().await;
    let changing: Give = |ask| match sound(ask) {
        FrameGiven::Bytes(piece) if piece.from > 0 => {
            FrameGiven::Bytes(FilePiece { version: "v2".to_owned(), ..piece })
        }
        given => given,
    };
    let (_archive, _) = archive(&stage, changing).await;
    let broken = ask(&stage, Method::GET, &format!("{FRAME}/file"), &[]).await;
    assert_eq!(broken.status().as_u16(), 200);
    assert!(broken.bytes().await.is_err(), "the connection breaks");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_picture_is_stored_for_ever_and_whoever_has_it_costs_the_archive_nothing() {
    let stage = Stage::start().await;
    let (_archive, questions) = archive(&stage, sound).await;
    let path = format!("{FRAME}/preview?size=64&stretch=log&lo=-5&hi=1e3&invert=true");
    let picture = ask(&stage, Method::GET, &path, &[]).await;
    assert_eq!((picture.status().as_u16(), text(&picture, header::CONTENT_TYPE)), (200, "image/jpeg"));
    assert_eq!(text(&picture, header::CACHE_CONTROL), "private, max-age=31536000, immutable");
    let tag = text(&picture, header::ETAG).to_owned();
    let FrameAsk::Picture(wanted) = questions.lock().unwrap().remove(0).ask else { panic!() };
    assert_eq!((wanted.longest_px, wanted.stretch, wanted.inverted), (64, Stretch::Log, true));
    assert_eq!((wanted.low_adu, wanted.high_adu), (Some(-5.0), Some(1000.0)));
    let again = ask(&stage, Method::GET, &path, &[(header::IF_NONE_MATCH, &tag)]).await;
    assert_eq!(again.status().as_u16(), 304);
    assert!(questions.lock().unwrap().is_empty());
    let other = ask(&stage, Method::GET, &format!("{FRAME}/preview?size=65"), &[(header::IF_NONE_MATCH, &tag)]).await;
    assert_eq!(other.status().as_u16(), 200, "another look is another picture");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_question_is_refused_and_never_asked() {
    let stage = Stage::start().await;
    let (_archive, questions) = archive(&stage, sound).await;
    for question in [
        "preview?size=15",
        "preview?size=2049",
        "preview?size=-1",
        "preview?size=1e9",
        "preview?stretch=NaN",
        "preview?stretch=",
        "preview?lo=NaN",
        "preview?hi=inf",
        "preview?lo=9&hi=9",
        "preview?lo=9&hi=-9",
        "preview?invert=perhaps",
        "preview?gamma=2",
        "header?hdu=0",
        "header?hdu=-1",
        "header?hdu=4294967296",
        "pixels",
        "pixels?x=0&y=0&w=0&h=1",
        "pixels?x=0&y=0&w=257&h=256",
        "pixels?x=0&y=0&w=4294967295&h=4294967295",
        "pixels?x=-1&y=0&w=1&h=1",
        "pixels?x=0.5&y=0&w=1&h=1",
    ] {
        let (status, problem) = stage.get(&format!("{FRAME}/{question}")).await;
        assert_eq!((status.as_u16(), &problem["code"]), (400, &json!("malformed")), "{question}: {problem}");
        assert!(problem["detail"].as_str().is_some_and(|detail| !detail.is_empty()), "{question}: {problem}");
    }
    let long = "a".repeat(5000);
    for id in ["..%2F..%2Fetc", "..%5C..", "%00", "%0a", "%ff", long.as_str()] {
        for what in ["", "/file", "/header", "/preview", "/tiles/0/0/0"] {
            let (status, problem) = stage.get(&format!("/api/v1/telescopes/paranal/callisto/frames/{id}{what}")).await;
            assert_eq!((status.as_u16(), &problem["code"]), (404, &json!("not-found")), "{id:.20} {what}: {problem}");
        }
    }
    for tile in ["-1/0/0", "a/b/c", "0/0/4294967296", "0/0/0.5", "+1/0/0"] {
        let (status, problem) = stage.get(&format!("{FRAME}/tiles/{tile}")).await;
        assert_eq!((status.as_u16(), &problem["code"]), (404, &json!("not-found")), "{tile}: {problem}");
    }
    for night in ["x", "2026", "..%2F..", "20261121.html", "2026112a"] {
        let (status, problem) = stage.get(&format!("/api/v1/telescopes/paranal/callisto/nights/{night}/report")).await;
        assert_eq!((status.as_u16(), &problem["code"]), (404, &json!("not-found")), "{night}: {problem}");
    }
    assert!(questions.lock().unwrap().is_empty(), "none of them was asked");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_archive_does_not_give_is_a_problem_with_the_reason() {
    let stage = Stage::start().await;
    let (status, problem) = stage.get(FRAME).await;
    assert_eq!((status.as_u16(), &problem["code"]), (504, &json!("archive")), "nobody answers: {problem}");
    let cases: [(Give, u16, &str); 7] = [
        (|_| refused(NotGiven::Unknown), 404, "not-found"),
        (|_| refused(NotGiven::FileAway), 410, "file-away"),
        (|_| refused(NotGiven::FileDamaged), 502, "file-damaged"),
        (|_| refused(NotGiven::OutOfRange), 422, "validation"),
        (|_| refused(NotGiven::Busy), 503, "busy"),
        (|_| refused(NotGiven::Failed), 504, "archive"),
        (|_| FrameGiven::Picture(FramePicture { width_px: 1, height_px: 1, bytes: Base64(vec![]) }), 504, "archive"),
    ];
    for (give, status, code) in cases {
        let (_archive, _) = archive(&stage, give).await;
        for what in ["", "/header", "/file", "/pixels?x=0&y=0&w=1&h=1", "/tiles/0/0/0"] {
            let answer = ask(&stage, Method::GET, &format!("{FRAME}{what}"), &[]).await;
            assert_eq!(answer.status().as_u16(), status, "{code} {what}");
            assert_eq!(answer.headers().contains_key(header::RETRY_AFTER), status == 503, "{code} {what}");
            assert_eq!(text(&answer, header::CACHE_CONTROL), "no-store", "{code} {what}");
            let problem: Value = serde_json::from_slice(&answer.bytes().await.unwrap()).unwrap();
            assert_eq!(problem["code"], code, "{what}: {problem}");
        }
    }
    stage.end().await;
}

fn refused(reason: NotGiven) -> FrameGiven {
    FrameGiven::Refused(ArchiveRefusal { reason, detail: "the reason in a sentence".to_owned() })
}
