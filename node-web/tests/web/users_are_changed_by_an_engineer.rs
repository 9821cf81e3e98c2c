//! Users over HTTP: an engineer of all telescopes makes, changes and removes them, everybody changes their own password, and somebody
//! who can do so always remains.

use audit::audit_file::examine;
use contract::Reason;
use contract::audit::{AuditOutcome, AuditRecord};
use serde_json::{Value, json};

use crate::stage::Stage;
use crate::stage::raw::{Answer, PASSWORD, change, exchange, request, with_users};

const ME: &str = "GET /api/v1/me";
const USERS: &str = "GET /api/v1/users";
const OWN: &str = "PUT /api/v1/me/password";
const OTHER: &str = "quite another five words";

async fn put(stage: &Stage, by: &str, name: &str, body: Value) -> Answer {
    stage.ask(&format!("PUT /api/v1/users/{name}"), by, Some(&body)).await
}

async fn delete(stage: &Stage, by: &str, name: &str) -> Answer {
    stage.ask(&format!("DELETE /api/v1/users/{name}"), by, None).await
}

fn file(folder: &tempfile::TempDir) -> String {
    std::fs::read_to_string(folder.path().join("users.toml")).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_user_is_made_changed_and_removed_and_what_is_taken_away_ends_at_once() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    let eve = stage.session("eve").await;
    let made =
        put(&stage, &eve, "bob", json!({"rights": ["viewer", "operator:paranal/io"], "password": PASSWORD})).await;
    assert_eq!(made.status, 201, "{}", made.text);
    let new =
        json!({"name": "bob", "rights": ["viewer", "operator:paranal/io"], "sessions": 0, "idle_s": null, "tokens": 0});
    assert_eq!(made.json(), new);
    let bob = stage.session("bob").await;
    let token = json!({"name": "cron", "days": 1});
    let token = stage.ask("POST /api/v1/tokens", &bob, Some(&token)).await.json()["token"].as_str().unwrap().to_owned();
    let token = format!("Authorization: Bearer {token}\r\n");
    let list = stage.ask(USERS, &eve, None).await;
    assert!(!list.text.contains("argon2") && !list.text.contains("password"), "{}", list.text);
    let list = list.json();
    let names: Vec<&Value> = list["items"].as_array().unwrap().iter().map(|item| &item["name"]).collect();
    assert_eq!((names, &list["open"]), (vec![&json!("ana"), &json!("bob"), &json!("eve")], &json!(false)));
    let item = &list["items"][1];
    assert!(item["sessions"] == 1 && item["tokens"] == 1 && item["idle_s"].is_u64(), "{item}");

    let changed = put(&stage, &eve, "bob", json!({"rights": ["observer"]})).await;
    assert_eq!((changed.status, &changed.json()["rights"]), (200, &json!(["observer"])), "{}", changed.text);
    for headers in [&bob, &token] {
        assert_eq!(stage.ask(ME, headers, None).await.json()["rights"], json!(["observer"]), "without another login");
    }
    let changed = put(&stage, &eve, "bob", json!({"password": OTHER})).await;
    assert_eq!((changed.status, &changed.json()["rights"]), (200, &json!(["observer"])), "{}", changed.text);
    assert_eq!((stage.status(ME, &bob).await, stage.status(ME, &token).await), (401, 200));
    assert_eq!(stage.log_in_as("bob", PASSWORD, "127.0.0.1").await.status, 401);
    let again = stage.log_in_as("bob", OTHER, "127.0.0.1").await;
    let again = format!("Cookie: {}\r\n", again.cookie());
    assert!(!file(&folder).contains(PASSWORD) && !file(&folder).contains(OTHER));

    assert_eq!(delete(&stage, &eve, "bob").await.status, 204);
    assert_eq!((stage.status(ME, &again).await, stage.status(ME, &token).await), (401, 401));
    assert_eq!(delete(&stage, &eve, "bob").await.status, 404);
    assert!(!file(&folder).contains("bob") && !file(&folder).contains("cron"));
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_no_user_can_be_is_refused_with_what_was_expected_and_changes_nothing() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    let eve = stage.session("eve").await;
    let before = file(&folder);
    let new = json!({"rights": ["viewer"], "password": PASSWORD});
    let with = |member: &str, value: Value| {
        let mut body = new.clone();
        body[member] = value;
        body
    };
    for (name, body, status, why) in [
        ("b%20b", new.clone(), 422, "name: "),
        ("local", new.clone(), 409, "those who are no users"),
        ("ANA", new.clone(), 409, "could be taken for"),
        ("bob", with("password", json!("short")), 422, "password: the password has 5 characters: expected 12 or more"),
        ("bob", with("password", json!("bob-bob-bob-bob")), 422, "easily guessed"),
        ("bob", with("password", json!(7)), 422, "password: "),
        ("bob", with("rights", json!(["root"])), 422, "is no grant"),
        ("bob", with("rights", json!([])), 422, "expected one or more"),
        ("bob", with("colour", json!(7)), 422, "colour: there is no such member"),
        ("bob", json!({"rights": ["viewer"]}), 422, "password: there is no user bob yet"),
        ("bob", json!({"password": PASSWORD}), 422, "rights: there is no user bob yet"),
        ("ana", json!({}), 422, "nothing to change"),
        ("ana", json!({"rights": []}), 422, "expected one or more"),
        ("ana", json!({"password": "short"}), 422, "expected 12 or more"),
    ] {
        let answer = put(&stage, &eve, name, body.clone()).await;
        assert!(
            answer.status == status && answer.text.contains(why),
            "{name} {body}: {} {}",
            answer.status,
            answer.text
        );
        assert!(!answer.text.contains(PASSWORD), "{}", answer.text);
    }
    let only_new = format!("{eve}If-None-Match: *\r\n");
    let answer = put(&stage, &only_new, "ana", new.clone()).await;
    assert!(answer.status == 412 && answer.text.contains("already"), "{}", answer.text);
    assert_eq!(delete(&stage, &eve, "no%20name").await.status, 404);
    assert_eq!(file(&folder), before);
    // Neither a lesser right, nor an engineer of some telescopes, nor a token, nor a page of another server changes users.
    let far = json!({"rights": ["engineer:paranal/*"], "password": PASSWORD});
    assert_eq!(put(&stage, &eve, "far", far).await.status, 201);
    let token = stage.ask("POST /api/v1/tokens", &eve, Some(&json!({"name": "cron", "days": 1}))).await.json();
    let token = format!("Authorization: Bearer {}\r\n", token["token"].as_str().unwrap());
    let before = file(&folder);
    let far = stage.session("far").await;
    let ana = stage.session("ana").await;
    for by in [&ana, &far] {
        for answer in [
            stage.ask(USERS, by, None).await,
            put(&stage, by, "bob", new.clone()).await,
            put(&stage, by, "ana", json!({"rights": ["engineer"]})).await,
            delete(&stage, by, "eve").await,
        ] {
            assert!(answer.status == 403 && answer.json()["required_right"] == "engineer", "{}", answer.text);
        }
    }
    assert_eq!(stage.status(USERS, &token).await, 200);
    let foreign = format!("{eve}Origin: http://evil.example\r\n");
    let own = json!({"old_password": PASSWORD, "new_password": OTHER});
    for by in [&token, &foreign] {
        let answers = [put(&stage, by, "bob", new.clone()).await, delete(&stage, by, "ana").await];
        assert!(answers.iter().all(|answer| answer.status == 403), "{by}: {}", answers[0].text);
        assert_eq!(stage.ask(OWN, by, Some(&own)).await.status, 403, "{by}");
    }
    assert_eq!(file(&folder), before);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_change_of_users_and_every_refusal_of_one_leaves_a_record_that_holds_no_secret() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    let (eve, ana) = (stage.session("eve").await, stage.session("ana").await);
    let new = json!({"rights": ["viewer"], "password": PASSWORD});
    assert_eq!(put(&stage, &eve, "bob", new.clone()).await.status, 201);
    assert_eq!(put(&stage, &eve, "bob", json!({"rights": ["observer", "operator:paranal/io"]})).await.status, 200);
    assert_eq!(put(&stage, &eve, "bob", json!({"password": OTHER})).await.status, 200);
    let token = stage.ask("POST /api/v1/tokens", &ana, Some(&json!({"name": "cron", "days": 1}))).await.json();
    assert_eq!(stage.status("DELETE /api/v1/tokens/cron", &eve).await, 204);
    assert_eq!(delete(&stage, &eve, "eve").await.status, 409);
    assert_eq!(put(&stage, &ana, "zoe", new).await.status, 403);
    assert_eq!(put(&stage, &ana, "ana", json!({"rights": ["engineer"]})).await.status, 403);
    assert_eq!(put(&stage, &eve, "bob", json!({"password": [OTHER]})).await.status, 422);
    assert_eq!(stage.status(USERS, &ana).await, 403, "whoever only looks leaves no record");
    assert_eq!(delete(&stage, &eve, "bob").await.status, 204);
    let wrong = json!({"old_password": OTHER, "new_password": PASSWORD});
    assert_eq!(stage.ask(OWN, &ana, Some(&wrong)).await.status, 422);
    let own = stage.ask(OWN, &ana, Some(&json!({"old_password": PASSWORD, "new_password": OTHER}))).await;
    assert_eq!(own.status, 204, "{}", own.text);
    stage.end().await;

    let text = std::fs::read(folder.path().join("data/audit-web-callisto-main.jsonl")).unwrap();
    let found = examine(&text, None);
    assert!(found.broken.is_none() && found.half.is_empty(), "{:?}", found.broken);
    let records: Vec<AuditRecord> = found.good.into_iter().map(|proven| proven.record).collect();
    let what = |record: &AuditRecord| serde_json::from_str::<Value>(&record.parameters).unwrap();
    let of_users = records.iter().filter(|record| record.device.starts_with("user/"));
    let (done, not_done): (Vec<_>, Vec<_>) = of_users.partition(|record| record.outcome == AuditOutcome::Done);
    let told: Vec<_> =
        done.iter().map(|one| (one.from.as_str(), one.verb.as_str(), one.device.as_str(), what(one))).collect();
    let (eve, ana) = ("web/eve@127.0.0.1", "web/ana@127.0.0.1");
    let refused: Vec<_> = not_done
        .iter()
        .map(|one| match &one.outcome {
            AuditOutcome::Refused { reason, detail } => {
                (one.from.as_str(), one.verb.as_str(), one.device.as_str(), *reason, detail.as_str())
            }
            other => panic!("{other:?}"),
        })
        .collect();
    let expected = [
        (eve, "remove_user", "user/eve", Reason::NotNow, "make another engineer first"),
        (ana, "make_user", "user/zoe", Reason::NotNow, "ana may not do this: it needs the right engineer"),
        (ana, "change_user", "user/ana", Reason::NotNow, "ana may not do this: it needs the right engineer"),
        (eve, "change_user", "user/bob", Reason::Malformed, "Something in the request is wrong: /password"),
        (ana, "change_own_password", "user/ana", Reason::Malformed, "Something in the request is wrong: /old_password"),
    ];
    assert_eq!(refused.len(), expected.len(), "{refused:?}");
    for (found, wanted) in refused.iter().zip(expected) {
        assert_eq!((found.0, found.1, found.2, found.3), (wanted.0, wanted.1, wanted.2, wanted.3), "{refused:?}");
        assert!(found.4.contains(wanted.4), "{refused:?}");
    }
    let changed = json!(["observer", "operator:paranal/io"]);
    let is_now = |before: &Value, password: bool| json!({"rights_before": before, "rights": changed, "other_password": password});
    let expires = &told[3].3["expires_utc"];
    let made = json!({"name": "cron", "rights": null, "expires_utc": expires});
    assert!(expires.is_string(), "{told:?}");
    assert_eq!(
        told,
        [
            (eve, "make_user", "user/bob", json!({"rights": ["viewer"]})),
            (eve, "change_user", "user/bob", is_now(&json!(["viewer"]), false)),
            (eve, "change_user", "user/bob", is_now(&changed, true)),
            (ana, "make_token", "user/ana", made),
            (eve, "remove_token", "user/ana", json!({"name": "cron"})),
            (eve, "remove_user", "user/bob", json!({"rights_before": changed})),
            (ana, "change_own_password", "user/ana", json!({})),
        ]
    );
    let text = String::from_utf8(text).unwrap();
    for secret in [PASSWORD, OTHER, token["token"].as_str().unwrap(), "argon2"] {
        assert!(!text.contains(secret), "{secret}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn somebody_who_can_change_users_always_remains() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    let eve = stage.session("eve").await;
    let demote = json!({"rights": ["operator", "engineer:paranal/*"]});
    for answer in [delete(&stage, &eve, "eve").await, put(&stage, &eve, "eve", demote.clone()).await] {
        assert!(answer.status == 409 && answer.text.contains("make another engineer first"), "{}", answer.text);
    }
    assert_eq!(put(&stage, &eve, "eve", json!({"rights": ["viewer:teide/*", "engineer"]})).await.status, 200);
    assert_eq!(put(&stage, &eve, "zoe", json!({"rights": ["engineer"], "password": PASSWORD})).await.status, 201);
    assert_eq!(put(&stage, &eve, "eve", demote).await.status, 200);
    assert_eq!(stage.status(USERS, &eve).await, 403, "it counts at once");
    // Of two who remove each other at once, one remains.
    let zoe = stage.session("zoe").await;
    assert_eq!(put(&stage, &zoe, "eve", json!({"rights": ["engineer"]})).await.status, 200);
    let (one, two) = tokio::join!(delete(&stage, &eve, "zoe"), delete(&stage, &zoe, "eve"));
    let removed = [&one, &two].iter().filter(|answer| answer.status == 204).count();
    assert_eq!(removed, 1, "{} {}", one.text, two.text);
    assert!(change(folder.path(), |users| users.has_engineer()));
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_first_user_is_an_engineer_and_is_made_on_the_servers_host() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::start_with("", folder.path()).await;
    assert_eq!(stage.ask(USERS, "", None).await.json(), json!({"items": [], "open": true}));
    assert_eq!(delete(&stage, "", "ana").await.status, 404);
    let own = stage.ask(OWN, "", Some(&json!({"old_password": PASSWORD, "new_password": OTHER}))).await;
    assert_eq!(own.status, 409, "{}", own.text);
    for rights in [json!(["operator"]), json!(["engineer:paranal/*"])] {
        let answer = put(&stage, "", "ana", json!({"rights": rights, "password": PASSWORD})).await;
        assert!(answer.status == 422 && answer.text.contains("has to be an engineer"), "{}", answer.text);
    }
    assert!(!folder.path().join("users.toml").exists());
    let engineer = json!({"rights": ["engineer"], "password": PASSWORD});
    let made = put(&stage, "", "ana", engineer.clone()).await;
    assert_eq!(made.status, 201, "{}", made.text);
    assert_eq!((stage.status(USERS, "").await, put(&stage, "", "bob", engineer.clone()).await.status), (401, 401));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = std::fs::metadata(folder.path().join("users.toml")).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
    let ana = stage.session("ana").await;
    assert_eq!(stage.ask(USERS, &ana, None).await.json()["items"][0]["sessions"], 1);
    stage.end().await;

    // A server that is open to everybody belongs to nobody who only reaches it.
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::start_with("insecure_open = true\n", folder.path()).await;
    let far = put(&stage, "X-Forwarded-For: 192.0.2.7\r\n", "eve", engineer).await;
    assert!(far.status == 403 && far.text.contains("on the server's own host"), "{}", far.text);
    assert!(!folder.path().join("users.toml").exists());
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn everybody_changes_their_own_password_by_the_old_one() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    let (ana, other, eve) = (stage.session("ana").await, stage.session("ana").await, stage.session("eve").await);
    let own = async |by: &str, old: &str, new: &str| {
        stage.ask(OWN, by, Some(&json!({"old_password": old, "new_password": new}))).await
    };
    let before = file(&folder);
    for (old, new, pointer, why) in [
        ("not the password", OTHER, "/old_password", "it is not your password"),
        (PASSWORD, "short", "/new_password", "expected 12 or more"),
        (PASSWORD, "ana-ana-ana-ana", "/new_password", "easily guessed"),
    ] {
        let answer = own(&ana, old, new).await;
        assert!(answer.status == 422 && answer.text.contains(why), "{}", answer.text);
        assert_eq!(answer.json()["errors"][0]["pointer"], pointer);
    }
    assert_eq!(file(&folder), before);
    let done = own(&ana, PASSWORD, OTHER).await;
    assert_eq!(done.status, 204, "{}", done.text);
    let statuses = [stage.status(ME, &ana).await, stage.status(ME, &other).await, stage.status(ME, &eve).await];
    assert_eq!(statuses, [401, 401, 200], "all sessions of this user end, and no other");
    assert_eq!(stage.log_in_as("ana", PASSWORD, "127.0.0.1").await.status, 401);
    let again = stage.log_in_as("ana", OTHER, "127.0.0.1").await;
    assert_eq!(again.json()["rights"], json!(["operator:paranal/*"]));
    // Whoever finds a browser in which somebody is logged in cannot guess the password there.
    let again = format!("Cookie: {}\r\n", again.cookie());
    let mut last = own(&again, "not the password", PASSWORD).await;
    for _ in 0..100 {
        if last.status == 429 {
            break;
        }
        last = own(&again, "not the password", PASSWORD).await;
    }
    assert_eq!((last.status, &last.json()["code"]), (429, &json!("rate-limited")), "{}", last.text);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn behind_a_proxy_that_signs_people_in_a_user_needs_no_password() {
    let folder = with_users();
    let web = "trust_proxy = [\"127.0.0.9/32\"]\nproxy_right = \"viewer\"\n";
    let stage = Stage::start_with(web, folder.path()).await;
    let proxied = async |user: &str, ask: &str, body: Option<Value>| {
        let text = request(stage.authority(), ask, &format!("X-Remote-User: {user}\r\n"), body.as_ref());
        exchange(stage.connect_from("127.0.0.9").await.unwrap(), &text).await
    };
    let made = proxied("eve", "PUT /api/v1/users/bob", Some(json!({"rights": ["operator"]}))).await;
    assert_eq!(made.status, 201, "{}", made.text);
    assert_eq!(proxied("bob", ME, None).await.json()["rights"], json!(["operator"]));
    assert_eq!(proxied("bob", USERS, None).await.status, 403);
    let own = json!({"old_password": PASSWORD, "new_password": OTHER});
    assert_eq!(proxied("eve", OWN, Some(own.clone())).await.status, 204);
    let stranger = proxied("stranger", OWN, Some(own)).await;
    assert!(stranger.status == 409 && stranger.text.contains("not in the users file"), "{}", stranger.text);
    stage.end().await;
}
