//! Object stores that refuse, stop in the middle, or know no conditions.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderMap, Method, StatusCode, Uri};
use axum::response::{IntoResponse as _, Response};

use super::*;
use crate::delivery::item::Item;
use crate::delivery::store::ObjectBucket;

/// What a store does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Manner {
    Honest,
    /// Conditional requests are "not implemented".
    WithoutConditions,
    /// Each PUT fails, and the text of the failure has 501 in it.
    Failing,
    /// Heads of answers are all that comes.
    Silent,
}

#[derive(Debug)]
struct Store {
    manner: Manner,
    objects: Mutex<HashMap<String, Vec<u8>>>,
    /// Method and query of each request that changes something, and whether it had a condition.
    asked: Mutex<Vec<(Method, String, bool)>>,
}

async fn answer(
    State(store): State<Arc<Store>>,
    method: Method,
    uri: Uri,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    let (key, query) = (uri.path().to_owned(), uri.query().unwrap_or_default().to_owned());
    let has_condition = headers.contains_key("if-none-match");
    if method != Method::GET && method != Method::HEAD {
        store.asked.lock().unwrap().push((method.clone(), query.clone(), has_condition));
    }
    let mut objects = store.objects.lock().unwrap();
    let etag = [("ETag", "\"1\""), ("Last-Modified", "Wed, 25 Nov 2026 09:00:00 GMT")];
    match (store.manner, method.as_str()) {
        (Manner::Silent, _) => {
            let nothing = futures_util::stream::pending::<Result<Bytes, std::io::Error>>();
            (StatusCode::OK, etag, [("Content-Length", "10")], Body::from_stream(nothing)).into_response()
        }
        (Manner::Failing, "PUT") => (StatusCode::BAD_REQUEST, "error 501 of 501").into_response(),
        (Manner::WithoutConditions, "PUT") if has_condition => StatusCode::NOT_IMPLEMENTED.into_response(),
        (_, "GET" | "HEAD") => match objects.get(&key) {
            Some(content) => (etag, content.clone()).into_response(),
            None => StatusCode::NOT_FOUND.into_response(),
        },
        (_, "POST") if query.starts_with("uploads") => {
            "<InitiateMultipartUploadResult><UploadId>7</UploadId></InitiateMultipartUploadResult>".into_response()
        }
        (_, "POST") if has_condition && objects.contains_key(&key) => StatusCode::PRECONDITION_FAILED.into_response(),
        (_, "POST") => {
            objects.insert(key, b"parts".to_vec());
            "<CompleteMultipartUploadResult><ETag>1</ETag></CompleteMultipartUploadResult>".into_response()
        }
        (_, "PUT") if query.contains("partNumber") => {
            // Somebody else is quicker than the last part.
            if query.contains("partNumber=1&") && key.contains("raced") {
                objects.insert(key, b"theirs".to_vec());
            }
            etag.into_response()
        }
        (_, "PUT") if has_condition && objects.contains_key(&key) => StatusCode::PRECONDITION_FAILED.into_response(),
        (_, "PUT") => {
            objects.insert(key, body.to_vec());
            etag.into_response()
        }
        _ => StatusCode::NO_CONTENT.into_response(),
    }
}

async fn store(manner: Manner) -> (Arc<Store>, ObjectBucket) {
    let store = Arc::new(Store { manner, objects: Mutex::default(), asked: Mutex::default() });
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let app =
        Router::new().fallback(answer).layer(axum::extract::DefaultBodyLimit::disable()).with_state(store.clone());
    tokio::spawn(async move { axum::serve(listener, app).await.unwrap() });
    let block = format!(
        "[[delivery]]\nname = \"s\"\nbucket = \"b\"\nendpoint = \"http://{address}\"\naccess_key = \"k\"\nsecret_env = \"S\"\n"
    );
    let config = config::parse(&format!("{PLACE}{block}"), Path::new("/")).unwrap();
    let place = config.delivery[0].bucket().unwrap();
    let bucket = ObjectBucket::new(&place, Some("secret".to_owned()), true).await.unwrap();
    assert!(super::super::item::is_this_machine(bucket.host()), "{}", bucket.host());
    (store, bucket)
}

fn item(folder: &Path, name: &str, bytes: u64) -> Item {
    let file = folder.join("file");
    fs::File::create(&file).unwrap().set_len(bytes).unwrap();
    Item { file, name: name.to_owned(), bytes, sha256: String::new() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_large_file_in_parts_takes_no_name_that_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let (store, bucket) = store(Manner::Honest).await;
    let large = 65 << 20;
    assert!(bucket.send(&item(folder.path(), "a.fits", large)).await.unwrap());
    let ended = |(method, query, condition): &(Method, String, bool)| {
        *method == Method::POST && query.contains("uploadId") && *condition
    };
    assert!(store.asked.lock().unwrap().iter().any(ended), "{:?}", store.asked);
    // The name is taken before, or while the parts are sent.
    assert!(!bucket.send(&item(folder.path(), "a.fits", large)).await.unwrap());
    assert!(!bucket.send(&item(folder.path(), "raced.fits", large)).await.unwrap());
    assert_eq!(store.objects.lock().unwrap()["/b/raced.fits"], b"theirs");
}

#[tokio::test(flavor = "multi_thread")]
async fn only_a_store_without_conditions_is_asked_without_one() {
    let folder = tempfile::tempdir().unwrap();
    let (failing, bucket) = store(Manner::Failing).await;
    assert!(bucket.send(&item(folder.path(), "20250501.fits", 10)).await.is_err());
    assert!(failing.asked.lock().unwrap().iter().all(|(.., has_condition)| *has_condition), "{:?}", failing.asked);
    let (plain, bucket) = store(Manner::WithoutConditions).await;
    assert!(bucket.send(&item(folder.path(), "a.fits", 10)).await.unwrap());
    assert!(!bucket.send(&item(folder.path(), "a.fits", 20)).await.unwrap(), "it is looked at again before");
    assert_eq!(plain.objects.lock().unwrap()["/b/a.fits"].len(), 10);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_stops_in_the_middle_of_its_answer_is_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let (_, bucket) = store(Manner::Silent).await;
    let silent = |error: anyhow::Error| format!("{error:#}");
    let all = async {
        for why in [silent(bucket.held("a.fits").await.unwrap_err()), silent(bucket.read("m.json").await.unwrap_err())]
        {
            assert!(why.contains("sent nothing of"), "{why}");
        }
        // The answers to these are not read by us.
        assert!(bucket.send(&item(folder.path(), "a.fits", 10)).await.is_err());
        assert!(bucket.list("network").await.is_err());
    };
    // The store stays silent for ever: who waits for it hangs.
    tokio::time::timeout(std::time::Duration::from_secs(600), all).await.unwrap();
}
