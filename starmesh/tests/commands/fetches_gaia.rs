//! `starmesh catalogue build --gaia-tap` against a real HTTP server on loopback that answers as TAP services do.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use axum::Router;
use axum::http::StatusCode;
use axum::response::IntoResponse as _;
use axum::routing::{get, post};
use tempfile::TempDir;
use units::Angle;

use crate::command::{Output, number, starmesh};

/// Columns and rows as ESA's archive writes them: Barnard's star (Gaia DR3, epoch 2016.0), one without motion, and one
/// without a magnitude.
const ANSWER: &str = "ra,dec,pmra,pmdec,ref_epoch,phot_g_mean_mag\n\
    269.44850252543836,4.739420051112412,-801.551,10362.394,2016.0,8.193974\n\
    269.40,4.70,,,2016.0,15.5\n\
    269.41,4.71,1.5,-2.5,2016.0,\n";

/// The form as it was sent, undone.
fn form(body: &str) -> Vec<(String, String)> {
    let undone = |text: &str| {
        let (mut bytes, mut rest) = (Vec::new(), text.bytes());
        while let Some(byte) = rest.next() {
            bytes.push(match byte {
                b'+' => b' ',
                b'%' => {
                    let digits = [rest.next().unwrap(), rest.next().unwrap()];
                    u8::from_str_radix(std::str::from_utf8(&digits).unwrap(), 16).unwrap()
                }
                byte => byte,
            });
        }
        String::from_utf8(bytes).unwrap()
    };
    body.split('&').map(|pair| pair.split_once('=').unwrap()).map(|(k, v)| (undone(k), undone(v))).collect()
}

/// A server; answers its address and the count of questions that it has received.
fn server() -> (String, Arc<AtomicUsize>) {
    let asked = Arc::new(AtomicUsize::new(0));
    let count = asked.clone();
    // As GAVO and others do: the answer is somewhere else.
    let sync = move |body: String| {
        let count = count.clone();
        async move {
            count.fetch_add(1, Ordering::SeqCst);
            let form = form(&body);
            let value = |name: &str| form.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str()).unwrap();
            let query = value("QUERY");
            let whole = value("REQUEST") == "doQuery"
                && value("LANG") == "ADQL"
                && value("FORMAT") == "csv"
                && query.contains("FROM gaiadr3.gaia_source")
                && query.contains("CIRCLE('ICRS', 269.45, 4.74, 0.1)) AND phot_g_mean_mag <= 17");
            if whole {
                (StatusCode::SEE_OTHER, [("location", "/job/1")], "").into_response()
            } else {
                (StatusCode::BAD_REQUEST, format!("unexpected {query}")).into_response()
            }
        }
    };
    const ERROR: &str = "<?xml version=\"1.0\"?><VOTABLE><RESOURCE type=\"results\">\
        <INFO name=\"QUERY_STATUS\" value=\"ERROR\">Cannot parse query: line 1</INFO></RESOURCE></VOTABLE>";
    let router = Router::new()
        .route("/tap/sync", post(sync))
        .route("/job/1", get(|| async { ([("content-type", "text/csv")], ANSWER) }))
        .route("/refuses/sync", post(|| async { (StatusCode::BAD_REQUEST, ERROR) }))
        .route("/lies/sync", post(|| async { ERROR }))
        .route("/circle/sync", post(|| async { (StatusCode::TEMPORARY_REDIRECT, [("location", "/circle/sync")], "") }))
        .route("/hangs/sync", post(|| async { std::future::pending::<()>().await }));
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    listener.set_nonblocking(true).unwrap();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener).unwrap();
            axum::serve(listener, router).await.unwrap();
        });
    });
    (address, asked)
}

fn build(folder: &Path, url: &str, more: &[&str]) -> (PathBuf, Output) {
    let out = folder.join("gaia.smcat");
    let (out_text, cache) = (out.display().to_string(), folder.join("cache").display().to_string());
    let mut arguments = vec!["catalogue", "build", "--out", &out_text, "--cache", &cache, "--gaia-url", url];
    arguments.extend(["--gaia-tap", "269.45", "4.74", "0.1"]);
    arguments.extend(more);
    (out.clone(), starmesh(arguments))
}

#[test]
fn stars_of_a_circle_are_fetched_once_and_stored() {
    let (address, asked) = server();
    let folder = TempDir::new().unwrap();
    let url = format!("{address}/tap/sync");
    for _ in 0..2 {
        let (out, output) = build(folder.path(), &url, &["--json"]);
        assert!(output.success, "{}", output.err);
        let answer = &output.json()[0];
        assert_eq!(number(answer, "stars") as u64, 2, "{answer}");
        assert_eq!(number(answer, "without_motion") as u64, 1, "kept, with none");
        assert_eq!(number(answer, "rows_without_magnitude") as u64, 1, "reported, not lost in silence");
        let catalogue = catalogue::Catalogue::open(&out, &catalogue::Reading::default()).unwrap();
        // Ten years on, Barnard's star has gone 103.6" to the north and 8.0" to the west.
        let (ra, dec) =
            (269.448_502_5 - 8.015_5 / 3600.0 / 4.75_f64.to_radians().cos(), 4.739_420_1 + 103.623_9 / 3600.0);
        let near = |radius: f64| {
            let (ra, dec) = (Angle::from_degrees(ra), Angle::from_degrees(dec));
            catalogue.cone(ra, dec, Angle::from_arcseconds(radius), 20.0, 2026.0).unwrap().len()
        };
        assert_eq!((near(0.1), near(60.0)), (1, 1));
    }
    assert_eq!(asked.load(Ordering::SeqCst), 1, "the second time it was answered from disk");
    // Without the server too.
    let (_, output) = build(folder.path(), &url, &[]);
    assert!(output.success && output.out.contains("1 without proper motion"), "{}{}", output.out, output.err);
}

#[test]
fn what_goes_wrong_on_the_way_is_reported_and_leaves_nothing_behind() {
    let (address, _) = server();
    let folder = TempDir::new().unwrap();
    for (path, words) in [
        ("/refuses/sync", "it answered 400 Bad Request: Cannot parse query: line 1"),
        ("/lies/sync", "the service answers: Cannot parse query: line 1"),
        ("/circle/sync", "it redirects in a circle"),
        ("/hangs/sync", "no whole answer within 1 s"),
        ("/nothing/here", "it answered 404 Not Found"),
    ] {
        // Only the one that hangs may take too long.
        let timeout_s = if path.starts_with("/hangs") { "1" } else { "120" };
        let (out, output) = build(folder.path(), &format!("{address}{path}"), &["--timeout-s", timeout_s]);
        assert!(!output.success && output.err.contains(words), "{path}: {}", output.err);
        assert!(output.err.contains(path), "the address is reported: {}", output.err);
        assert!(!out.exists());
    }
    // A port on which no program listens.
    let unused = "127.0.0.1:1";
    let (_, output) = build(folder.path(), &format!("http://{unused}/tap"), &[]);
    assert!(!output.success && output.err.contains("it cannot be reached"), "{}", output.err);
    let left = std::fs::read_dir(folder.path().join("cache")).unwrap().count();
    assert_eq!(left, 0, "no half answer is kept");
    let output = starmesh(["catalogue", "build", "--out", "x.smcat"]);
    assert!(!output.success && output.err.contains("nothing to build from"), "{}", output.err);
}

mod proof {
    use super::*;

    /// A bound in seconds on a real clock.
    #[test]
    fn a_service_that_hangs_is_given_up_in_time() {
        let (address, _) = server();
        let folder = TempDir::new().unwrap();
        let started = Instant::now();
        let (_, output) = build(folder.path(), &format!("{address}/hangs/sync"), &["--timeout-s", "1"]);
        assert!(!output.success && started.elapsed() < Duration::from_secs(20), "{:?}", started.elapsed());
    }
}
