//! A test message to those who get alerts, over HTTP.

use std::sync::{Arc, Mutex};

use axum::Json;
use axum::routing::post;
use serde_json::{Value, json};
use test_support::serve;

use crate::stage::Stage;
use crate::stage::raw::with_users;

#[tokio::test(flavor = "multi_thread")]
async fn each_receiver_gets_it_or_its_reason_is_told_and_it_is_not_sent_twice_in_a_row() {
    let got = Arc::new(Mutex::new(Vec::<Value>::new()));
    let keep = got.clone();
    let take = async move |Json(body): Json<Value>| keep.lock().unwrap().push(body);
    let at = serve(axum::Router::new().route("/night", post(take.clone())).route("/", post(take))).await;
    let receivers = format!(
        "[[alerts.webhook]]\nname = \"desk\"\nurl = \"http://{at}/night\"\n[[alerts.webhook]]\nname = \"phone\"\n\
         format = \"ntfy\"\nurl = \"http://{at}/callisto-4f8a\"\n[[alerts.webhook]]\nname = \"gone\"\n\
         url = \"http://{at}/no-such-place\"\n"
    );
    let stage = Stage::start_alone(&receivers).await;
    let answer = stage.ask("POST /api/v1/alerts/test", "", None).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let told = answer.json();
    assert_eq!(told["telescope"], "paranal/callisto");
    let of = |index: usize| (told["receivers"][index]["name"].clone(), told["receivers"][index]["way"].clone());
    assert_eq!(
        [of(0), of(1), of(2)],
        [("desk", "webhook"), ("phone", "ntfy"), ("gone", "webhook")].map(|(name, way)| (json!(name), json!(way)))
    );
    assert_eq!(
        (&told["receivers"][0]["error"], &told["receivers"][1]["error"]),
        (&Value::Null, &Value::Null),
        "{told}"
    );
    assert!(told["receivers"][2]["error"].as_str().is_some_and(|why| why.contains("404")), "{told}");
    {
        let got = got.lock().unwrap();
        assert_eq!(got.len(), 2, "{got:?}");
        assert!(got.iter().any(|body| body["topic"] == "callisto-4f8a" && body["priority"] == 4), "{got:?}");
        assert!(got.iter().all(|body| body.to_string().contains("Nothing is wrong.")), "{got:?}");
    }
    let again = stage.ask("POST /api/v1/alerts/test", "", None).await;
    assert_eq!((again.status, &again.json()["code"]), (429, &json!("rate-limited")), "{}", again.text);
    assert_eq!(got.lock().unwrap().len(), 2);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_of_another_telescope_sends_none() {
    let folder = with_users();
    crate::stage::raw::add_user(folder.path(), "ota", &["operator:teide/*"]);
    let stage = Stage::start_with("", folder.path()).await;
    let (ana, ota) = (stage.session("ana").await, stage.session("ota").await);
    let refused = stage.ask("POST /api/v1/alerts/test", &ota, None).await;
    assert_eq!(refused.status, 403, "{}", refused.text);
    let nobody = stage.ask("POST /api/v1/alerts/test", &ana, None).await;
    assert_eq!((nobody.status, &nobody.json()["receivers"]), (200, &json!([])), "{}", nobody.text);
    stage.end().await;
}
